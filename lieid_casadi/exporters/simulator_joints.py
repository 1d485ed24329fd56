"""What exports to simulators share: armature, damping and dry friction of joints, refusals."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import nnls

from lieid_casadi.arrays import Array
from lieid_casadi.effects import Placement
from lieid_casadi.errors import ExportError
from lieid_casadi.friction_curves.friction_fit import steady_columns
from lieid_casadi.identification.fit import Fit
from lieid_casadi.robot import Robot
from lieid_casadi.robot.description import RobotSource
from lieid_casadi.robot.inertia import body_inertia

SAMPLES = 400  # of speed, load and position, at which friction is evaluated
SPEEDS = (0.02, 0.5)  # of the joint's velocity limit, from and to
UNKNOWN_SPEED = 2.0  # rad/s, velocity limit of a robot that states none
#: Stiffness of the spring that produces a constant torque, in parts of that torque per radian: the
#: torque changes by this share over a radian.
WEAK_SPRING = 1e-6
FRICTION_IMPEDANCE = (0.99, 0.99, 0.001)  # solimpfriction: 0.01 of the acceleration is not resisted
WARM = 1e6  # s since the start, at which warm-up has ended
EXACT = 1e-9  # relative error of friction of the linear form


def armature(fit: Fit, index: int) -> float | None:
    """Return the armature of a joint (from 0), kg·m² or kg; None if the model does not have it."""
    own = numbers_of_joint(fit, index).get("armature.I_a")
    return None if own is None else max(own, 0.0)


def left_out(fit: Fit, *, friction: bool, besides: Collection[str] = ("armature",)) -> list[str]:
    """Return the labels of effects that a format lacks."""
    placements = [p for p in fit.model.placements if p.effect.name not in besides]
    if friction:
        placements = [p for p in placements if not _is_friction(p)]
    return list(dict.fromkeys(p.effect.label for p in placements))


def has_friction(fit: Fit) -> bool:
    """Whether the model has effects that depend on velocity."""
    return any(_is_friction(p) for p in fit.model.placements)


def _is_friction(placement: Placement) -> bool:
    return bool(set(placement.effect.signals) & {"dq", "sign"})


@dataclass(frozen=True)
class LinearFriction:
    """Friction of one joint as damping·q̇ + loss·sgn(q̇), neither of them negative."""

    damping: float
    loss: float
    error: float  # RMS of the difference from the model's friction, N·m
    share: float  # the same in parts of the RMS friction

    @property
    def exact(self) -> bool:
        """Whether this form has all of the friction."""
        return self.share < EXACT


def linear_friction(fit: Fit) -> tuple[LinearFriction, ...]:
    """Return the friction of all joints by non-negative least squares.

    The model's friction in steady state is evaluated at `SPEEDS`, at random poses within the
    position limits, under the load of the links at these poses.
    """
    robot = fit.model.robot
    lower, upper = robot.limit("position_lower"), robot.limit("position_upper")
    lower, upper = np.nan_to_num(lower, nan=-np.pi), np.nan_to_num(upper, nan=np.pi)
    q = np.random.default_rng(0).uniform(lower, upper, (SAMPLES, robot.n))
    loads = fit.compiled.inverse_dynamics(q, 0.0 * q, 0.0 * q, fit.link_parameters)
    limit = robot.limit("velocity")
    limit = np.where(np.isfinite(limit), limit, UNKNOWN_SPEED)
    found = []
    for joint in range(robot.n):
        speed = np.linspace(*SPEEDS, SAMPLES) * limit[joint]
        columns = steady_columns(
            fit.compiled, joint, speed, fit.shapes,
            load=loads[:, joint], position=q[:, joint], time=WARM,
        )  # fmt: skip
        friction = columns @ fit.effect_coefficients
        (damping, loss), _ = nnls(np.column_stack([speed, np.ones_like(speed)]), friction)
        error = float(np.sqrt(np.mean((damping * speed + loss - friction) ** 2)))
        size = float(np.sqrt(np.mean(friction**2)))
        found.append(
            LinearFriction(float(damping), float(loss), error, error / size if size else 0.0)
        )
    return tuple(found)


@dataclass(frozen=True)
class PassiveTorques:
    """Passive torques of a joint by the names of MuJoCo's attributes; None: the fit has none."""

    armature: float
    damping: float
    frictionloss: float
    stiffness: float | None
    springref: float | None
    solreffriction: tuple[float, float] | None = None
    solimpfriction: tuple[float, float, float] | None = None


def passive_torques(fit: Fit, index: int, friction: LinearFriction) -> PassiveTorques:
    """Return the passive torques of a joint (from 0); a constant one is that of a weak spring."""
    own, drive = numbers_of_joint(fit, index), fit.model.robot.joints[index].drive
    # of a servo's motor, which its duty's limit does not limit
    servo = drive.damping if drive is not None and math.isfinite(drive.proportional_limit) else 0.0
    offset, stiffness = own.get("offset.f_b", 0.0), own.get("position_spring.K", 0.0)
    if offset and not stiffness:
        stiffness = WEAK_SPRING * abs(offset)
    return PassiveTorques(
        armature(fit, index) or 0.0,
        friction.damping + servo,
        friction.loss,
        stiffness or None,
        -offset / stiffness if stiffness else None,
    )


@dataclass(frozen=True)
class ActuatorLaw:
    """Gains of a position actuator, limit of its force, and the delay of its commands."""

    stiffness: float  # N·m/rad
    damping: float  # N·m·s/rad
    force: float  # N·m
    delay: float  # s


def actuator_law(fit: Fit, index: int) -> ActuatorLaw | None:
    """Return the law of a joint's actuator (from 0), None without a drive."""
    joint, own = fit.model.robot.joints[index], numbers_of_joint(fit, index)
    if joint.drive is None:
        return None
    drive = joint.drive.limited(joint.limits.torque)
    force = min(drive.proportional_limit, drive.torque_limit)
    if "torque_saturation.e_s" in own:
        force = min(force, drive.stiffness * own["torque_saturation.e_s"])
    # what the limit of the force limits, too; the back-EMF of a servo is damping of its joint
    damping = drive.derivative + (0.0 if math.isfinite(drive.proportional_limit) else drive.damping)
    return ActuatorLaw(drive.stiffness, damping, force, own.get("command_delay.delta", 0.0))


def for_steps(
    passive: PassiveTorques, law: ActuatorLaw | None, step: float, integrator: str
) -> tuple[PassiveTorques, ActuatorLaw | None]:
    """Return torques and law with which a joint moves in steps (s) as the fit states.

    MuJoCo's friction loss is a constraint with a time constant of 20 ms, by which a joint at rest
    creeps and a moving one lags: it gets the shortest one that is stable. MuJoCo takes damping from
    the velocity at the end of a step, which adds half a step times the damping to the inertia of a
    joint under commands: M·q̈ = f − D·(q̇ + h/2·q̈). Its implicit integrators do so with an
    actuator's kv, too, which Euler's takes from the velocity at the start. The force of a command
    moves a joint within the same step, on average half a step early: its delay is longer by that.
    """
    if passive.frictionloss:
        passive = replace(
            passive, solreffriction=(2.0 * step, 1.0), solimpfriction=FRICTION_IMPEDANCE
        )
    if law is None or integrator == "RK4":
        return passive, law
    if law.delay > 0.0:
        law = replace(law, delay=law.delay + 0.5 * step)
    added = passive.damping + (-law.damping if integrator == "Euler" else law.damping)
    return replace(passive, armature=max(passive.armature - 0.5 * step * added, 0.0)), law


def numbers_of_joint(fit: Fit, index: int) -> dict[str, float]:
    """Return the coefficients and shape parameters of a joint (from 0) by name."""
    columns = (*fit.model.columns, *fit.model.shapes)
    values = np.concatenate([fit.effect_coefficients, fit.shapes])
    pairs = zip(columns, values, strict=True)
    return {column.name: float(value) for column, value in pairs if column.joint == index}


def inertial(parameters: Array) -> dict[str, str]:
    """Return the attributes of MuJoCo's <inertial> of link parameters (10,)."""
    body = body_inertia(parameters)
    i = body.inertia
    six = [i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]]
    return {"pos": vector(body.com), "mass": number(body.mass), "fullinertia": vector(six)}


def beyond_linear_friction(friction: Sequence[LinearFriction]) -> list[str]:
    """Return a note on each joint whose friction has another form, with the error."""
    return [
        f"joint {j + 1}: friction approximated by damping {own.damping:.4g} and "
        f"frictionloss {own.loss:.4g}; RMS error {own.error:.3g} N·m, "
        f"{100.0 * own.share:.0f} % of the friction (speeds of 2 to 50 % of the limit, "
        "loads at rest over the position range)"
        for j, own in enumerate(friction)
        if not own.exact
    ]


def check_possible(fit: Fit) -> None:
    """Refuse a fit whose masses and inertias are not certified to be physically consistent."""
    if fit.certificate is not None and fit.certificate.holds and fit.physically_consistent:
        return
    effects = ",".join(fit.model.effects)
    runs = " ".join(source.name or "TRAIN" for source in fit.provenance.recordings) or "TRAIN…"
    option = f" --effects {effects}" if effects else ""
    raise ExportError(
        f"masses and inertias of a fit of method {fit.method} may not be physically consistent; "
        f"expected a fit of method feasible: lieid identify ROBOT {runs}{option} --method feasible "
        "-o fit.json"
    )


def source_of(fit: Fit, into: str | Path | None) -> RobotSource | None:
    """Return the file that an export edits: that of the robot, or another one with the same arm."""
    robot = fit.model.robot
    if into is None:
        return robot.source
    last = robot.joints[-1].link_name
    tip, lock = (robot.source.tip or last, robot.source.lock) if robot.source else (last, ())
    read = Robot.load(into, tip=tip, lock=lock)
    stated, expected = ([joint.name for joint in each.joints] for each in (read, robot))
    places = zip(read.joints, robot.joints, strict=False)
    if stated != expected or any(not np.allclose(a.home, b.home, atol=1e-6) for a, b in places):
        raise ExportError(
            f"{into}: joints up to {tip} are {', '.join(stated)}; expected {', '.join(expected)}, "
            "at the places that they have in the fit"
        )
    return read.source


def file_name(name: str) -> str:
    """Return a name of a file for the name of a robot."""
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in name) or "robot"


def number(value: float) -> str:
    """Return a number that reads back the same."""
    return repr(float(value) + 0.0)


def vector(values: Array | Sequence[float]) -> str:
    """Return numbers that read back the same, with spaces between them."""
    return " ".join(number(value) for value in values)
