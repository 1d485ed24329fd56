"""Forward simulation with backlash, checked against the plant: two masses and a stiff contact."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from exporters.c_arms import made_fit

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.exporters.mjcf import mjcf_text
from lieid_casadi.robot.drive import Drive
from lieid_casadi.simulation.step import plays_of

LAWS = [Drive(stiffness=120.0, damping=2.0), Drive(stiffness=50.0, damping=0.5)]
ROBOT = lieid.robots.two_link().with_drives(LAWS)
PLAY = 0.03  # rad
ROTORS = (0.06, 0.02)  # kg·m²
HELD = 0.0025  # s, by which commands at 200 Hz are late on average


def arm_and_run(joints, *, motion=2, seconds=8.0):
    """Return a simulated arm with play on some joints (from 0), and its recording."""
    arm = plant.demo_arm(ROBOT, seed=1, hidden=None)
    arm = arm.with_effects(*(plant.Armature(j, inertia) for j, inertia in enumerate(ROTORS)))
    drives = [
        plant.PositionDrive(law.stiffness, law.damping, backlash=PLAY if j in joints else 0.0)
        for j, law in enumerate(LAWS)
    ]
    path = plant.FourierTrajectory(ROBOT, base_frequency=0.1, harmonics=6, seed=motion)
    run = plant.simulate_commands(
        arm, path, drives, duration=seconds, command_rate=200.0, rate=2000.0,
        sensors=plant.demo_sensors(ROBOT), seed=motion,
    )  # fmt: skip
    return arm, run.with_drives(LAWS)


def true_fit(arm, plays):
    """Return the fit with the arm's own numbers and plays (2,), rad."""
    fit = made_fit(ROBOT, "coulomb,viscous,offset,armature,command_delay,backlash")
    f = arm.friction
    parameters = [arm.parameters, f.coulomb, f.viscous, f.offset, ROTORS, [HELD] * 2, plays]
    return replace(
        fit, parameters=np.concatenate(parameters), processing=lieid.Processing(cutoff=40.0)
    )


def drift(arm, run, plays, **options):
    """Return the drift of the simulation with plays (2,), deg per joint."""
    simulation = lieid.simulate(true_fit(arm, plays), run, **options)
    return np.degrees(simulation.drift.rms)


@pytest.mark.slow
def test_motion_is_that_of_the_plant():
    arm, run = arm_and_run((0, 1))
    found, without = drift(arm, run, [PLAY, PLAY]), drift(arm, run, [0.0, 0.0])
    assert found.max() < 0.05
    assert (found < 0.6 * without).all()


def test_a_link_stays_within_its_play():
    from lieid_casadi.simulation.runs import motions, runs_of

    arm, run = arm_and_run((1,), seconds=1.8)
    fit = true_fit(arm, [0.0, PLAY])
    (part,) = runs_of(fit, run, 1.0, "command")
    path = motions([fit], part, np.zeros(1, dtype=int), length=len(part.segment) - 1)
    twist = path[:, 0, 1] - path[:, 0, 2]
    assert np.abs(twist).max() < 0.5 * PLAY + 1e-3
    assert np.ptp(twist) > 0.9 * PLAY
    assert (np.abs(twist) > 0.5 * PLAY - 1e-4).mean() > 0.5


def test_a_play_beyond_any_gear_is_not_simulated():
    """A load that keeps its sign does not determine the play."""
    arm, _ = arm_and_run((), seconds=0.1)
    assert [play.joint for play in plays_of(true_fit(arm, [1.2, PLAY]))] == [1]


@pytest.mark.slow
def test_an_identified_play_reduces_the_drift():
    """Against the model that never had a play, on a recording that was not fitted."""
    train, test = (arm_and_run((1,), motion=motion, seconds=10.0)[1] for motion in (2, 3))
    drifts = []
    for effects in ("", ",backlash:2"):
        model = lieid.Model(ROBOT, f"coulomb,viscous,offset,armature,command_delay{effects}")
        fit = lieid.identify(model, train, method="feasible")
        drifts.append(lieid.simulate(fit, test).drift.rms)
    assert (drifts[1] < 0.6 * drifts[0]).all()


def drift_in_mujoco(arm, run, plays):
    """Return the drift of the exported model, deg; windows start with links in the middle."""
    model = mujoco.MjModel.from_xml_string(mjcf_text(true_fit(arm, plays))[0])
    model.actuator_delay[:], model.opt.timestep = 0.0, 0.001
    motors, data, ends = model.actuator_trnid[:, 0], mujoco.MjData(model), []
    angles, speeds = model.jnt_qposadr[motors], model.jnt_dofadr[motors]
    (segment,) = lieid.recording.process(run, lieid.Processing(cutoff=40.0, trim=0.0))
    rate = round(segment.rate)
    for start in range(0, len(segment) - rate - 1, rate):
        mujoco.mj_resetData(model, data)
        data.qpos[angles], data.qvel[speeds] = segment.q[start], segment.dq[start]
        for k in range(1000):
            row = np.searchsorted(run.t, segment.t[start] + 0.001 * k + 1e-9, side="right") - 1
            data.ctrl[:] = run.command[row]
            mujoco.mj_step(model, data)
        ends.append(data.qpos[angles] - segment.q[start + rate])
    return np.degrees(np.sqrt(np.mean(np.square(ends), axis=0)))


@pytest.mark.slow
def test_the_exported_play_moves_as_the_plant():
    arm, run = arm_and_run((1,))
    found, without = (drift_in_mujoco(arm, run, [0.0, play]) for play in (PLAY, 0.0))
    assert np.linalg.norm(found) < 0.75 * np.linalg.norm(without)
