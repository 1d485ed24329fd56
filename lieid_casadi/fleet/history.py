"""The history of a fleet: one DuckDB file with all runs, written by one process at a time."""

from __future__ import annotations

import json
import re
import secrets
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from datetime import UTC, date, datetime
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from lieid_casadi.atomic_file import check_file, reported
from lieid_casadi.errors import FleetError, MissingDependency
from lieid_casadi.fleet.night_result import ArmNight, NightResult
from lieid_casadi.messages import reason_of

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection


SCHEMA = 3
TABLES = {
    "runs": "run_id VARCHAR PRIMARY KEY, serial VARCHAR, recording VARCHAR, "
    "recording_sha256 VARCHAR, fit_sha256 VARCHAR, version VARCHAR, started TIMESTAMP, "
    "seconds DOUBLE, status VARCHAR, reason VARCHAR, date DATE, stamp VARCHAR, condition VARCHAR, "
    "payload VARCHAR",
    "findings": "run_id VARCHAR, serial VARCHAR, date DATE, effect VARCHAR, joint INTEGER, "
    "change DOUBLE, std DOUBLE, unit VARCHAR, severity DOUBLE, sentence VARCHAR",
    "parameters": "run_id VARCHAR, serial VARCHAR, date DATE, name VARCHAR, joint INTEGER, "
    "value DOUBLE, std DOUBLE, unit VARCHAR",
    "errors": "run_id VARCHAR, serial VARCHAR, date DATE, joint INTEGER, rms_moving DOUBLE, "
    "noise_floor DOUBLE, expected DOUBLE, torque_rms DOUBLE, temperature DOUBLE, "
    "q_low DOUBLE, q_high DOUBLE, q_mean DOUBLE, q_std DOUBLE",
    "checks": "run_id VARCHAR, serial VARCHAR, date DATE, name VARCHAR, message VARCHAR",
    "repeats": "serial VARCHAR, recording VARCHAR, stamp VARCHAR, run_id VARCHAR",
    "arms": "serial VARCHAR PRIMARY KEY, robot VARCHAR, joints INTEGER, fit_sha256 VARCHAR, "
    "limits VARCHAR",
    "alarms": "serial VARCHAR, joint INTEGER, quantity VARCHAR, since DATE, last DATE, "
    "change DOUBLE, std DOUBLE, unit VARCHAR, sentence VARCHAR, raised DATE, closed DATE, "
    "note VARCHAR, severity DOUBLE, slope DOUBLE, limit_date DATE, series VARCHAR, "
    "slope_low DOUBLE, slope_high DOUBLE",
    "acknowledgements": "serial VARCHAR, joint INTEGER, date DATE, note VARCHAR, written TIMESTAMP",
    "judged": "date DATE, written TIMESTAMP",
    "history": "schema INTEGER, kept_from DATE",
}
#: Statements that lead from a schema to the next one.
MIGRATIONS: dict[int, tuple[str, ...]] = {
    1: (  # bounds of a drift's slope in place of its standard deviation
        "ALTER TABLE alarms DROP COLUMN slope_std",
        "ALTER TABLE alarms ADD COLUMN slope_low DOUBLE",
        "ALTER TABLE alarms ADD COLUMN slope_high DOUBLE",
    ),
    2: (  # what identifies the motion of a night
        "ALTER TABLE runs ADD COLUMN payload VARCHAR",
        "ALTER TABLE errors ADD COLUMN q_low DOUBLE",
        "ALTER TABLE errors ADD COLUMN q_high DOUBLE",
        "ALTER TABLE errors ADD COLUMN q_mean DOUBLE",
        "ALTER TABLE errors ADD COLUMN q_std DOUBLE",
    ),
}


def prepare(connection: DuckDBPyConnection, path: str) -> None:
    """Make the tables of a new file, or migrate those of an older one.

    Raises
    ------
    FleetError
        The file has tables of another program, or of a newer schema.
    """
    tables = {row[0] for row in connection.execute("SHOW TABLES").fetchall()}
    connection.execute("BEGIN")
    if not tables:
        for name, columns in TABLES.items():
            connection.execute(f"CREATE TABLE {name} ({columns})")
        connection.execute("INSERT INTO history VALUES (?, NULL)", [SCHEMA])
    else:
        schema = schema_of(connection, path)
        for step in range(schema, SCHEMA):
            for statement in MIGRATIONS[step]:
                connection.execute(statement)
        connection.execute("UPDATE history SET schema = ?", [SCHEMA])
    connection.execute("COMMIT")


def schema_of(connection: DuckDBPyConnection, path: str) -> int:
    """Return the schema of a history.

    Raises
    ------
    FleetError
        It is not a history, or of a newer schema.
    """
    tables = {row[0] for row in connection.execute("SHOW TABLES").fetchall()}
    row = None
    if "history" in tables:
        row = connection.execute("SELECT schema FROM history").fetchone()
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


#: Tables with rows of a run.
RUN_TABLES = ("findings", "parameters", "errors", "checks")


class History(AbstractContextManager["History"]):
    """A history file, open for writing or for reading only.

    Parameters
    ----------
    path : str or Path
    read_only : bool
        The file must exist. DuckDB permits any number of readers, or one writer.

    Raises
    ------
    FleetError
        Another process has the file open, or it is not a history.
    """

    def __init__(self, path: str | Path, *, read_only: bool = False) -> None:
        self.path = str(path)
        self._is_new = not Path(path).exists()
        if read_only and not Path(path).exists():
            raise FleetError(f"{path}: no such file; expected a history that lieid fleet wrote")
        if not read_only:
            check_file(path)
            with reported(path):
                Path(path).absolute().parent.mkdir(parents=True, exist_ok=True)
        self.connection = _connect(self.path, read_only=read_only)
        try:
            if not read_only:
                prepare(self.connection, self.path)
            elif schema_of(self.connection, self.path) < SCHEMA:
                raise FleetError(f"{path}: an older schema; run lieid fleet once to migrate it")
        except BaseException:
            self.connection.close()
            raise

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file; what was committed is in it, and a new file without runs is removed."""
        unused = kind is not None and self._is_new and not self.rows("SELECT 1 FROM runs LIMIT 1")
        self.connection.close()
        if unused:
            Path(self.path).unlink(missing_ok=True)

    def rows(self, query: str, values: Sequence[object] = ()) -> list[tuple[Any, ...]]:
        """Return the rows of an SQL query."""
        return self.connection.execute(query, list(values)).fetchall()

    def record(self, night: ArmNight, result: NightResult, started: datetime) -> None:
        """Add a run with all its rows, in one transaction; a run that is there is not repeated.

        Parameters
        ----------
        night : ArmNight
        result : NightResult
        started : datetime
            UTC.
        """
        from lieid_casadi import __version__

        run_id = night.run_id(result.recording_sha256, __version__)
        if result.repeated:
            self.insert("repeats", [(night.serial, night.recording, night.stamp, run_id)])
            return
        if result.status == "failed":
            run_id = secrets.token_hex(16)
        key = (run_id, night.serial, night.date)
        with self.transaction():
            if self.rows("SELECT 1 FROM runs WHERE run_id = ?", [run_id]):
                return
            self.insert(
                "runs",
                [
                    (
                        run_id, night.serial, night.recording, result.recording_sha256,
                        night.fit_sha256, __version__, started.astimezone(UTC).replace(tzinfo=None),
                        result.seconds, result.status, result.reason, night.date, night.stamp,
                        night.condition, result.payload,
                    )
                ],
            )  # fmt: skip
            for table in RUN_TABLES:
                self.insert(table, [key + _values(row) for row in getattr(result, table)])

    def insert(self, table: str, rows: Sequence[Sequence[object]]) -> None:
        """Add rows to a table, in the order of its columns."""
        if rows:
            one = "(" + ", ".join("?" * len(rows[0])) + ")"
            every = ", ".join([one] * len(rows))
            self.connection.execute(
                f"INSERT INTO {table} VALUES {every}", [value for row in rows for value in row]
            )

    def transaction(self) -> AbstractContextManager[None]:
        """Return a context whose changes are committed together, or not at all."""
        return _Transaction(self.connection)

    def finished(self, version: str) -> tuple[set[tuple[str, ...]], dict[str, set[str]]]:
        """Return the files that are in the history, and the identities of the runs of each arm.

        Files are (serial, recording, stamp, fit_sha256, condition); failed runs are left out,
        since they are tried again.
        """
        files = self.rows(
            "SELECT serial, recording, stamp, fit_sha256, condition FROM runs "
            "WHERE status <> 'failed' AND version = ? UNION ALL "
            "SELECT p.serial, p.recording, p.stamp, r.fit_sha256, r.condition "
            "FROM repeats p JOIN runs r USING (run_id) WHERE r.version = ?",
            [version, version],
        )
        runs: dict[str, set[str]] = {}
        for serial, run_id in self.rows(
            "SELECT serial, run_id FROM runs WHERE status <> 'failed' AND version = ?", [version]
        ):
            runs.setdefault(serial, set()).add(run_id)
        return set(files), runs

    def set_arms(self, arms: Iterable[tuple[str, str, int, str, Mapping[str, Any]]]) -> None:
        """Store serial, robot, number of joints, fit and limits of each arm."""
        with self.transaction():
            for serial, robot, joints, fit_sha256, limits in arms:
                self.connection.execute(
                    "INSERT OR REPLACE INTO arms VALUES (?, ?, ?, ?, ?)",
                    [serial, robot, joints, fit_sha256, json.dumps(dict(limits))],
                )

    @property
    def kept_from(self) -> date | None:
        """First night that retention has kept; None if nothing was removed."""
        ((kept,),) = self.rows("SELECT kept_from FROM history")
        return kept  # type: ignore[no-any-return]

    def remove_before(self, first: date) -> int:
        """Remove runs of nights before a date, and their rows; return the number of runs."""
        with self.transaction():
            old = self.rows("SELECT run_id FROM runs WHERE date < ?", [first])
            for table in (*RUN_TABLES, "repeats", "runs"):
                self.connection.execute(
                    f"DELETE FROM {table} WHERE run_id IN (SELECT run_id FROM runs WHERE date < ?)",
                    [first],
                )
            self.connection.execute("UPDATE history SET kept_from = ?", [first])
        return len(old)

    def export_parquet(self, folder: Path) -> tuple[Path, ...]:
        """Write every table as a Parquet file into a folder that exists."""
        written = []
        for table in TABLES:
            path = folder / f"{table}.parquet"
            self.connection.execute(f"COPY {table} TO '{_quoted(path)}' (FORMAT parquet)")
            written.append(path)
        return tuple(written)


class _Transaction(AbstractContextManager[None]):
    def __init__(self, connection: DuckDBPyConnection) -> None:
        self._connection = connection

    def __enter__(self) -> None:
        self._connection.execute("BEGIN")

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._connection.execute("COMMIT" if kind is None else "ROLLBACK")


def _connect(path: str, *, read_only: bool) -> DuckDBPyConnection:
    try:
        import duckdb
    except ImportError:
        raise MissingDependency(
            "fleets need duckdb; install it with: pip install 'lieid-casadi[fleet]'"
        ) from None
    try:
        return duckdb.connect(path, read_only=read_only)
    except duckdb.Error as error:
        text = str(error)
        process = re.search(r"PID (\d+)", text)
        if "lock" in text:
            holder = f"process {process[1]}" if process else "another process"
            raise FleetError(
                f"{path}: in use by {holder}; run this command again when that has finished"
            ) from None
        raise FleetError(
            f"{path}: not a DuckDB file; expected a history that lieid fleet wrote "
            f"({reason_of(error)})"
        ) from None


def _values(row: object) -> tuple[object, ...]:
    return row if isinstance(row, tuple) else tuple(vars(row).values())


def _quoted(path: Path) -> str:
    return str(path).replace("'", "''")
