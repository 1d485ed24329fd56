"""Forward simulation, checked against MuJoCo's own integration of exported models."""

import json
import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from exporters.c_arms import made_fit

import lieid_casadi as lieid
from lieid_casadi.cli.main import main
from lieid_casadi.errors import ModelError, RecordingError
from lieid_casadi.exporters.mjcf import mjcf_text
from lieid_casadi.robot.drive import Drive
from lieid_casadi.simulation import mujoco_callback, window_drift
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


def in_mujoco(fit, *, seconds=4.0, callback=False):
    """Return a recording of the exported model that MuJoCo integrates under commands."""
    model = mujoco.MjModel.from_xml_string(mjcf_text(fit)[0])
    model.opt.timestep, model.opt.iterations, model.opt.tolerance = MUJOCO_STEP, 200, 1e-12
    data, rows = mujoco.MjData(model), []
    if callback:
        mujoco.set_mjcb_passive(mujoco_callback(fit, model))
    try:
        data.qpos[:] = 0.3
        for k in range(round(seconds / MUJOCO_STEP)):
            t = k * MUJOCO_STEP
            if k % 4 == 0:  # commands are held between the rows
                data.ctrl[:] = 0.3 + 0.6 * np.sin(2.0 * np.pi * np.array([0.4, 0.6]) * t)
                rows.append([t, *data.qpos, *data.qvel, *data.ctrl])
            mujoco.mj_step(model, data)
    finally:
        mujoco.set_mjcb_passive(None)
    table = np.array(rows)
    return lieid.Recording.from_arrays(
        table[:, 0], table[:, 1:3], table[:, 3:5], command=table[:, 5:], name="mujoco.csv"
    )


@pytest.mark.parametrize(
    "effects",
    [
        pytest.param("viscous,armature,offset", marks=pytest.mark.slow),
        "coulomb,viscous,armature",
    ],
)
def test_motion_is_that_of_mujoco(effects):
    fit = fit_of(effects)
    recording = in_mujoco(fit, seconds=3.0)
    simulation = lieid.simulate(fit, recording)
    assert simulation.under == "command"
    assert np.degrees(simulation.drift.rms).max() < 0.05
    assert np.degrees(simulation.rms_whole).max() < 0.05
    moved = np.degrees(np.ptp(recording.q, axis=0))
    assert moved.min() > 30.0
    assert simulation.without
    for name, drift in simulation.without:
        assert np.degrees(drift.rms).max() > 3 * np.degrees(simulation.drift.rms).max(), name


@pytest.mark.slow
def test_models_without_an_effect_are_identified_again():
    """The drift without an effect is that of a fit which never had it."""
    robot = ROBOT.with_drives(Drive(stiffness=60.0, damping=4.0))
    run = in_mujoco(fit_of("coulomb,viscous,armature"), seconds=6.0).with_drives(robot.drives)
    train, test = run.cut(0.0, 4.0), run.cut(4.0)
    fits = [
        lieid.identify(lieid.Model(robot, effects), train, method="feasible")
        for effects in ("coulomb,viscous,armature", "coulomb,armature")
    ]
    simulation = lieid.simulate(fits[0], test, train=train)
    plain = lieid.simulate(replace(fits[1], processing=fits[0].processing), test, each_effect=False)
    assert [source.name for source in simulation.refitted_to] == [train.name]
    np.testing.assert_allclose(dict(simulation.without)["viscous"].rms, plain.drift.rms, rtol=0.05)
    np.testing.assert_allclose(simulation.refitted.rms, simulation.drift.rms, rtol=0.05)
    assert simulation.drift.rms.max() < 0.5 * plain.drift.rms.max()


def test_window_drift_is_that_of_simulate():
    fit = fit_of("coulomb,viscous,armature")
    recording = in_mujoco(fit, seconds=3.0)
    beside = window_drift(fit, recording, window=0.5)
    complete = lieid.simulate(fit, recording, window=0.5, each_effect=False)
    np.testing.assert_allclose(beside.drift.rms, complete.drift.rms)
    assert (beside.windows, beside.under, beside.reason) == (5, "command", "")
    assert window_drift(fit, recording, window=0.5, most=2).windows == 2


def test_the_standard_error_is_the_scatter_of_the_rms():
    random = np.random.default_rng(0)
    drifts = [Drift.of(random.normal(size=(40, 1))) for _ in range(2000)]
    scatter = np.std([drift.rms[0] for drift in drifts])
    assert np.mean([drift.std[0] for drift in drifts]) == pytest.approx(scatter, rel=0.1)
    assert np.isnan(Drift.of(np.ones((1, 2))).std).all()


def test_window_drift_states_why_there_is_none():
    fit = fit_of("coulomb")
    recording = in_mujoco(fit, seconds=2.0)
    assert "has the length of a window of 100 s" in window_drift(fit, recording, window=100).reason
    fit = replace(fit, parameters=fit.parameters * np.r_[-np.ones(20), 1.0, 1.0])
    none = window_drift(fit, recording)
    assert "not positive definite" in none.reason
    assert none.to_dict()["rms"] == [None, None]


@pytest.mark.slow
def test_the_callback_gives_mujoco_the_friction_of_the_fit():
    fit = fit_of("coulomb,viscous,armature,load_friction,stribeck")
    drifts = [
        lieid.simulate(fit, in_mujoco(fit, callback=callback), each_effect=False).drift.rms.max()
        for callback in (False, True)
    ]
    assert np.degrees(drifts[1]) < 0.15
    assert drifts[0] > 5.0 * drifts[1]


def test_a_joint_sticks_under_dry_friction():
    """A constant command error below the friction level moves nothing."""
    robot = replace(ROBOT, gravity=np.zeros(3))
    fit = fit_of("coulomb", robot)
    t = np.arange(0.0, 5.0, 0.005)
    q = np.full((len(t), 2), 0.3)
    wobble = 1e-3 * np.sin(2.0 * np.pi * t)[:, None]
    command = q + 0.02 + wobble  # 60 N·m/rad · 0.02 rad = 1.2 N·m, friction 3 and 1.2 N·m
    recording = lieid.Recording.from_arrays(t, q + 1e-9 * wobble, 0 * q, command=command)
    simulation = lieid.simulate(fit, recording, each_effect=False)
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
    simulation = lieid.simulate(
        fit, lieid.Recording.from_arrays(t, q, dq, tau), window=2.0, each_effect=False
    )
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
    assert main([*words, *files, "--plot", str(tmp_path / "sim.png")]) == 0
    result = json.loads((tmp_path / "sim.json").read_text())
    assert result["window"] == 0.5
    assert len(result["rms"]) == len(result["p95"]) == len(result["rms_whole"]) == 2
    assert result["windows"] == 5
    assert min(result["nominal"]["rms"]) > 5.0 * max(result["rms"])  # it has no friction
    assert all(0.0 < std < rms for std, rms in zip(result["rms_std"], result["rms"], strict=True))
    assert [part["effect"] for part in result["without"]] == ["armature", "coulomb", "viscous"]
    assert lieid.Recording.load(tmp_path / "sim.csv").n == 2
    shown = capsys.readouterr().out
    assert "deg, under the recorded commanded positions: 5 windows" in shown
    assert "nominal model" in " ".join(shown.split())
    assert main([*words, "--window", "-1"]) == 2


def test_the_guide_shows_how_to_set_the_callback(tmp_path, monkeypatch):
    guide = Path(__file__).parents[2] / "docs" / "guides" / "simulation.md"
    (code,) = re.findall(r"```python\n(.*?)```", guide.read_text("utf-8"), re.DOTALL)
    fit = made_fit(lieid.robots.so101().with_drives(lieid.servo_drive("sts3215")), "coulomb")
    fit.save(tmp_path / "fit.json")
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "so101.xml").write_text(mjcf_text(fit)[0], "utf-8")
    monkeypatch.chdir(tmp_path)
    names = {}
    try:
        exec(code, names)
        data = mujoco.MjData(names["model"])
        mujoco.mj_step(names["model"], data)
    finally:
        mujoco.set_mjcb_passive(None)
    assert np.isfinite(data.qpos).all()


def test_callback_refuses_other_models():
    model = mujoco.MjModel.from_xml_string(mjcf_text(fit_of(""))[0])
    with pytest.raises(ModelError, match="2 actuators; the fit has 7 joints"):
        mujoco_callback(made_fit(lieid.robots.panda(), ""), model)
    with pytest.raises(ModelError, match="effects with memory"):
        mujoco_callback(fit_of("presliding"), model)
