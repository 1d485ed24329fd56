"""``lieid experiment``: files and exit statuses; the command that records."""

import io
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from experiments.arms import ROBOT, arm, measured, sines

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.cli.main import main
from lieid_casadi.errors import RecordError, UsageError
from lieid_casadi.excitation.trajectory import MotionSamples
from lieid_casadi.experiments import PlannedMotion, Purpose
from lieid_casadi.experiments.record import RecordCommand, deviation, repeatability

PROGRAM = Path(__file__).parent / "arms.py"
RECORD = f"'{sys.executable}' '{PROGRAM}' {{trajectory}} {{recording}}"


@pytest.fixture
def words(tmp_path):
    sines(arm()).save(tmp_path / "sines.csv")
    return [
        "experiment", "two_link", str(tmp_path / "sines.csv"), "-o", str(tmp_path / "out"),
        "--longest", "13", "--rate", "200",
    ]  # fmt: skip


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_motion_is_shown_then_fails_then_is_run_until_the_effect_is_named(
    words, tmp_path, capsys, monkeypatch
):
    monkeypatch.setenv("PYTHONPATH", str(PROGRAM.parents[2]))
    monkeypatch.setattr(sys, "stdin", Terminal("n\n"))
    assert main([*words, "--record", RECORD]) == 3
    shown = capsys.readouterr()
    assert "The robot moves for 8 s along" in shown.out
    assert "Not checked: " in shown.out
    assert "Run it on the robot?" in shown.out
    assert "not confirmed" in shown.err
    planned = tmp_path / "out" / "round-1" / "trajectory.csv"
    trajectory = planned.read_bytes()
    assert not planned.with_name("recording.csv").exists()
    fails = f"'{sys.executable}' -c 'raise SystemExit(5)' {{trajectory}} {{recording}}"
    assert main([*words, "--record", fails, "--yes"]) == 3
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "status 5" in error
    state = json.loads((tmp_path / "out" / "experiment.json").read_text())
    assert state["stopped"] == "record_failed"
    files = ["--json", str(tmp_path / "out.json"), "--html", str(tmp_path / "out.html")]
    assert main([*words, "--record", RECORD, "--yes", *files]) == 0
    shown = capsys.readouterr()
    assert "Every effect is named" in shown.out
    assert shown.err == ""
    assert planned.read_bytes() == trajectory
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


COPY = "import sys, shutil; shutil.copy(sys.argv[1], sys.argv[2])"


@pytest.fixture
def motion(tmp_path):
    folder = tmp_path / "a folder; touch harm"
    folder.mkdir()
    (folder / "trajectory.csv").write_text("t,q1\n0,0\n")
    samples = MotionSamples(np.zeros(1), np.zeros((1, 2)), np.zeros((1, 2)), np.zeros((1, 2)))
    return PlannedMotion(1, Purpose("excitation"), samples, 0.0, "", (), (), folder)


def run(motion, code, arguments="{trajectory} {recording}"):
    (motion.folder / "code.py").write_text(code)
    text = f"'{sys.executable}' '{motion.folder / 'code.py'}' {arguments}"
    return RecordCommand.parse(text, lambda path: path.read_text())(motion)


def test_arguments_are_not_interpreted_by_a_shell(motion, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments = "{trajectory} {recording} '$HOME' ; touch harm"
    check = "assert sys.argv[3:] == ['$HOME', ';', 'touch', 'harm'], sys.argv"
    assert run(motion, f"{COPY}; {check}", arguments) == "t,q1\n0,0\n"
    assert not (tmp_path / "harm").exists()


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("print('joint 2 is locked'); raise SystemExit(7)", r"status 7 \(joint 2 is locked\)"),
        ("pass", "wrote no .*recording.csv"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGTERM)", "signal SIGTERM"),
    ],
)
def test_failures_name_the_cause(motion, code, message):
    with pytest.raises(RecordError, match=message):
        run(motion, code)
    assert (motion.folder / "record.log").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("cp {trajectory}", "{recording} is missing"),
        ("cp {recording}", "{trajectory} is missing"),
        ("no-such-program {trajectory} {recording}", "no such program"),
        ("cp '{trajectory} {recording}", "quotation"),
    ],
)
def test_commands_that_cannot_be_run(text, message):
    with pytest.raises(UsageError, match=message):
        RecordCommand.parse(text, lieid.Recording.load)


def test_the_recording_of_another_motion_is_refused_and_kept(words, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PYTHONPATH", str(PROGRAM.parents[2]))
    copies = f"import sys, shutil; shutil.copy('{tmp_path}/sines.csv', sys.argv[2])"
    (tmp_path / "copies.py").write_text(copies)
    record = f"'{sys.executable}' '{tmp_path}/copies.py' {{trajectory}} {{recording}}"
    for _ in range(2):
        assert main([*words, "--record", record, "--yes"]) == 3
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert "joints 1, 2 did not follow the trajectory" in error
    kept = {path.name for path in (tmp_path / "out" / "round-1").iterdir()}
    assert {"recording.csv", "recording-before.csv", "trajectory.csv"} <= kept


def test_recording_that_starts_early_is_aligned_and_compared():
    fourier = plant.FourierTrajectory(ROBOT, base_frequency=0.25, seed=2)
    t = np.arange(0.0, 4.0, 0.005)
    probe = MotionSamples(t, *fourier.at(t))
    fit = lieid.identify(
        lieid.Model(ROBOT, "coulomb,viscous,offset"),
        measured(arm(None), t, *fourier.at(t)),
        processing=lieid.Processing(cutoff=20.0),  # noise below it, of averages over 0.25 s
    )
    waits = np.arange(0.0, 6.0, 0.005)
    late = np.clip(waits - 1.2, 0.0, 4.0)
    first = measured(arm(None), t, *fourier.at(t), seed=2)
    new = measured(arm(None), waits, *fourier.at(late), seed=3)
    start, far = deviation(probe, new)
    assert start == pytest.approx(1.2, abs=0.02)
    assert far.max() < 0.01
    assert np.all(repeatability(probe, fit, (first, 0.0), (new, start)) < 0.7 * fit.noise)
    shifted = lieid.Recording.from_arrays(new.t, new.q, new.dq, new.tau + np.array([0.0, 0.2]))
    found = repeatability(probe, fit, (first, 0.0), (shifted, start))
    assert found[1] == pytest.approx(0.2, abs=0.03)
