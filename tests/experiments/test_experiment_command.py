"""``lieid experiment``: files and exit statuses."""

import io
import json
import subprocess
import sys
from pathlib import Path

import pytest
from experiments.arms import arm, sines

from lieid_casadi.cli.main import main

PROGRAM = Path(__file__).parent / "arms.py"
RECORD = f"'{sys.executable}' '{PROGRAM}' {{trajectory}} {{recording}}"


@pytest.fixture
def words(tmp_path):
    sines(arm()).save(tmp_path / "sines.csv")
    return [
        "experiment", "two_link", str(tmp_path / "sines.csv"), "-o", str(tmp_path / "out"),
        "--longest", "13", "--rate", "200",
    ]  # fmt: skip


def test_runs_until_the_effect_is_named(words, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(PROGRAM.parents[2]))
    files = ["--json", str(tmp_path / "out.json"), "--html", str(tmp_path / "out.html")]
    assert main([*words, "--record", RECORD, "--yes", *files]) == 0
    shown = capsys.readouterr()
    assert "Every effect is named" in shown.out
    assert shown.err == ""
    content = json.loads((tmp_path / "out.json").read_text())
    assert content["stopped"] == "all_named"
    assert [step["label"] for step in content["steps"]] == ["stribeck:1"]
    assert {"purpose", "trajectory", "recording", "verdict", "open"} <= set(content["rounds"][1])
    assert "Recording 1" in (tmp_path / "out.html").read_text()


@pytest.mark.slow
def test_resumes_after_kill_9_while_the_robot_moves(words, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(PROGRAM.parents[2]))
    kill = (
        f"'{sys.executable}' -c 'import os; os.kill(os.getppid(), 9)' {{trajectory}} {{recording}}"
    )
    command = [sys.executable, "-m", "lieid_casadi.cli.main", *words, "--record", kill, "--yes"]
    assert subprocess.run(command, check=False).returncode == -9
    assert (tmp_path / "out" / "round-1" / "trajectory.csv").exists()
    assert main([*words, "--record", RECORD, "--yes"]) == 0
    content = json.loads((tmp_path / "out" / "experiment.json").read_text())
    assert content["stopped"] == "all_named"
    assert [each["recording"] for each in content["rounds"]] == [None, "round-1/recording.csv"]


def test_a_failed_command_has_status_3_and_keeps_the_round(words, tmp_path, capsys):
    record = f"'{sys.executable}' -c 'raise SystemExit(5)' {{trajectory}} {{recording}}"
    assert main([*words, "--record", record, "--yes"]) == 3
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "status 5" in error
    assert (tmp_path / "out" / "round-1" / "trajectory.csv").exists()
    state = json.loads((tmp_path / "out" / "experiment.json").read_text())
    assert state["stopped"] == "record_failed"


def test_a_motion_is_shown_before_it_is_run(words, tmp_path, capsys, monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setattr(sys, "stdin", Terminal("n\n"))
    assert main([*words, "--record", RECORD]) == 3
    shown = capsys.readouterr()
    assert "The robot moves for 8 s along" in shown.out
    assert "Not checked: " in shown.out
    assert "Run it on the robot?" in shown.out
    assert "not confirmed" in shown.err
    assert not (tmp_path / "out" / "round-1" / "recording.csv").exists()
