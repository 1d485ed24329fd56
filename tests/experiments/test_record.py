"""The command that records, and where a motion is in its recording."""

import sys

import numpy as np
import pytest
from experiments.arms import ROBOT, arm, measured

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.errors import RecordError, UsageError
from lieid_casadi.excitation.trajectory import MotionSamples
from lieid_casadi.experiments import PlannedMotion, Purpose
from lieid_casadi.experiments.record import RecordCommand, deviation, repeatability

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


def test_recording_that_starts_early_is_aligned_and_compared():
    fourier = plant.FourierTrajectory(ROBOT, base_frequency=0.25, seed=2)
    t = np.arange(0.0, 4.0, 0.005)
    probe = MotionSamples(t, *fourier.at(t))
    fit = lieid.identify(
        lieid.Model(ROBOT, "coulomb,viscous,offset"), measured(arm(None), t, *fourier.at(t))
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
