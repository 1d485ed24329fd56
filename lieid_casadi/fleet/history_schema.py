"""Tables of a history file, and migrations from older schemas."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lieid_casadi.errors import FleetError

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
