"""The history of a fleet: one DuckDB file with all runs, which everybody may read at any time.

DuckDB permits one process that writes to a file, or several that read it. The commands that change
a history therefore work on a copy beside it (``history.run.duckdb``), which takes the place of the
file as a whole after batches of results and at the end.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lieid_casadi.atomic_file import atomic_binary, check_file, reported
from lieid_casadi.errors import FleetError, of_extra
from lieid_casadi.fleet.night_result import ROWS, Batch
from lieid_casadi.messages import reason_of

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

SCHEMA = 9
MEMORY = "256MB"  # of DuckDB, which otherwise keeps most of a large history in memory
#: Without keys, whose indices DuckDB keeps in memory: those of some million runs exceed `MEMORY`.
TABLES = {
    "runs": "run_id VARCHAR, serial VARCHAR, recording VARCHAR, "
    "recording_sha256 VARCHAR, fit_sha256 VARCHAR, version VARCHAR, started TIMESTAMPTZ, "
    "seconds DOUBLE, status VARCHAR, reason VARCHAR, date DATE, stamp VARCHAR, condition VARCHAR, "
    "payload VARCHAR, method INTEGER",
    "findings": "run_id VARCHAR, serial VARCHAR, date DATE, effect VARCHAR, joint INTEGER, "
    "change DOUBLE, std DOUBLE, unit VARCHAR, severity DOUBLE, sentence VARCHAR, rivals VARCHAR",
    "parameters": "run_id VARCHAR, serial VARCHAR, date DATE, name VARCHAR, joint INTEGER, "
    "value DOUBLE, std DOUBLE, unit VARCHAR",
    "errors": "run_id VARCHAR, serial VARCHAR, date DATE, joint INTEGER, rms_moving DOUBLE, "
    "noise_floor DOUBLE, expected DOUBLE, torque_rms DOUBLE, temperature DOUBLE, "
    "q_low DOUBLE, q_high DOUBLE, q_mean DOUBLE, q_std DOUBLE",
    "repeats": "serial VARCHAR, recording VARCHAR, stamp VARCHAR, run_id VARCHAR",
    "arms": "serial VARCHAR, robot VARCHAR, joints INTEGER, fit_sha256 VARCHAR, "
    "limits VARCHAR, since DATE, fit_from DATE, retired DATE, fit VARCHAR",
    "maintenance": "serial VARCHAR, first DATE, last DATE",
    "nights": "serial VARCHAR, date DATE, status VARCHAR",
    "alarms": "serial VARCHAR, joint INTEGER, quantity VARCHAR, since DATE, last DATE, "
    "change DOUBLE, std DOUBLE, unit VARCHAR, sentence VARCHAR, raised DATE, closed DATE, "
    "note VARCHAR, severity DOUBLE, slope DOUBLE, limit_date DATE, series VARCHAR, "
    "slope_low DOUBLE, slope_high DOUBLE, reported DOUBLE, warned BOOLEAN, limit_early DATE, "
    "limit_late DATE, rivals VARCHAR",
    "acknowledgements": "serial VARCHAR, joint INTEGER, date DATE, note VARCHAR, "
    "written TIMESTAMPTZ",
    "judged": "date DATE, written TIMESTAMPTZ",
    "calls": "finished TIMESTAMPTZ, seconds DOUBLE, version VARCHAR, counts VARCHAR, "
    "alarms INTEGER",
    "history": "schema INTEGER",
}
COMMENTS = {
    "runs": "one row per arm-night",
    "runs.version": "of lieid-casadi on the worker",
    "runs.status": "done, refused (the recording cannot be used) or failed (it is tried again)",
    "runs.stamp": "changes with the file of the recording",
    "runs.condition": "hash of torque constants, tool and payloads of the fleet file",
    "runs.payload": "label of the payload in the recording",
    "runs.method": "number of the method of diagnosis",
    "findings.joint": "from 1; null for the whole arm",
    "findings.rivals": "effects that fit as well, separated by commas",
    "findings.severity": "part of the joint's torque that the effect explains",
    "parameters.std": "from the noise of the fit alone",
    "errors": "of the fit on a night, per joint (from 1), N·m",
    "errors.expected": "error that the fit expects in this motion",
    "errors.temperature": "mean, °C",
    "errors.q_low": "lowest position; rad, or m of a sliding joint",
    "arms.limits": "JSON: effect or parameter and its largest permitted values",
    "arms.fit_from": "first night that is judged by the present fit",
    "nights": "every expected night of every arm: done, refused, failed or missing",
    "alarms.since": "first night of the change",
    "alarms.raised": "night on which the change became significant",
    "alarms.closed": "null while the alarm is open",
    "alarms.severity": "part of a joint's torque that the fit no longer predicts",
    "alarms.slope": "of a drift, per day; slope_low and slope_high are its 95 % interval",
    "alarms.limit_date": "when a drift reaches the limit of the fleet file",
    "alarms.limit_early": "the same for the steepest slope of its 95 % interval",
    "alarms.limit_late": "the same for the flattest slope; null if that never reaches it",
    "alarms.reported": "size when it was last reported",
    "judged": "nights that have been judged, and when",
    "calls": "calls of lieid fleet",
    "calls.counts": "JSON: status and number of arm-nights",
    "latest": "the newest run of every arm in service with its present fit",
    "sisters": "median and robust spread of coefficients over the arms with the same robot",
}
#: The newest run of every arm in service with its present fit, outside of maintenance; and the
#: coefficients of arms with the same robot on these nights.
VIEWS = {
    "latest": "SELECT r.* FROM runs r JOIN arms a USING (serial, fit_sha256) "
    "WHERE r.status = 'done' AND a.retired IS NULL AND NOT EXISTS (SELECT 1 FROM maintenance m "
    "WHERE m.serial = r.serial AND r.date BETWEEN m.first AND m.last) QUALIFY row_number() "
    "OVER (PARTITION BY r.serial ORDER BY r.date DESC, r.started DESC) = 1",
    "sisters": "SELECT a.robot, p.name, p.joint, any_value(p.unit) AS unit, count(*) AS arms, "
    "median(p.value) AS median, 1.4826 * mad(p.value) AS spread FROM latest l JOIN arms a "
    "USING (serial) JOIN parameters p USING (run_id, serial) GROUP BY a.robot, p.name, p.joint",
}
OF_ARMS = "serial IN (SELECT unnest($serials))"
#: Expected nights of arms, with the best status of their recordings.
NIGHTS = f"""
INSERT INTO nights
WITH known AS (
    SELECT serial, date, CASE WHEN bool_or(status = 'done') THEN 'done'
        WHEN bool_or(status = 'failed') THEN 'failed' ELSE 'refused' END AS status
    FROM runs WHERE {OF_ARMS} GROUP BY serial, date
), spans AS (
    SELECT serial, least(any_value(a.since), min(k.date)) AS first
    FROM arms a LEFT JOIN known k USING (serial)
    WHERE {OF_ARMS} GROUP BY serial
), expected AS (
    SELECT serial, unnest(generate_series(first, $newest, INTERVAL 1 DAY))::DATE AS date FROM spans
    UNION SELECT serial, date FROM known
)
SELECT serial, date, coalesce(status, 'missing') FROM expected LEFT JOIN known USING (serial, date)
WHERE NOT EXISTS (
    SELECT 1 FROM maintenance m
    WHERE m.serial = expected.serial AND date BETWEEN m.first AND m.last)
"""


@dataclass(frozen=True)
class ArmEntry:
    """An arm of the fleet file, as the history keeps it."""

    serial: str
    robot: str
    joints: int
    fit_sha256: str  # empty if the fit cannot be read
    limits: Mapping[str, Sequence[float]] = field(default_factory=dict)
    fit: str = ""  # path
    fit_from: date | None = None  # first night that is judged by this fit
    maintenance: tuple[tuple[date, date], ...] = ()


class HistoryInUse(FleetError):
    """Another process has the history open."""


class History(AbstractContextManager["History"]):
    """A history, open for changes or, with ``read_only``, for reading.

    What a killed process has left beside the file is continued, unless the file was changed since.
    With ``read_only`` the history must exist, without ``new`` as well.
    """

    def __init__(
        self, path: str | Path, *, read_only: bool = False, wait: float = 0.0, new: bool = True
    ) -> None:
        self.path, self._file = str(path), Path(os.path.realpath(path))
        self._is_new = not self._file.exists()
        self._copy = None if read_only else copy_of(path)
        if (read_only or not new) and self._is_new:
            raise FleetError(f"{path}: no such file; expected a history that lieid fleet wrote")
        with ExitStack() as stack:
            if self._copy is not None:
                check_file(path)
                with reported(path):
                    self._file.parent.mkdir(parents=True, exist_ok=True)
                stack.enter_context(_locked(self._file, wait))
                files = (self._file, self._copy), (_log_of(self._file), _log_of(self._copy))
                if self._is_new or _changed(self._copy) < _changed(self._file):
                    for source, copy in files:  # the log is that of a process that was killed
                        copy.unlink(missing_ok=True)
                        if source.exists():
                            copy_file(source, copy)
            try:
                self.connection = _connect(self._copy or self._file, self.path, read_only)
                stack.callback(self.connection.close)
                if not read_only:
                    _prepare(self.connection, self.path)
                elif _schema_of(self.connection, self.path) < SCHEMA:
                    raise FleetError(f"{path}: an older schema; run lieid fleet once to migrate it")
            except FleetError:
                if self._copy is not None:
                    self._copy.unlink(missing_ok=True)
                raise
            if self._is_new:
                self.publish()  # for readers from the first minute of the first run on
            self._open = stack.pop_all()

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Close the history; a new one without runs is removed after an error."""
        unused = kind is not None and self._is_new and not self.rows("SELECT 1 FROM runs LIMIT 1")
        with self._open:
            if self._copy is not None:
                self.publish()
                self.connection.close()
                self._copy.unlink()
            for file in (self._file, copy_of(self._file, kind="read")) if unused else ():
                file.unlink(missing_ok=True)

    def publish(self) -> None:
        """Replace the file by everything that is committed."""
        assert self._copy is not None
        self.connection.execute("CHECKPOINT")
        copy_file(self._copy, self._file)
        _log_of(self._file).unlink(missing_ok=True)
        link = copy_of(self._file, kind="read")  # the name in earlier versions
        if not link.is_symlink():
            link.unlink(missing_ok=True)
            with suppress(OSError):  # of file systems without links
                link.symlink_to(self._file.name)

    def rows(self, query: str, values: Sequence[object] = ()) -> list[tuple[Any, ...]]:
        """Return the rows of an SQL query."""
        return self.connection.execute(query, list(values)).fetchall()

    def insert(self, table: str, rows: Sequence[Sequence[object]]) -> None:
        """Add rows to a table, in the order of its columns."""
        if rows:
            every = ", ".join(["(" + ", ".join("?" * len(rows[0])) + ")"] * len(rows))
            values = [x for row in rows for x in row]
            self.connection.execute(f"INSERT INTO {table} VALUES {every}", values)

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Commit all changes of a context together, or none of them."""
        self.connection.execute("BEGIN")
        try:
            yield
        except BaseException:
            self.connection.execute("ROLLBACK")
            raise
        self.connection.execute("COMMIT")

    def add(self, batch: Batch) -> None:
        """Add finished runs with all their rows in one transaction; none is repeated."""
        with self.transaction():
            for table in (*ROWS, "repeats", "runs"):  # runs last: the others join them
                if table in batch.tables:
                    self.connection.register("part", batch.tables[table])
                    new = "" if table == "repeats" else "ANTI JOIN runs USING (run_id)"
                    self.connection.execute(f"INSERT INTO {table} BY NAME FROM part {new}")
                    self.connection.unregister("part")

    def finished(
        self, serials: Sequence[str], method: int | None = None
    ) -> tuple[set[tuple[str, ...]], dict[str, frozenset[str]]]:
        """Return the files of arms (`ArmNight.key`) that have runs, and the identities of these."""
        kept = (
            "WITH kept AS (SELECT * FROM runs WHERE status <> 'failed' AND "
            "serial IN (SELECT unnest(?)) AND (? IS NULL OR method = ?)) "
        )
        values: list[object] = [list(serials), method, method]
        files = self.rows(
            kept + "SELECT serial, recording, stamp, fit_sha256, condition FROM kept UNION ALL "
            "SELECT p.serial, p.recording, p.stamp, r.fit_sha256, r.condition "
            "FROM repeats p JOIN kept r USING (run_id)",
            values,
        )
        runs = self.rows(kept + "SELECT serial, list(run_id) FROM kept GROUP BY serial", values)
        return set(files), {serial: frozenset(own) for serial, own in runs}

    def set_arms(self, arms: Iterable[ArmEntry], *, first: date | None = None) -> None:
        """Store the arms of the fleet file; ``first`` is the first night of those that are new."""
        known = dict(self.rows("SELECT serial, since FROM arms"))
        # of an arm whose fit cannot be read, the history keeps that of earlier nights
        fresh = [arm for arm in arms if arm.fit_sha256 or arm.serial not in known]
        own = {"serials": [arm.serial for arm in fresh]}
        with self.transaction():
            for table in ("arms", "maintenance"):
                self.connection.execute(f"DELETE FROM {table} WHERE {OF_ARMS}", own)
            self.insert("arms", [
                (
                    arm.serial, arm.robot, arm.joints, arm.fit_sha256, json.dumps(dict(arm.limits)),
                    known.get(arm.serial, first), arm.fit_from, None, arm.fit,
                )
                for arm in fresh
            ])  # fmt: skip
            self.insert("maintenance", [(a.serial, *span) for a in fresh for span in a.maintenance])

    def set_nights(self, serials: Sequence[str], newest: date) -> list[tuple[str, date, str]]:
        """Write the expected nights of arms; return arms with a newest one that is not done."""
        own = {"serials": list(serials)}
        with self.transaction():
            self.connection.execute(f"DELETE FROM nights WHERE {OF_ARMS}", own)
            self.connection.execute(NIGHTS, own | {"newest": newest})
        return self.connection.execute(
            "SELECT serial, max(date), arg_max(status, date) AS status FROM nights "
            f"WHERE {OF_ARMS} GROUP BY serial HAVING status <> 'done' ORDER BY 1",
            own,
        ).fetchall()


def copy_of(path: str | Path, *, kind: str = "run") -> Path:
    """Return the path of the copy that is changed, or of the link to the file, ``read``."""
    file = Path(os.path.realpath(path))
    return file.with_name(f"{file.stem}.{kind}{file.suffix}")


def left_beside(path: str | Path) -> Path:
    """Return the file with acknowledgements that a run is to record, as lines of JSON."""
    file = Path(os.path.realpath(path))
    return file.with_name(f"{file.stem}.acknowledged")


def _log_of(file: Path) -> Path:
    """Return the path of DuckDB's log, whose content is not in the file yet."""
    return file.with_name(f"{file.name}.wal")


def _changed(file: Path) -> int:
    """Return when a file or its log was changed last; 0 without the file, whatever log is left."""
    files = (file, _log_of(file)) if file.exists() else ()
    return max((each.stat().st_mtime_ns for each in files if each.exists()), default=0)


def copy_file(source: str | Path, target: str | Path) -> None:
    """Copy a file; the target is replaced as a whole."""
    with atomic_binary(target) as file, open(source, "rb") as content:
        shutil.copyfileobj(content, file, 2**20)


def backup(path: str | Path, target: str | Path) -> bool:
    """Write a history as one complete file; return whether it is of now."""
    is_of_now = True
    if copy_of(path).exists() or _log_of(Path(path)).exists():
        try:
            with History(path, new=False):
                pass  # what a run that was killed has left is written into the file
        except HistoryInUse:
            is_of_now = False
    copy_file(path, target)
    return is_of_now


@contextmanager
def _locked(file: Path, wait: float) -> Iterator[None]:
    """Lock a history for changes; the lock ends with the process at the latest."""
    path, end = file.with_name(f"{file.name}.lock"), time.monotonic() + wait
    while True:
        with reported(path):
            lock = open(path, "a+", encoding="utf-8")  # noqa: SIM115
        with lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                lock.seek(0)
                if time.monotonic() >= end:
                    raise HistoryInUse(
                        f"{file}: in use by process {lock.read()}; run this command again when "
                        "that has finished, or with --wait S"
                    ) from None
                time.sleep(0.5)
                continue
            if not _is_at(path, os.fstat(lock.fileno())):
                continue  # the process that held it has removed it since
            lock.truncate(0)
            lock.write(str(os.getpid()))
            lock.flush()
            try:
                yield
            finally:
                path.unlink()
            return


def _is_at(path: Path, status: os.stat_result) -> bool:
    """Whether an open file is still the one of this name."""
    with suppress(FileNotFoundError):
        return os.path.samestat(path.stat(), status)
    return False


def _connect(opened: Path, path: str, read_only: bool) -> DuckDBPyConnection:
    with of_extra("fleet", "fleets need duckdb; install it with"):
        import duckdb
    try:
        return duckdb.connect(str(opened), read_only=read_only, config={"memory_limit": MEMORY})
    except duckdb.Error as error:
        raise FleetError(
            f"{path}: not a history of lieid fleet, or a program has it open for changes "
            f"({reason_of(error)})"
        ) from None


def _prepare(connection: DuckDBPyConnection, path: str) -> None:
    """Make the tables of a new file; those of an older schema keep the columns that both have."""
    tables = connection.execute("SHOW TABLES").fetchall()
    if tables and _schema_of(connection, path) == SCHEMA:
        return
    connection.execute("BEGIN")
    for name, columns in TABLES.items():
        if (name,) in tables:
            connection.execute(f"ALTER TABLE {name} RENAME TO old_{name}")
        connection.execute(f"CREATE TABLE {name} ({columns})")
        if (name,) in tables:
            own = {row[0] for row in connection.execute(f"DESCRIBE {name}").fetchall()}
            old = connection.execute(f"DESCRIBE old_{name}").fetchall()
            both = ", ".join(
                f"{x} AT TIME ZONE 'UTC' AS {x}" if kind == "TIMESTAMP" else x
                for x, kind, *_ in old
                if x in own
            )
            connection.execute(f"INSERT INTO {name} BY NAME SELECT {both} FROM old_{name}")
            connection.execute(f"DROP TABLE old_{name}")
    if tables:
        connection.execute("UPDATE history SET schema = ?", [SCHEMA])
    else:
        connection.execute("INSERT INTO history VALUES (?)", [SCHEMA])
    for name, query in VIEWS.items():
        connection.execute(f"CREATE OR REPLACE VIEW {name} AS {query}")
    for name, text in COMMENTS.items():
        kind = "COLUMN" if "." in name else "VIEW" if name in VIEWS else "TABLE"
        quoted = text.replace("'", "''")
        connection.execute(f"COMMENT ON {kind} {name} IS '{quoted}'")
    connection.execute("COMMIT")


def _schema_of(connection: DuckDBPyConnection, path: str) -> int:
    """Return the schema of a history, which must be known."""
    tables = connection.execute("SHOW TABLES").fetchall()
    row = connection.execute("FROM history").fetchone() if ("history",) in tables else None
    if row is None:
        raise FleetError(
            f"{path}: not a history of lieid fleet; expected one, or the name of a new file"
        )
    if row[0] > SCHEMA:
        raise FleetError(
            f"{path}: schema {row[0]} is newer than {SCHEMA}, the newest supported by this "
            "version; update lieid-casadi"
        )
    return int(row[0])
