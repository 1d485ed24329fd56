"""What the worker process computes is what the public functions return."""

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
from lieid_casadi.comparison.comparison import error_table
from lieid_casadi.errors import UsageError
from lieid_casadi.tables import figures
from lieid_casadi.workbench.arm import TRIANGLE, arm_meshes, stl_bytes
from lieid_casadi.workbench.computation import Computation
from lieid_casadi.workbench.evaluation import difference_tables
from lieid_casadi.workbench.page import shell_lines
from lieid_casadi.workbench.session import (
    RecordingInput,
    Session,
    WorkbenchInputs,
    WorkerSetup,
)


def ignored(stage, fraction):
    """Take no notice of progress."""


SETUP = WorkerSetup(prepare=functools.partial(int), robot=load_robot, read=read_recordings)


@pytest.fixture(scope="module")
def inputs(two_link_files):
    train, test = map(str, two_link_files)
    return WorkbenchInputs(
        robot="two_link",
        recordings=(RecordingInput(train, "train"), RecordingInput(test, "test")),
    )


@pytest.fixture(scope="module")
def computation(inputs):
    return Computation(SETUP, inputs)


@pytest.fixture(scope="module")
def first(computation, inputs):
    return Session().opened(inputs, computation.opened().effects)


def evaluate(computation, session, *, quick=False):
    return computation.evaluate(session.step, quick=quick, report=ignored)


def test_errors_are_those_of_identify_and_compare(computation, first, two_link_files):
    train, test = map(lieid.Recording.load, two_link_files)
    model = lieid.Model(lieid.robots.two_link(), "coulomb,viscous,offset")
    fit = lieid.identify(model, train)
    shown = evaluate(computation, first)
    np.testing.assert_allclose(shown.errors.shown, lieid.compare(fit, test).rms_moving)
    np.testing.assert_allclose(shown.errors.train, lieid.compare(fit, train).rms_moving)
    np.testing.assert_allclose(shown.errors.noise_floor, lieid.compare(fit, test).noise_floor)
    assert "systematic; “Find what is missing” searches" in shown.sentence  # a button of the page
    larger = lieid.identify(model.with_effect("load_friction:1"), train, processing=fit.processing)
    shown = evaluate(computation, first.with_added("load_friction:1"))
    np.testing.assert_allclose(shown.errors.shown, lieid.compare(larger, test).rms_moving)


@pytest.mark.parametrize(("most", "at_once"), [(350, False), (10**6, True)])
def test_a_quick_model_with_shapes_is_fitted_to_two_parts_of_long_recordings(
    inputs, first, monkeypatch, most, at_once
):
    """The error is the larger of both: not below the exact one by more than 1 %."""
    monkeypatch.setattr("lieid_casadi.workbench.computation.SHAPE_ROWS", most)
    computation = Computation(SETUP, inputs)
    evaluate(computation, first)
    session = first.with_added("stribeck:1")
    quick, exact = (evaluate(computation, session, quick=x) for x in (True, False))
    assert (quick.exact, exact.exact) == (at_once, True)
    assert (quick.errors.shown == exact.errors.shown) == at_once
    assert np.all(np.array(quick.errors.shown) > 0.99 * np.array(exact.errors.shown))
    assert evaluate(computation, session, quick=True).exact  # its fit is kept


def test_a_quick_result_leaves_out_what_takes_longer_than_the_fit(inputs, first):
    computation = Computation(SETUP, inputs)
    begun = evaluate(computation, first, quick=True)
    assert begun.complete  # the first model has no noise floor before it
    session = first.with_added("load_friction:1")
    quick = evaluate(computation, session, quick=True)
    whole = evaluate(computation, session)
    assert (quick.exact, quick.complete, whole.complete) == (True, False, True)
    assert quick.errors.shown == whole.errors.shown
    np.testing.assert_array_equal(quick.test.series[0].predicted, whole.test.series[0].predicted)
    kept = np.minimum(begun.errors.noise_floor, quick.errors.shown)
    np.testing.assert_array_equal(quick.errors.noise_floor, kept)
    # beside the error of the missing effect that of late reversals does not show
    assert np.all((0.7 * kept < whole.errors.noise_floor) & (whole.errors.noise_floor < 2.0 * kept))
    with_std = [
        any("±" in value for row in e.effects for value in row.values) for e in (quick, whole)
    ]
    assert with_std == [False, True]
    assert np.isfinite(computation.fit(session.step, ignored).covariance).all()


@pytest.mark.parametrize("tested", [True, False])
def test_a_part_of_long_recordings_chooses_the_filter_alone(inputs, monkeypatch, tested):
    """The number that is shown first is the final one: of the first model, of a linear effect."""
    monkeypatch.setattr("lieid_casadi.workbench.computation.QUICK_ROWS", 2500)
    if not tested:
        inputs = replace(inputs, recordings=inputs.recordings[:1])
    computation = Computation(SETUP, inputs)
    session = Session().opened(inputs, computation.opened().effects)
    for each in (session, session.with_added("viscous_asymmetric:2")):
        quick = evaluate(computation, each, quick=True)
        assert (quick.exact, quick.complete) == (True, False)
        assert (None in quick.errors.train) == tested  # that of a part is not shown
        whole = evaluate(computation, each)
        np.testing.assert_allclose(quick.errors.shown, whole.errors.shown, rtol=1e-9)
        assert session.with_errors(session.step, quick.errors).at_worst_joint().joint == 0


def test_an_excluded_stretch_is_not_fitted(computation, first, two_link_files):
    session = replace(first, recording=0).excluding(4.0, 7.0)
    shown = evaluate(computation, session)
    file = two_link_files[0]
    parts = [lieid.Recording.load(f"{file}@:4"), lieid.Recording.load(f"{file}@7:")]
    model = lieid.Model(lieid.robots.two_link(), "coulomb,viscous,offset")
    cutoff = evaluate(computation, first).cutoff
    fit = lieid.identify(model, parts, processing=lieid.Processing(cutoff=cutoff))
    comparison = lieid.compare(fit, lieid.Recording.load(two_link_files[1]))
    np.testing.assert_allclose(shown.errors.shown, comparison.rms_moving)
    with pytest.raises(UsageError, match="no training recording"):
        evaluate(computation, replace(first, recording=0).excluding(-1.0, 99.0))


def test_the_search_proposes_what_diagnose_finds(computation, first, two_link_files, tmp_path):
    found, content = computation.find(first.step, report=ignored)
    assert [p.label for p in found.proposed] == ["load_friction:1"]
    assert found.proposed[0].after < 0.6 * found.proposed[0].before
    assert found.effects == first.step.effects
    assert found.path[-1][0] < 0.6 * found.path[0][0]
    # what is shown after “add all” is the fit that the diagnosis has made
    step = replace(first.step, effects=found.model)
    shown = computation.adopt(step, content=content)
    assert shown.complete
    path = tmp_path / "fit.json"
    path.write_bytes(content)
    test = lieid.Recording.load(two_link_files[1])
    assert shown.errors.shown == tuple(lieid.compare(lieid.Fit.load(path), test).rms_moving)
    assert computation.save(step, kind="fit", report=ignored) == ("fit.json", content)
    # the digits of every view of an error
    begun, number = evaluate(computation, first), figures(shown.errors.shown[0])
    session = first.with_effects("all", found.model)
    table, _ = difference_tables(session, 0, (begun, shown), None)
    assert table.cells[0][:3] == ["1", figures(begun.errors.shown[0]), number]
    assert error_table(lieid.compare(lieid.Fit.load(path), test)).cells[0][1] == number


def test_meshes_of_a_urdf_are_found_beside_it(tmp_path):
    folder = tmp_path / "arm_description"
    (folder / "meshes").mkdir(parents=True)
    (folder / "urdf").mkdir()
    corners = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 0], [0, 1, 0], [0, 0, 1]]])
    (folder / "meshes" / "link.stl").write_bytes(stl_bytes(0.1 * corners))
    text = """<robot name="arm"><link name="base"/><link name="one"><visual>
      <origin xyz="0 0 0.5"/><geometry><mesh filename="package://arm_description/meshes/link.stl"
      scale="2 2 2"/></geometry></visual><inertial><mass value="1"/>
      <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="a" type="revolute"><parent link="base"/><child link="one"/><axis xyz="0 0 1"/>
      <limit lower="-1" upper="1" effort="10" velocity="1"/></joint></robot>"""
    file = folder / "urdf" / "arm.urdf"
    file.write_text(text)
    robot = lieid.Robot.load(file)
    mesh, drum = arm_meshes(robot, str(file))
    assert (mesh.drum, drum.drum) == (False, True)
    rows = np.frombuffer(mesh.stl[84:], TRIANGLE)
    assert mesh.link == 1
    np.testing.assert_allclose(
        np.sort(rows["corners"].reshape(-1, 3), axis=0),
        np.sort((0.2 * corners + [0, 0, 0.5]).reshape(-1, 3), axis=0),
        atol=1e-6,
    )
    (folder / "meshes" / "link.stl").unlink()
    assert mesh.stl not in [other.stl for other in arm_meshes(robot, str(file))]  # capsules


STIFFNESS, DAMPING = np.array([300.0, 200.0]), np.array([4.0, 2.5])


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
    inputs = inputs_of(args)
    computation = Computation(SETUP, inputs)
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
