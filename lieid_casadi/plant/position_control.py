"""A simulated arm whose drives follow commanded positions, with hidden imperfections."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import EffectError
from lieid_casadi.plant.arm import Arm, JointFriction
from lieid_casadi.plant.effects import Armature
from lieid_casadi.plant.sensors import Sensors, measure
from lieid_casadi.plant.simulate import DriveCommand, Stepper, motion_of
from lieid_casadi.plant.trajectories import ReferenceTrajectory
from lieid_casadi.recording import Recording

CONTACT = 200.0  # rad/s, frequency of motor and link on the compliance of their contact
DAMPING = 0.5  # of that oscillation, relative to critical damping


@dataclass(frozen=True)
class PositionDrive:
    """One joint's position controller: torque = K·e − D·q̇ with e = q_cmd − q, limited.

    With backlash the encoder is at the motor, whose inertia is the armature of the arm's joint.
    """

    stiffness: float  # N·m/rad
    damping: float  # N·m·s/rad
    limit: float = np.inf  # largest torque that is proportional to the error, N·m
    delay: float = 0.0  # of the command, s
    deadband: float = 0.0  # errors of this size, rad, and smaller ones cause no torque
    backlash: float = 0.0  # play between motor and link, rad


def simulate_commands(
    arm: Arm,
    trajectory: ReferenceTrajectory,
    drives: Sequence[PositionDrive],
    *,
    duration: float,
    command_rate: float = 100.0,
    rate: float = 1000.0,
    sensors: Sensors | None = None,
    seed: int = 0,
    name: str = "",
) -> Recording:
    """Simulate an arm that follows commands, and record commands in place of torques.

    The commands are the trajectory at ``command_rate`` (Hz), held from one command to the next;
    there is one drive for each joint. Sensors are ideal at 200 Hz by default.

    EffectError: backlash on a joint without armature.
    """
    h = 1.0 / rate
    t = np.asarray(np.arange(round(duration * rate) + 1) * h)
    every = np.arange(0.0, duration + 1.0 / command_rate, 1.0 / command_rate)
    goals, _, _ = trajectory.at(np.clip(every, 0.0, trajectory.duration))

    def commands(times: Array) -> Array:
        rows = np.floor(times * command_rate + 1e-9).astype(int)
        return np.asarray(goals[np.clip(rows, 0, len(goals) - 1)])

    late = np.column_stack([commands(t - d.delay)[:, j] for j, d in enumerate(drives)])
    k, damping, limit, band = (
        np.array([getattr(d, field) for d in drives])
        for field in ("stiffness", "damping", "limit", "deadband")
    )
    motors = _motors(arm, drives, goals[0])
    stepper = Stepper(_without_motors(arm, list(motors)), h, goals[0])
    steps, motor = [], np.empty((t.size, arm.n))
    unlimited, temperature = np.full(arm.n, np.inf), arm.thermal.at(t, arm.n)
    for step in range(t.size):
        q, dq = stepper.q.copy(), stepper.dq.copy()
        for j, own in motors.items():
            q[j], dq[j] = own.q, own.dq
        error = late[step] - q
        part = k * (error - np.clip(error, -band, band))
        clipped = np.clip(part, -limit, limit)
        free = np.where(clipped == part, k, 0.0)
        constant = clipped - (damping + 0.5 * h * free) * dq
        gain = 0.5 * h * damping + 0.125 * h * h * free
        middles = {}
        for j, own in motors.items():
            contact = own.contact(stepper.q[j], stepper.dq[j])
            middles[j] = own.step(constant[j], gain[j], contact, h)
            constant[j], gain[j] = contact, 0.0
        result = stepper.step(t[step], DriveCommand(constant, gain, unlimited), temperature[step])
        steps.append(result)
        motor[step] = result.q
        for j, middle_angle in middles.items():
            motor[step, j] = middle_angle
    middle = np.asarray(t + 0.5 * h)  # of the steps, to which the rows belong
    motion = replace(motion_of(steps, middle, temperature), motor_q=motor)
    recorded = measure(arm, motion, sensors or Sensors(), seed=seed, name=name)
    return replace(recorded, tau=None, command=commands(recorded.t))


def _motors(arm: Arm, drives: Sequence[PositionDrive], start: Array) -> dict[int, MotorWithPlay]:
    """Return the motors of the joints with play, by joint, at rest at the start (n,)."""
    import pinocchio as pin

    model = arm.rigid_model()
    links = 1.0 / np.diag(np.linalg.inv(pin.crba(model, model.createData(), start)))
    found = {}
    for j, drive in enumerate(drives):
        if drive.backlash > 0.0:
            if not arm.armature[j] > 0.0:
                raise EffectError(
                    f"backlash on joint {j + 1}: expected an armature, the inertia of its motor"
                )
            f = arm.friction
            found[j] = MotorWithPlay(
                arm.armature[j], links[j], drive.backlash,
                f.coulomb[j], f.viscous[j], f.offset[j], start[j],
            )  # fmt: skip
    return found


def _without_motors(arm: Arm, joints: list[int]) -> Arm:
    """Return the arm without friction and armature of some joints, whose motors are apart."""
    friction = [x.copy() for x in (arm.friction.coulomb, arm.friction.viscous, arm.friction.offset)]
    for values in friction:
        values[joints] = 0.0
    effects = [e for e in arm.effects if not (isinstance(e, Armature) and e.joint in joints)]
    return replace(arm, friction=JointFriction(*friction), effects=tuple(effects))


@dataclass
class MotorWithPlay:
    """Motor side of a joint with play; friction of the joint acts on it.

    The link feels the contact alone: a spring and a damper that push and never pull while the
    angles differ by more than half of the play.
    """

    inertia: float  # kg·m²
    link_inertia: float  # of what it drives; sets the stiffness of the contact
    play: float  # rad
    coulomb: float
    viscous: float
    offset: float
    q: float
    dq: float = 0.0

    def contact(self, q: float, dq: float) -> float:
        """Return the torque on the link, N·m, at its position and velocity."""
        reduced = self.inertia * self.link_inertia / (self.inertia + self.link_inertia)
        half, twist = 0.5 * self.play, self.q - q
        depth = twist - float(np.clip(twist, -half, half))
        if depth == 0.0:
            return 0.0
        speed = self.dq - dq
        torque = reduced * CONTACT * (CONTACT * depth + 2.0 * DAMPING * speed)
        return torque if torque * depth > 0.0 else 0.0

    def step(self, constant: float, gain: float, contact: float, h: float) -> float:
        """Move by h (s) under the torque constant − gain·a of its drive and that of the contact.

        Returns the angle in the middle of the step; a is the acceleration of the motor.
        """
        middle = self.q + 0.5 * h * self.dq
        total = self.inertia + gain + 0.5 * h * self.viscous
        free = constant - contact - self.offset - self.viscous * self.dq
        speed = self.dq + h * free / total
        level = h * self.coulomb / total
        speed = float(np.sign(speed) * max(abs(speed) - level, 0.0))
        self.q, self.dq = middle + 0.5 * h * speed, speed
        return middle
