"""Forward simulation, batches of it and fits refined on it, against integration by MuJoCo."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from exporters.c_arms import made_fit

import lieid_casadi as lieid
from lieid_casadi.cli.main import main
from lieid_casadi.compiled import kernels
from lieid_casadi.errors import ModelError, RecordingError
from lieid_casadi.exporters.mjcf import mjcf_text
from lieid_casadi.robot.drive import Drive
from lieid_casadi.simulation import polish
from lieid_casadi.simulation.simulate import Drift

ROBOT = lieid.robots.two_link().with_drives(Drive(stiffness=60.0, damping=4.0))
MUJOCO_STEP = 5e-4  # s
SIZES = {"coulomb.f_c": 3.0, "load_friction.f_tau": 0.3, "viscous.f_v": 2.0, "offset.f_b": 1.0}


def fit_of(effects, robot=ROBOT):
    """Return a fit with effects of realistic size."""
    fit = made_fit(robot, effects)
    sizes = np.array([SIZES.get(c.name, 0.3) for c in fit.model.columns])
    parameters = np.concatenate([fit.link_parameters, sizes * np.resize([1.0, 0.4], len(sizes))])
    return replace(fit, parameters=parameters, processing=lieid.Processing(cutoff=40.0))


def in_mujoco(fit, *, seconds=4.0, step=MUJOCO_STEP, hold=0.002):
    """Return a recording of the exported model that MuJoCo integrates under commands."""
    model = mujoco.MjModel.from_xml_string(mjcf_text(fit, step=step)[0])
    model.opt.iterations, model.opt.tolerance = 200, 1e-12
    data, rows = mujoco.MjData(model), []
    data.qpos[:] = 0.3
    for k in range(round(seconds / step)):
        t = k * step
        if k % round(hold / step) == 0:  # commands are held between the rows
            data.ctrl[:] = 0.3 + 0.6 * np.sin(2.0 * np.pi * np.array([0.4, 0.6]) * t)
            rows.append([t, *data.qpos, *data.qvel, *data.ctrl])
        mujoco.mj_step(model, data)
    table = np.array(rows)
    return lieid.Recording.from_arrays(
        table[:, 0], table[:, 1:3], table[:, 3:5], command=table[:, 5:], name="mujoco.csv"
    )


def test_motion_is_that_of_mujoco():
    fit = fit_of("coulomb,viscous,armature,offset")
    recording = in_mujoco(fit, seconds=3.0)
    simulation = lieid.simulate(fit, recording)
    assert simulation.under == "command"
    assert np.degrees(simulation.drift.rms).max() < 0.05
    assert np.degrees(simulation.rms_whole).max() < 0.05
    moved = np.degrees(np.ptp(recording.q, axis=0))
    assert moved.min() > 30.0


@pytest.mark.parametrize("damping", [2.0, 8.0])
def test_the_exported_motion_does_not_depend_on_the_step(damping):
    """MuJoCo's steps add inertia in proportion to damping, for which the armature makes up."""
    robot = ROBOT.with_drives(Drive(stiffness=60.0, damping=damping))
    fit = fit_of("viscous,armature", robot)
    added = np.r_[np.zeros(22), 0.001 * (fit.effect_coefficients[:2] + damping)]
    plain = replace(fit, parameters=fit.parameters + added)

    def motion(of, step):  # without the start, where the first step has the velocity of its end
        whole = in_mujoco(of, seconds=3.0, step=step, hold=step)
        return whole.q[:: round(2e-3 / step)][750:]

    fine = motion(fit, 2.5e-4)
    errors = [np.abs(motion(of, 2e-3) - fine).max() for of in (fit, plain)]
    assert errors[0] < 0.2 * errors[1]


def test_the_standard_error_is_the_scatter_of_the_rms():
    random = np.random.default_rng(0)
    drifts = [Drift.of(random.normal(size=(40, 1))) for _ in range(2000)]
    scatter = np.std([drift.rms[0] for drift in drifts])
    assert np.mean([drift.std[0] for drift in drifts]) == pytest.approx(scatter, rel=0.1)
    assert np.isnan(Drift.of(np.ones((1, 2))).std).all()


def test_a_joint_sticks_under_dry_friction():
    """A constant command error below the friction level moves nothing."""
    robot = replace(ROBOT, gravity=np.zeros(3))
    fit = fit_of("coulomb", robot)
    t = np.arange(0.0, 5.0, 0.005)
    q = np.full((len(t), 2), 0.3)
    wobble = 1e-3 * np.sin(2.0 * np.pi * t)[:, None]
    command = q + 0.02 + wobble  # 60 N·m/rad · 0.02 rad = 1.2 N·m, friction 3 and 1.2 N·m
    recording = lieid.Recording.from_arrays(t, q + 1e-9 * wobble, 0 * q, command=command)
    simulation = lieid.simulate(fit, recording)
    assert abs(simulation.dq[:, 0]).max() < 1e-6
    assert simulation.rms_whole[0] < 1e-6


@pytest.mark.parametrize("gain", [0.0, 0.2])
def test_torques_as_input(gain):
    """Without friction and gravity the response to a torque is a double integration.

    An identified gain of the torque signal is not part of what the drives deliver.
    """
    robot = lieid.robots.two_link()
    robot = replace(robot, gravity=np.zeros(3), joints=robot.joints[:1])
    fit = fit_of("armature,torque_gain", robot)
    fit = replace(fit, parameters=np.append(fit.parameters[:-1], gain))
    inertia = fit.compiled.inverse_dynamics([[0.0]], [[0.0]], [[1.0]], fit.link_parameters)[0, 0]
    inertia += fit.effect_coefficients[0]
    t = np.arange(0.0, 6.0, 0.002)
    q, dq = np.sin(2.0 * t)[:, None], 2.0 * np.cos(2.0 * t)[:, None]
    tau = -4.0 * inertia * q * (1.0 + gain)
    simulation = lieid.simulate(fit, lieid.Recording.from_arrays(t, q, dq, tau), window=2.0)
    assert simulation.under == "torque"
    assert simulation.drift.rms[0] < 2e-3


def test_an_indefinite_mass_matrix_is_refused():
    fit = fit_of("coulomb")
    fit = replace(fit, parameters=fit.parameters * np.r_[-np.ones(20), 1.0, 1.0])
    with pytest.raises(ModelError, match=r"not positive definite in 100 %.*--method feasible"):
        lieid.simulate(fit, in_mujoco(fit_of("coulomb"), seconds=2.0))


def test_refusals():
    fit = fit_of("coulomb")
    t = np.arange(0.0, 3.0, 0.01)
    q = np.sin(t)[:, None] * [1.0, 1.0]
    plain = lieid.Recording.from_arrays(t, q)
    with pytest.raises(ModelError, match="no torque"):
        lieid.simulate(fit, plain)
    with pytest.raises(ModelError, match="drive law"):
        lieid.simulate(fit, plain, under="command")
    both = lieid.Recording.from_arrays(t, q, tau=q)
    with pytest.raises(RecordingError, match="shorter window"):
        lieid.simulate(fit, both, window=100.0)
    with pytest.raises(ModelError, match="above 0"):
        lieid.simulate(fit, both, window=0.0)


def test_command(tmp_path, capsys):
    fit = fit_of("coulomb,viscous,armature")
    fit.save(tmp_path / "fit.json")
    in_mujoco(fit, seconds=3.0).save(tmp_path / "run.csv")
    words = ["simulate", str(tmp_path / "fit.json"), str(tmp_path / "run.csv"), "--window", "0.5"]
    files = ["-o", str(tmp_path / "sim.csv"), "--json", str(tmp_path / "sim.json")]
    assert main([*words, *files]) == 0
    result = json.loads((tmp_path / "sim.json").read_text())
    assert result["window"] == 0.5
    assert len(result["rms"]) == len(result["p95"]) == len(result["rms_whole"]) == 2
    assert result["windows"] == 5
    assert min(result["nominal"]["rms"]) > 5.0 * max(result["rms"])  # it has no friction
    assert all(0.0 < std < rms for std, rms in zip(result["rms_std"], result["rms"], strict=True))
    assert lieid.Recording.load(tmp_path / "sim.csv").n == 2
    shown = capsys.readouterr().out
    assert "deg, under the recorded commanded positions: 5 windows" in shown
    assert "nominal model" in " ".join(shown.split())
    with pytest.raises(SystemExit, match="2"):
        main([*words, "--window", "-1"])


BATCH_EFFECTS = "coulomb,viscous,armature,load_friction:2"


def inputs_of(count, windows, n=2):
    random = np.random.default_rng(0)
    t = 0.002 * np.arange(count)[:, None, None]
    return 0.3 + 0.5 * np.sin(random.uniform(1.0, 4.0, (windows, n)) * t)


def test_a_batch_has_the_motion_of_the_windows_of_simulate():
    """MuJoCo's recording in windows of 0.5 s, from the states and with the commands of its rows."""
    fit = fit_of("coulomb,viscous,armature")
    recording = in_mujoco(fit, seconds=3.0)
    one = lieid.simulate(fit, recording, window=0.5)
    length = round(0.5 / np.diff(one.t)[0])
    starts = np.arange(0, len(one.t), length)
    rows = np.searchsorted(recording.t, one.t[starts] + 1e-9)[None] + np.arange(length)[:, None] - 1
    batch = lieid.Batch(
        one.q[starts], one.dq[starts], recording.command[rows], 1.0 / recording.rate
    )
    q, dq = lieid.simulate(fit, batch=batch)
    np.testing.assert_allclose(q[:-1].transpose(1, 0, 2).reshape(-1, 2), one.q, atol=2e-4)
    assert q.shape == dq.shape == (length + 1, len(starts), 2)


def test_without_a_compiler_the_motion_is_the_same(monkeypatch):
    fit, inputs = fit_of(BATCH_EFFECTS), inputs_of(20, 5)
    q = np.full((5, 2), 0.3)
    compiled = lieid.simulate(fit, batch=lieid.Batch(q, 0 * q, inputs, 0.002))
    monkeypatch.setattr(kernels.CompilerFailure, "reason", "reported before")
    lieid.simulation.integration._STEPS.clear()
    machine = lieid.simulate(fit, batch=lieid.Batch(q, 0 * q, inputs, 0.002))
    lieid.simulation.integration._STEPS.clear()
    np.testing.assert_allclose(compiled, machine, rtol=0, atol=1e-12)


def test_delays_between_two_steps_act_in_proportion():
    """The input of a step is the mean of the commands that act in it: no delay is rounded."""
    fit = fit_of(f"{BATCH_EFFECTS},command_delay")
    moved = inputs_of(40, 1)
    fits = [
        replace(fit, parameters=np.append(fit.parameters[:-2], [0.001 + late] * 2))
        for late in (0.0042, 0.0045, 0.0048)
    ]
    q = np.full((3, 2), 0.3)
    inputs = np.repeat(moved, 3, axis=1)
    path, _ = lieid.simulate(fits, batch=lieid.Batch(q, 0 * q, inputs, 0.002, history=10))
    assert len(path) == 31
    first, middle, last = path[-1]
    assert np.abs(last - first).min() > 1e-6
    np.testing.assert_allclose(middle - first, 0.5 * (last - first), rtol=0.06)


def test_shapes_and_models_that_do_not_fit_are_refused():
    fit, q = fit_of(BATCH_EFFECTS), np.zeros((3, 2))
    with pytest.raises(ModelError, match=r"expected \(W, 2\)"):
        lieid.simulate(fit, batch=lieid.Batch(q, q, np.zeros((5, 2, 2)), 0.01))
    batch = lieid.Batch(q, q, np.zeros((5, 3, 2)), 0.01)
    with pytest.raises(ModelError, match="2 fits"):
        lieid.simulate([fit, fit], batch=batch)
    with pytest.raises(ModelError, match="or a batch"):
        lieid.simulate(fit)
    bare = fit_of("coulomb", replace(ROBOT, joints=lieid.robots.two_link().joints))
    with pytest.raises(ModelError, match="need drives"):
        lieid.simulate(bare, batch=batch, under="command")


EFFECTS = "coulomb,viscous,armature"


def wrong(fit, factor):
    """Return the fit with its effects' coefficients multiplied by factors (m,)."""
    parameters = fit.parameters.copy()
    parameters[20:] *= factor
    return replace(fit, parameters=parameters)


def test_coefficients_that_a_regression_has_missed_are_found():
    fit = fit_of(EFFECTS)
    train = in_mujoco(fit, seconds=4.0)
    bad = wrong(fit, np.array([0.85, 0.9, 1.1, 0.9, 1.15, 1.1]))
    found = polish(bad, train, window=0.5)
    truth = fit.effect_coefficients
    missed = np.abs(bad.effect_coefficients - truth) / truth
    assert (np.abs(found.fit.effect_coefficients - truth) / truth < 0.2 * missed).all()
    assert (found.after < 0.2 * found.before).all()
    np.testing.assert_array_equal(found.fit.link_parameters, bad.link_parameters)
    base = found.fit.model.base.combination @ found.fit.parameters
    np.testing.assert_allclose(found.fit.values, base)
    assert not np.allclose(found.fit.rms_train, bad.rms_train)


def test_torques_cannot_be_polished_on():
    fit = fit_of("viscous", lieid.robots.two_link())
    t = np.arange(0.0, 3.0, 0.01)
    q = np.sin(t)[:, None] * [1.0, 1.0]
    with pytest.raises(ModelError, match="commands"):
        polish(fit, lieid.Recording.from_arrays(t, q, tau=q))


def test_identify_polishes(tmp_path, capsys):
    in_mujoco(fit_of(EFFECTS), seconds=4.0).save(tmp_path / "run.csv")
    words = ["identify", "two_link", str(tmp_path / "run.csv"), "--stiffness", "60"]
    words += ["--damping", "4", "--effects", EFFECTS, "--polish"]
    assert main([*words, "-o", str(tmp_path / "fit.json")]) == 2
    assert "--method feasible" in capsys.readouterr().err
    assert main([*words, "--method", "feasible", "-o", str(tmp_path / "fit.json")]) == 0
    assert "Polished on the motion" in capsys.readouterr().out
    fit = lieid.Fit.load(tmp_path / "fit.json")
    drift = lieid.simulate(fit, in_mujoco(fit_of(EFFECTS))).drift
    assert np.degrees(drift.rms).max() < 0.2
