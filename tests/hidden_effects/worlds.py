"""Recordings that violate assumptions of the model, with nothing else hidden.

A diagnosis may name what ``allowed`` lists, or report that something is unexplained; any other
name is wrong.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import yaml
from hidden_effects.effect_library import ReferenceMotion
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from lieid_casadi import Recording, plant
from lieid_casadi.arrays import Array
from lieid_casadi.plant import Arm, TrueMotion, build_pinocchio
from lieid_casadi.plant.sensors import coloured_noise

Named = tuple[str, tuple[int, ...]]  # effect and joints from 1; no joints: on any


@dataclass(frozen=True, eq=False)
class Measured:
    """One run: what the sensors of the assumed world recorded, and the truth behind it."""

    recording: Recording
    arm: Arm
    motion: TrueMotion
    noise: Array
    random: np.random.Generator

    @property
    def rows(self) -> NDArray[np.intp]:
        """The instants of the motion that were recorded."""
        return np.searchsorted(self.motion.t, self.recording.t)

    def with_torque(self, change: Array) -> Recording:
        """Return the recording with a torque (N, n) added."""
        assert self.recording.tau is not None
        return replace(self.recording, tau=self.recording.tau + change)


@dataclass(frozen=True, eq=False)
class World:
    """A violated assumption; what is not stated is as assumed."""

    name: str
    allowed: tuple[Named, ...] = ()  # effects that may be named
    hide: Callable[[Arm, int], Arm] = lambda arm, run: arm  # run: from 0
    describe: Callable[[str], str] = lambda text: text  # of the robot as YAML, for the diagnosis
    record: Callable[[Measured], Recording] = lambda run: run.recording


def _torque_filter(g: ReferenceMotion, j: int) -> World:
    """The vendor's low-pass filter of all torque signals."""
    cutoff = g.log(8.0, 30.0)
    lag = plant.TorqueLowpass(None, 1.0 / (2.0 * np.pi * cutoff), 2)
    return World(
        "torque_filter",
        (("torque_lowpass", ()), ("time_shift", ()), ("torque_delay", ())),
        hide=lambda arm, run: arm.with_effects(lag),
    )


def _kinematics(g: ReferenceMotion, j: int) -> World:
    """Joint axes off by 5 mm each in the robot's description."""
    shifts = [0.005 * g.direction(3) for _ in range(g.n)]

    def describe(text: str) -> str:
        data = yaml.safe_load(text)
        for joint, shift in zip(data["joints"], shifts, strict=True):
            turn, at = np.array(joint["screw"][:3]), np.array(joint["home"]["xyz"]) + shift
            moved = np.array(joint["screw"][3:]) - np.cross(turn, shift)
            joint["screw"] = [*map(float, turn), *map(float, moved)]
            joint["home"]["xyz"] = [*map(float, at)]
        return str(yaml.safe_dump(data, sort_keys=False))

    return World("kinematics", describe=describe)


def _tilted_run(g: ReferenceMotion, j: int) -> World:
    """The base is tilted in the first of two training recordings."""
    x, y = np.radians(g.log(0.7, 2.0)) * g.direction(2)
    tilt = plant.BaseTilt(about_x=float(x), about_y=float(y))
    return World(
        "tilted_run", (("base_tilt", ()),),
        hide=lambda arm, run: arm.with_effects(tilt) if run == 0 else arm,
    )  # fmt: skip


def _feedback_noise(g: ReferenceMotion, j: int) -> World:
    """A coarse encoder whose quantisation error drives the torque through the controller."""
    counts, size = float(2 ** g.random.integers(12, 15)), g.log(2.0, 6.0)

    def record(run: Measured) -> Recording:
        step = 2.0 * np.pi / counts
        coarse = np.round(run.motion.motor_q / step) * step
        error = gaussian_filter1d(coarse - run.motion.motor_q, 3.0, axis=0)
        reaction = np.gradient(error, run.motion.t, axis=0)[run.rows]
        level = np.sqrt(np.mean(reaction**2, axis=0)) + 1e-30
        shown = run.with_torque(-size * run.noise * reaction / level)
        return replace(shown, q=coarse[run.rows], dq=None)

    return World("feedback_noise", record=record)


def _shared_noise(g: ReferenceMotion, j: int) -> World:
    """Noise of the torque that all joints share."""
    loading, time, size = g.random.uniform(-1.0, 1.0, g.n), g.log(0.02, 0.5), g.log(1.0, 3.0)

    def record(run: Measured) -> Recording:
        shared = coloured_noise(run.recording.t, 1, time, run.random)
        return run.with_torque(size * shared * loading * run.noise)

    return World("shared_noise", record=record)


def _shaking_floor(g: ReferenceMotion, j: int) -> World:
    """The base accelerates to and fro with one frequency."""
    frequency, size = g.log(2.0, 7.0), g.log(0.05, 0.3)
    direction = g.direction(3)

    def record(run: Measured) -> Recording:
        import pinocchio as pin

        robot, t = run.arm.robot, run.recording.t
        model = build_pinocchio(robot, run.arm.loaded_parameters, gravity=direction)
        data = model.createData()
        along = np.array(
            [pin.computeGeneralizedGravity(model, data, q) for q in run.motion.q[run.rows]]
        )
        phase = run.random.uniform(-np.pi, np.pi)
        return run.with_torque(size * np.sin(2.0 * np.pi * frequency * t + phase)[:, None] * along)

    return World("shaking_floor", record=record)


def _fine_cogging(g: ReferenceMotion, j: int) -> World:
    """Cogging at 100 per turn of one joint."""
    ripple = plant.TorqueRipple(
        j, amplitude=g.log(0.01, 0.03) * float(g.torque[j]), harmonic=100.0, phase=g.angle()
    )
    return World(
        "fine_cogging", (("torque_ripple", (j + 1,)),),
        hide=lambda arm, run: arm.with_effects(ripple),
    )  # fmt: skip


def _quantised_current(g: ReferenceMotion, j: int) -> World:
    """Torque in steps several times as large as its noise."""
    steps = g.log(4.0, 12.0)

    def record(run: Measured) -> Recording:
        tau, step = run.recording.tau, steps * run.noise
        return replace(run.recording, tau=np.round(tau / step) * step)

    return World("quantised_current", record=record)


def _backlash(g: ReferenceMotion, j: int) -> World:
    """The measured angle is ahead of the link's by half the play, towards the load."""
    play = g.log(0.002, 0.02) * (1.0 if g.revolute(j) else 0.2)
    width = 0.02 * float(g.load[j]) + 1e-9

    def record(run: Measured) -> Recording:
        lost = 0.5 * play * np.tanh(run.motion.rigid[:, j] / width)
        q = run.recording.q.copy()
        q[:, j] += lost[run.rows]
        return replace(run.recording, q=q, dq=None)

    here = (j + 1,)
    return World(
        "backlash", (("backlash", here), ("joint_elasticity", here), ("encoder_offset", here)),
        record=record,
    )  # fmt: skip


def _torque_saturation(g: ReferenceMotion, j: int) -> World:
    """A torque signal that is clipped during the largest torques."""
    percentile = float(g.random.uniform(80.0, 95.0))

    def record(run: Measured) -> Recording:
        assert run.recording.tau is not None
        tau = run.recording.tau.copy()
        limit = float(np.percentile(np.abs(tau[:, j]), percentile))
        tau[:, j] = np.clip(tau[:, j], -limit, limit)
        return replace(run.recording, tau=tau)

    return World("torque_saturation", (("torque_saturation", (j + 1,)),), record=record)


def _bam_m1(g: ReferenceMotion, j: int) -> World:
    """Rhoban's servo model M1, Coulomb and viscous friction: nothing is violated."""
    return World("bam_m1")


WORLDS: dict[str, Callable[[ReferenceMotion, int], World]] = {
    "torque_filter": _torque_filter,
    "kinematics": _kinematics,
    "tilted_run": _tilted_run,
    "feedback_noise": _feedback_noise,
    "shared_noise": _shared_noise,
    "shaking_floor": _shaking_floor,
    "fine_cogging": _fine_cogging,
    "quantised_current": _quantised_current,
    "backlash": _backlash,
    "torque_saturation": _torque_saturation,
    "bam_m1": _bam_m1,
}
