"""The copied command gives the fit that the page shows."""

import functools
import json
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from comparison.two_link_data import motion, torque
from workbench.two_link_files import write_recordings

import lieid_casadi as lieid
from lieid_casadi.cli.main import build_parser, main
from lieid_casadi.cli.workbench import inputs_of, load_robot, read_recordings
from lieid_casadi.workbench.commands import shell_lines
from lieid_casadi.workbench.computation import Computation
from lieid_casadi.workbench.session import Session, WorkerSetup

STIFFNESS, DAMPING = np.array([300.0, 200.0]), np.array([4.0, 2.5])


def ignored(stage, fraction):
    """Take no notice of progress."""


@pytest.fixture
def commanded(tmp_path):
    """Return two recordings of positions and commanded positions."""
    paths = []
    for seed, name in ((3, "a b.csv"), (8, "c.csv")):
        t, q, dq, ddq = motion(12.0, seed=seed)
        command = q + (torque(q, dq, ddq) + DAMPING * dq) / STIFFNESS
        names = "t,q1,q2,dq1,dq2,qcmd1,qcmd2"
        rows = np.column_stack([t, q, dq, command])
        paths.append(tmp_path / name)
        np.savetxt(paths[-1], rows, "%.9g", ",", header=names, comments="")
    return paths


def shown(words):
    """Return the session of a command line, its computation, and the exact fit after a step."""
    args = build_parser().parse_args(["workbench", *words])
    setup = WorkerSetup(
        prepare=functools.partial(int),
        robot=load_robot,
        read=read_recordings,
    )
    inputs = inputs_of(args)
    computation = Computation(setup, inputs)
    session = Session().opened(inputs, computation.opened().effects)
    computation.evaluate(session.step, quick=True, report=ignored)
    session = replace(session.with_added("load_friction:1"), recording=0).excluding(3.123, 4.5)
    evaluation = computation.evaluate(session.step, quick=False, report=ignored)
    return session, evaluation, computation.fit(session.step, ignored)


def check(session, evaluation, fit, tmp_path, monkeypatch):
    """Check that the first command gives the fit and its errors."""
    monkeypatch.chdir(tmp_path)
    words = shlex.split(shell_lines(session, evaluation.cutoff).splitlines()[0])
    words[words.index("-o") + 1] = "copied.json"
    assert main([*words[1:], "--json", "copied_errors.json"]) == 0
    copied = lieid.Fit.load("copied.json")
    assert copied.model.effects == fit.model.effects
    assert copied.processing.cutoff == fit.processing.cutoff
    assert copied.model.robot.drives == fit.model.robot.drives
    np.testing.assert_allclose(copied.values, fit.values, rtol=1e-9, atol=1e-12)
    errors = json.loads(Path("copied_errors.json").read_text())["rms_test_moving"]
    np.testing.assert_allclose(errors, evaluation.errors.shown, rtol=1e-9)


def test_with_a_drive_law(commanded, tmp_path, monkeypatch, capsys):
    words = ["two_link", *map(str, commanded), "--stiffness", "300,200", "--damping", "4,2.5"]
    words += ["--time-offset", "0.0005"]  # a correction of a premise
    session, evaluation, fit = shown(words)
    assert [d.stiffness for d in fit.model.robot.drives] == [300.0, 200.0]
    check(session, evaluation, fit, tmp_path, monkeypatch)


def test_with_a_fit_in_place_of_the_robot(two_link_files, tmp_path, monkeypatch, capsys):
    old, _ = write_recordings(tmp_path, load_friction=0.0)
    robot = lieid.robots.two_link()
    fit = lieid.identify(lieid.Model(robot, "coulomb,viscous"), lieid.Recording.load(old))
    fit.save(tmp_path / "old.json")
    train, test = map(str, two_link_files)
    shown_now = shown([str(tmp_path / "old.json"), "--train", train, "--test", test])
    check(*shown_now, tmp_path, monkeypatch)
