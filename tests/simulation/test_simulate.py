"""Forward simulation, checked against MuJoCo's own integration of exported models."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from exporters.c_arms import made_fit

import lieid_casadi as lieid
from lieid_casadi.cli.main import main
from lieid_casadi.errors import ModelError, RecordingError
from lieid_casadi.exporters.mjcf import mjcf_text
from lieid_casadi.robot.drive import Drive
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
