"""Alarms: raised once per cause, named, dated, acknowledged."""

import shutil
from datetime import timedelta

import pytest
from fleet.synthetic_history import FIRST, write_history

from lieid_casadi.cli.main import main
from lieid_casadi.errors import FleetError
from lieid_casadi.fleet.alarms import acknowledge, judge_new_nights, open_alarms, read_alarms
from lieid_casadi.fleet.history import SCHEMA, History

ARMS = [f"A{k}" for k in range(6)]
WORN_FROM, LOADED_FROM = 6, 8


def changed(serial, k):
    """Return wear of A1 by 1 % per night, a body on the tool of A2, an unknown change of A3."""
    if serial == "A1" and k >= WORN_FROM:
        return {"grown": {("coulomb.f_c", 2): 0.02 * (k - WORN_FROM + 1)}}
    if serial == "A2" and k >= LOADED_FROM:
        return {
            "errors": {1: 3.0, 2: 2.0},
            "grown": {("coulomb.f_c", 1): 0.2},
            "findings": [("payload", None, 0.8), ("coulomb", 1, 0.2)][: 1 + (k == LOADED_FROM)],
        }
    if serial == "A3" and k >= LOADED_FROM:
        return {"errors": {2: 1.5}, "findings": [("unexplained", 2, 0.1)]}
    if serial == "A4" and k == 7:  # one odd night
        return {"errors": {1: 2.0, 2: 2.0}}
    return {}


@pytest.fixture(scope="module")
def judged_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("judged") / "h.duckdb"
    write_history(path, 14, ARMS, changed, limits={"coulomb": [9.0, 2.5]})
    with History(path) as history:
        return path, judge_new_nights(history)


@pytest.fixture
def judged(judged_file, tmp_path):
    """A copy of a history with all its alarms, open, and the new alarms."""
    path, new = judged_file
    with History(shutil.copy(path, tmp_path / "h.duckdb")) as history:
        yield history, new


def test_one_alarm_per_cause_with_name_and_beginning(judged):
    history, new = judged
    alarms = {alarm.serial: alarm for alarm in read_alarms(history)}
    assert len(new) == 3
    assert set(alarms) == {"A1", "A2", "A3"}
    wear, load, other = alarms["A1"], alarms["A2"], alarms["A3"]
    assert (wear.quantity, wear.joint, wear.unit) == ("coulomb", 2, "N·m")
    assert abs((wear.since - FIRST).days - WORN_FROM) <= 2
    assert abs(wear.change - 0.16) < 4.0 * wear.std
    assert wear.slope_low < wear.slope < wear.slope_high
    assert 0.012 < wear.slope_low < 0.02 < wear.slope_high < 0.028
    assert abs((wear.limit_date - (FIRST + timedelta(days=30))).days) <= 3
    assert wear.limit_early < wear.limit_date < wear.limit_late
    assert wear.limit_early <= FIRST + timedelta(days=30) <= wear.limit_late
    assert f"({wear.limit_early} to {wear.limit_late})" in wear.sentence
    assert "per day (95 %)" in wear.sentence
    assert wear.raised - wear.since <= timedelta(days=6)
    assert (load.quantity, load.joint, load.change) == ("payload", None, 0.8)
    assert load.since == load.raised == FIRST + timedelta(days=LOADED_FROM)
    assert (other.quantity, other.joint) == ("unexplained", 2)
    assert other.since == FIRST + timedelta(days=LOADED_FROM)
    assert all(alarm.last == FIRST + timedelta(days=13) for alarm in alarms.values())
    assert alarms["A2"].severity > alarms["A1"].severity > 0.0


@pytest.mark.slow
def test_an_acknowledged_alarm_starts_a_new_baseline(tmp_path):
    path = write_history(tmp_path / "h.duckdb", 12, ARMS, changed)
    with History(path) as history:
        judge_new_nights(history)
        acknowledge(history, "A2", note="gripper taken off")
        with pytest.raises(FleetError, match="no arm 'B9'"):
            acknowledge(history, "B9", note="x")
        with pytest.raises(FleetError, match="no joint 3; expected 1 to 2"):
            acknowledge(history, "A2", joint=3, note="x")
        (closed,) = [a for a in read_alarms(history) if a.serial == "A2"]
        assert closed.note == "gripper taken off"
        assert closed.closed == FIRST + timedelta(days=11)
    # the body stays, which is now the normal state of the arm
    write_history(path, 20, ARMS, changed)
    with History(path) as history:
        assert judge_new_nights(history) == []
        assert {a.serial for a in read_alarms(history, open_only=True)} == {"A1", "A3"}
        acknowledge(history, "A1", joint=1, note="another joint")
        assert len(open_alarms(history, "A1", None)) == 1
        acknowledge(history, "A1", joint=2, note="greased")
        assert open_alarms(history, "A1", None) == []


def test_the_first_alarm_is_possible_on_the_fourth_night(tmp_path):
    def loaded(serial, k):
        loaded = serial == "A0" and k >= 2
        return {"errors": {1: 4.0}, "findings": [("payload", None, 1.0)]} if loaded else {}

    path = tmp_path / "h.duckdb"
    for nights in (3, 4):
        write_history(path, nights, ARMS, loaded)
        with History(path) as history:
            new = judge_new_nights(history)
        assert [a.serial for a in new] == (["A0"] if nights == 4 else [])


@pytest.mark.parametrize("nights_found", [1, 4])
def test_another_motion_neither_renames_an_alarm_nor_raises_another(tmp_path, nights_found):
    """The coefficients of an arm with a body on its tool depend on the motion."""

    def loaded(serial, k):
        if serial != "A0" or k < 5:
            return {}
        again = [("viscous", 2, 0.2)] if 11 <= k < 11 + nights_found else []
        moved = {("coulomb.f_c", 1): 3.0, ("viscous.f_v", 2): 3.0} if k >= 11 else {}
        return {
            "errors": {1: 1.3, 2: 1.3},
            "grown": {("coulomb.f_c", 1): 0.2} | moved,
            "findings": [("payload", None, 0.8), *again],
        }

    path = write_history(tmp_path / "h.duckdb", 15, ARMS, loaded)
    with History(path) as history:
        judge_new_nights(history)
        alarms = {alarm.quantity: alarm for alarm in read_alarms(history)}
    assert set(alarms) == ({"payload"} if nights_found == 1 else {"payload", "viscous"})
    assert (alarms["payload"].since - FIRST).days == 5
    assert alarms["payload"].last == FIRST + timedelta(days=14)


@pytest.mark.parametrize("nights_found", [1, 4])
def test_after_a_lasting_change_only_what_diagnoses_find_raises_an_alarm(tmp_path, nights_found):
    def loaded(serial, k):
        if serial != "A0" or k < 5:
            return {}
        again = [("viscous", 2, 0.2)] if 15 <= k < 15 + nights_found else []
        moved = {("coulomb.f_c", 1): 3.0, ("viscous.f_v", 2): 3.0} if k >= 15 else {}
        return {"errors": {1: 1.3}, "grown": moved, "findings": [("payload", None, 0.8), *again]}

    path = tmp_path / "h.duckdb"
    for nights in (10, 19):
        write_history(path, nights, ARMS, loaded)
        with History(path) as history:
            judge_new_nights(history)
            if nights == 10:
                acknowledge(history, "A0", note="the body stays")
            alarms = [alarm.quantity for alarm in read_alarms(history, open_only=True)]
    assert alarms == ([] if nights_found == 1 else ["viscous"])


@pytest.mark.slow
def test_report_export_and_acknowledge_by_command(judged_file, tmp_path, capsys):
    shutil.copy(judged_file[0], tmp_path / "h.duckdb")
    path, page, metrics = (str(tmp_path / name) for name in ("h.duckdb", "r.html", "fleet.prom"))
    assert main(["fleet", "report", path, "--html", page, "--json", str(tmp_path / "a.json")]) == 0
    shown = capsys.readouterr().out
    assert "A2: payload of the arm since 2026-01-09" in shown
    text = (tmp_path / "r.html").read_text("utf-8")
    assert "3 of them have changed" in text
    assert text.index(">A2<") < text.index(">A3<")  # sorted by severity
    assert "check what is mounted on the tool" in text
    for arm in ARMS:
        assert f"{arm} (robot)" in text
    assert main(["fleet", "export", path, "--prometheus", metrics]) == 0
    lines = (tmp_path / "fleet.prom").read_text("utf-8").splitlines()
    samples = [line for line in lines if not line.startswith("#")]
    assert any(
        line.startswith('lieid_fleet_alarm{serial="A1",joint="2",quantity="coulomb"')
        for line in samples
    )
    assert all(float(line.rpartition(" ")[2]) >= 0.0 for line in samples)
    assert main(["fleet", "acknowledge", path, "A1", "--joint", "2", "--note", "greased"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "1 alarm of joint 2 closed" in shown
    assert "identify the arm again: lieid identify ROBOT A1/2026-01-14.csv" in shown
    assert "A1-2026-01-15.json, from: 2026-01-15}" in shown
    for words in (
        ["report", "none"],
        ["acknowledge", "none", "A1", "--note", "x"],
    ):
        assert main(["fleet", *words]) == 2
        assert capsys.readouterr().err.count("\n") == 1


def test_a_history_of_an_older_schema_is_migrated(judged_file, tmp_path):
    path = shutil.copy(judged_file[0], tmp_path / "h.duckdb")
    with History(path) as history:
        for statement in (
            "ALTER TABLE alarms ADD COLUMN x DOUBLE", "ALTER TABLE alarms DROP COLUMN slope_low",
            "ALTER TABLE alarms DROP COLUMN reported", "ALTER TABLE errors DROP COLUMN q_low",
            "DROP TABLE nights", "DROP VIEW latest",
            "ALTER TABLE runs ALTER started TYPE TIMESTAMP",
            "UPDATE runs SET started = '2026-01-02 03:04:05'", "UPDATE history SET schema = 1",
        ):  # fmt: skip
            history.connection.execute(statement)
    with pytest.raises(FleetError, match="older schema"):
        History(path, read_only=True)
    with History(path) as migrated:
        assert len(read_alarms(migrated)) == 3
        assert migrated.rows("SELECT schema FROM history") == [(SCHEMA,)]
        assert migrated.rows("SELECT count(*) FROM latest") == [(6,)]
        assert migrated.rows("SELECT count(*) FROM nights") == [(0,)]
        utc = "SELECT DISTINCT epoch(started), typeof(started) FROM runs"
        assert migrated.rows(utc) == [(1767323045.0, "TIMESTAMP WITH TIME ZONE")]
        assert migrated.rows(
            "SELECT comment FROM duckdb_columns() WHERE column_name = 'closed'"
        ) == [("null while the alarm is open",)]


def test_a_history_of_a_newer_schema_is_refused(tmp_path):
    path = tmp_path / "h.duckdb"
    with History(path) as history:
        history.connection.execute("UPDATE history SET schema = 99")
    with pytest.raises(FleetError, match="schema 99 is newer"):
        History(path)
