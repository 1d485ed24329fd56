"""A fleet through a year: silence, repairs, readers, versions, the alarm's command."""

import json
import os
import re
import shutil
import subprocess
import sys
from datetime import date, datetime, timedelta
from pathlib import Path

import duckdb
import numpy as np
import pytest
from fleet.synthetic_history import FIRST, drawn_result, write_history

from lieid_casadi.cli.main import main
from lieid_casadi.errors import FleetError
from lieid_casadi.fleet import cluster
from lieid_casadi.fleet import history as history_file
from lieid_casadi.fleet.alarms import Alarm, alarms_to_report, judge_new_nights, read_alarms
from lieid_casadi.fleet.arm_history import read_arms
from lieid_casadi.fleet.history import History
from lieid_casadi.fleet.night_result import NightResult

LAST = "2026-01-04"


@pytest.fixture
def call(fleet_folder, scheduler, monkeypatch):
    """Run the fleet of a folder; results are drawn, and nights are noted."""
    ran = []

    def drawn(night, content):
        ran.append(night)
        k = int(night.date[-2:])
        loaded = night.serial == "A1" and k >= 3 and not night.payloads
        changes = {"errors": {1: 5.0}, "findings": [("payload", None, 1.0)]} if loaded else {}
        random = np.random.default_rng([k, ord(night.serial[-1])])
        return drawn_result(random, night.serial, k, **changes)

    def run(*options):
        ran.clear()
        words = ["fleet", str(fleet_folder / "fleet.yaml"), "-o", str(fleet_folder / "h.duckdb")]
        return main([*words, "--scheduler", scheduler, "--night", LAST, "--exit-code", *options])

    monkeypatch.setattr(cluster, "run_arm_night", drawn)
    run.folder, run.ran = fleet_folder, ran
    return run


def rows(folder, query):
    with History(folder / "h.duckdb", read_only=True) as history:
        return history.rows(query)


def edit(folder, old, new):
    path = folder / "fleet.yaml"
    text = path.read_text("utf-8")
    assert old in text
    path.write_text(text.replace(old, new), "utf-8")


def test_an_arm_that_does_not_record_is_a_signal(call, capsys):
    nights = call.folder / "nights"
    shutil.rmtree(nights / "A1")
    (nights / "A1").mkdir()  # it never delivers
    (nights / "A2" / "2026-01-02.csv").unlink()
    (nights / "A2" / f"{LAST}.csv").write_bytes(b"")
    log = call.folder / "fleet.log"
    assert call("--log", str(log)) == 6
    assert f"A1: missing on {LAST}" in capsys.readouterr().out
    lines = [line.split(" ", 2) for line in log.read_text("utf-8").splitlines()]
    assert all(datetime.fromisoformat(when).tzinfo for when, _, _ in lines)
    assert ["WARNING", f"A1 {LAST}: missing"] in [line[1:] for line in lines]
    assert lines[-1][1] == "INFO"
    assert call("--most-failed", "1") == 0
    (nights / "A2" / f"{LAST}.csv").unlink()
    (nights / "A2" / "2026-01-03.csv").touch()
    assert call("--night", "2026-01-05", "--most-failed", "1") == 6
    found = rows(call.folder, "SELECT serial, date, status FROM nights ORDER BY 1, 2")
    assert [(serial, str(day)[-2:], status) for serial, day, status in found] == [
        ("A1", "04", "missing"), ("A1", "05", "missing"),
        ("A2", "01", "done"), ("A2", "02", "missing"), ("A2", "03", "done"), ("A2", "04", "done"),
        ("A2", "05", "missing"),
    ]  # fmt: skip
    out = call.folder / "f.prom"
    assert main(["fleet", "export", str(call.folder / "h.duckdb"), "--prometheus", str(out)]) == 0
    text = out.read_text("utf-8")
    assert 'lieid_fleet_last_success_timestamp{serial="A1"} 0.0' in text
    assert 'lieid_fleet_nights_missing{serial="A1"} 2.0' in text
    assert 'lieid_fleet_nights_missing{serial="A2"} 2.0' in text
    assert 'lieid_fleet_newest_night_done{serial="A2"} 0.0' in text
    assert 'lieid_fleet_last_run{status="done"} 1.0' in text


def test_alarm_and_silence_together_are_status_7_until_the_arm_is_retired(call):
    assert call("--night", "2026-01-05") == 7
    path = str(call.folder / "h.duckdb")
    assert main(["fleet", "retire", path, "A1", "--date", "2026-01-05"]) == 0
    with History(path, read_only=True) as history:
        assert [arm.serial for arm in read_arms(history)] == ["A2"]
        assert [a.note for a in read_alarms(history)] == ["retired"]
        assert history.rows("SELECT DISTINCT serial FROM nights") == [("A2",)]


def test_a_payload_from_a_night_on_reruns_no_earlier_night(call, capsys):
    assert call() == 5
    path, entry = "recordings: nights/A1/*.csv", "payload: {mass: 1, com: [0, 0, 0], from: DAY}"
    edit(call.folder, path, f"{path}\n    {entry.replace('DAY', '2026-01-03')}")
    assert call() == 0
    assert {(n.serial, n.date) for n in call.ran} == {("A1", "2026-01-03"), ("A1", LAST)}
    assert all(n.payloads[0][1][0] == 1.0 for n in call.ran)
    assert "New alarm" not in capsys.readouterr().out.partition("2 done")[2]
    path = str(call.folder / "h.duckdb")
    assert main(["fleet", "acknowledge", path, "A1", "--note", "known"]) == 0
    assert "identify" not in capsys.readouterr().out  # it is as the fleet file states


def test_a_new_fit_starts_a_baseline_and_closes_the_alarms_before_it(call):
    assert call() == 5
    shutil.copy(call.folder / "fits/A2.json", call.folder / "fits/new.json")
    (call.folder / "nights" / "A1" / "2026-01-05.csv").write_bytes(b"x")
    both = "fit: [{path: fits/A1.json}, {path: fits/new.json, from: 2026-01-05}]"
    edit(call.folder, "fit: fits/A1.json", both)
    assert call("--night", "2026-01-05", "--most-failed", "1") == 0
    assert [n.date for n in call.ran] == ["2026-01-05"]
    with History(call.folder / "h.duckdb", read_only=True) as history:
        (alarm,) = read_alarms(history)
        arms = {arm.serial: arm for arm in read_arms(history)}
    assert (alarm.closed, alarm.note) == (date(2026, 1, 5), "new fit")
    assert [str(day) for day in arms["A1"].dates] == ["2026-01-05"]
    assert len(arms["A2"].dates) == 4


def test_nights_of_maintenance_are_left_out(call):
    path = "recordings: nights/A1/*.csv"
    edit(call.folder, path, f"{path}\n    maintenance: [{{from: 2026-01-03, to: {LAST}}}]")
    assert call() == 0
    assert {n.date for n in call.ran if n.serial == "A1"} == {"2026-01-01", "2026-01-02"}
    assert rows(call.folder, "SELECT count(*) FROM nights WHERE serial = 'A1'") == [(2,)]


def test_the_alarm_command_gets_each_alarm_once(call, capsys):
    out = call.folder / "alarms.jsonl"
    command = f"cat >> {out}"
    assert call("--on-alarm", command) == 5
    assert "New alarm: A1: payload of the arm since 2026-01-03" in capsys.readouterr().out
    assert call("--on-alarm", command) == 0
    (line,) = out.read_text("utf-8").splitlines()
    alarm = json.loads(line)
    assert (alarm["serial"], alarm["quantity"], alarm["closed"]) == ("A1", "payload", None)
    assert alarm["recording"].endswith(f"A1/{LAST}.csv")
    assert alarm["rivals"] == []
    assert alarm["command"].split()[:2] == ["lieid", "workbench"]
    assert alarm["command"].endswith(alarm["recording"])


def test_an_alarm_that_has_doubled_or_is_near_its_limit_is_reported_again(tmp_path):
    alarm = Alarm("A1", 2, "coulomb", FIRST, FIRST, 1.0, 0.1, "N·m", "text", FIRST)
    far, near = FIRST + timedelta(days=40), FIRST + timedelta(days=20)
    with History(tmp_path / "h.duckdb") as history:
        history.insert("alarms", [tuple(vars(alarm).values())])
        for size, limit, expected in (
            (1.0, None, 1), (1.9, far, 0), (2.0, far, 1), (3.9, near, 1), (3.9, near, 0),
            (4.0, near, 1),
        ):  # fmt: skip
            history.connection.execute(
                "UPDATE alarms SET change = ?, limit_date = ?", [size, limit]
            )
            assert len(alarms_to_report(history, horizon=30)) == expected
        history.connection.execute("UPDATE alarms SET change = 99, closed = ?", [FIRST])
        assert alarms_to_report(history, horizon=30) == []


def calls_in(path):
    """Number of calls, as read by another process."""
    code = (
        "import sys, duckdb\nhistory = duckdb.connect(sys.argv[1], read_only=True)\n"
        "print(*history.execute('SELECT count(*) FROM calls').fetchone())"
    )
    return subprocess.check_output([sys.executable, "-c", code, str(path)], text=True).strip()


def test_a_history_may_be_read_and_copied_while_a_run_changes_it(tmp_path, capsys):
    with History(tmp_path / "new.duckdb"):  # the first run, before its first batch
        assert main(["fleet", "report", str(tmp_path / "new.duckdb")]) == 0
    path = write_history(tmp_path / "h.duckdb", 5, ["A0", "A1"])
    code = (
        "import sys\nfrom lieid_casadi.fleet.history import History\n"
        "with History(sys.argv[1]) as h:\n"
        "    h.insert('calls', [(None, 1.0, '', '{}', 0)])\n"
        "    h.publish()\n"  # as after a batch of a run
        "    h.insert('calls', [(None, 1.0, '', '{}', 0)])\n    print('open', flush=True)\n"
        "    input()\n"
    )
    command = [sys.executable, "-c", code, str(path)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    os.link(path, tmp_path / "same")  # since DuckDB keeps one connection to a name in a process
    with duckdb.connect(str(tmp_path / "same"), read_only=True) as reader:  # all the time
        with subprocess.Popen(command, **pipes) as other:
            other.stdout.readline()
            for name in (path, tmp_path / "h.read.duckdb"):
                assert calls_in(name) == "1"
            assert main(["fleet", "report", str(path)]) == 0
            assert main(["fleet", "backup", str(path), str(tmp_path / "copy.duckdb")]) == 0
            assert "latest batch of the run in progress" in capsys.readouterr().out
            words = ["fleet", "acknowledge", str(path), "A1", "--note", "greased"]
            assert main(words) == 0
            assert "acknowledges this before it judges" in capsys.readouterr().out
            assert main([*words, "--joint", "9"]) == 2
            assert main(["fleet", "retire", str(path), "A1"]) == 2
            assert f"in use by process {other.pid}" in capsys.readouterr().err
            os.kill(other.pid, 9)  # what it has written since is beside the file
        assert reader.sql("SELECT count(*) FROM runs").fetchall() == [(10,)]
    assert calls_in(path) == "1"
    assert main(["fleet", "backup", str(path), str(tmp_path / "copy.duckdb")]) == 0
    with History(tmp_path / "copy.duckdb", read_only=True) as copy:
        assert copy.rows("SELECT count(*) FROM runs") == [(10,)]
        assert copy.rows("SELECT count(*) FROM calls") == [(2,)]
    with History(path) as history:
        judge_new_nights(history)
        (row,) = history.rows("SELECT serial, joint, date, note FROM acknowledgements")
        assert row == ("A1", None, FIRST + timedelta(days=4), "greased")
    assert {file.name for file in tmp_path.glob("h.*")} == {"h.duckdb", "h.read.duckdb"}
    assert main(["fleet", "backup", str(tmp_path / "none"), str(tmp_path / "x")]) == 2


def test_what_a_killed_run_has_left_does_not_replace_a_restored_history(tmp_path):
    path = write_history(tmp_path / "h.duckdb", 2, ["A0"])
    shutil.copy(path, tmp_path / "backup")
    write_history(path, 3, ["A0"])
    for restored, count in ((False, 3), (True, 2), (False, 2)):
        (tmp_path / "h.run.duckdb").write_bytes(path.read_bytes())
        if restored:
            shutil.copy(tmp_path / "backup", path)
        elif count == 2:  # a log without its file
            (tmp_path / "h.run.duckdb").rename(tmp_path / "h.run.duckdb.wal")
        with History(path) as history:
            assert history.rows("SELECT count(*) FROM runs") == [(count,)]


def test_a_file_that_is_no_history_is_left_alone(tmp_path):
    path = tmp_path / "fit.json"
    path.write_text("{}", encoding="utf-8")
    with pytest.raises(FleetError, match="not a history"):
        History(path)
    assert [file.name for file in tmp_path.iterdir()] == ["fit.json"]


def test_the_memory_of_a_large_history_is_bounded(tmp_path, monkeypatch):
    monkeypatch.setattr(history_file, "MEMORY", "16MB")  # 256 MB of 20 times the runs
    runs = (
        "SELECT md5(i::VARCHAR), 'A' || i % 1000, DATE '2025-01-01', 'done' FROM range(?, ?) x(i)"
    )
    with History(tmp_path / "h.duckdb") as history:
        for k in range(4):
            history.connection.execute(
                f"INSERT INTO runs (run_id, serial, date, status) {runs}",
                [40_000 * k, 40_000 * (k + 1)],
            )
    write_history(tmp_path / "h.duckdb", 1, ["A1", "A2"])
    write_history(tmp_path / "h.duckdb", 2, ["A1", "A2"])
    with History(tmp_path / "h.duckdb") as history:
        assert history.rows("SELECT count(DISTINCT run_id) FROM runs") == [(160_004,)]


def test_results_are_computed_again_for_another_method_and_only_if_asked(call, capsys):
    call()
    with History(call.folder / "h.duckdb") as history:
        history.connection.execute("UPDATE runs SET method = 1, run_id = 'old' || run_id")
    call()
    assert call.ran == []
    call("--rerun")
    assert len(call.ran) == 8
    call("--rerun")
    assert call.ran == []
    path = str(call.folder / "h.duckdb")
    assert main(["fleet", "acknowledge", path, "A1", "--note", "it stays"]) == 0
    (shown,) = re.findall(r"lieid (identify .* --effects .*?) -o", capsys.readouterr().out)
    assert [Path(word).name for word in shown.split()] == [
        "identify", "A1.json", f"{LAST}.csv", "2026-01-03.csv", "--effects",
        "coulomb,viscous,offset",
    ]  # fmt: skip
    assert main([*shown.split(), "-o", str(call.folder / "new.json")]) == 0


def test_a_recording_that_was_moved_and_run_again_is_one_night(call):
    call()
    folder = call.folder / "nights"
    (folder / "moved").mkdir()
    shutil.move(folder / "A1", folder / "moved/A1")
    old = "recordings: nights/A1/*.csv"
    edit(
        call.folder,
        old,
        "recordings: nights/moved/A1/*.csv\n    payload: {mass: 1, com: [0, 0, 0]}",
    )
    assert call() == 0
    assert len(call.ran) == 4
    with History(call.folder / "h.duckdb", read_only=True) as history:
        assert [len(arm.dates) for arm in read_arms(history)] == [4, 4]


def test_workers_of_another_minor_version_are_refused_by_name(call, monkeypatch, capsys):
    with pytest.raises(FleetError, match=r"tcp://b:1 has 9\.9\.0"):
        cluster.require_same_version({"tcp://a:1": cluster.__version__, "tcp://b:1": "9.9.0"})
    fix = ".".join([*cluster.__version__.split(".")[:2], "99"])
    cluster.require_same_version({"tcp://a:1": fix})
    old = NightResult("done", version="9.9.0")  # of a worker that joined during the run
    monkeypatch.setattr(cluster, "run_arm_night", lambda night, content: old)
    assert call() == 6
    ((status, reason, version),) = rows(
        call.folder, "SELECT DISTINCT status, reason, version FROM runs"
    )
    assert (status, version) == ("failed", "9.9.0")
    assert "worker with version 9.9.0" in reason
