"""Premises on what the torque signal means: gravity included, in N·m, measured."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from lieid_casadi.premises.correction import Correction
from lieid_casadi.premises.joints import torques
from lieid_casadi.premises.screen import Alternative, Screen
from lieid_casadi.robot import Robot

#: Least part of a joint's torque (squared correlation) that the stated inertias explain, so that
#: the factor on them is known.
EXPLAINED = 0.6
#: Least factor between recorded and stated torque that is reported.
LEAST_FACTOR = 2.0
#: Ratio of the largest to the smallest factor of the joints up to which they are one unit.
ONE_UNIT = 1.6
#: Units in N·m, by how many of them are one.
DECIMAL = {1e3: "mN·m", 1e2: "N·cm", 1e-3: "kN·m"}
#: Friction and error of a computed torque, as part of the torque; least range of a joint that
#: moves, rad or m.
COMPUTED, MOVES = 0.005, 0.05
#: Mass of an arm per metre of reach below which it is a placeholder, kg/m.
WEIGHTLESS = 0.3


def gravity_compensated(screen: Screen) -> Iterator[Alternative]:
    """Yield the torque without gravity, and without that of a controller's model of its own."""
    none = Correction.none(screen.n)
    for with_what, correction, cost in (
        ("without gravity in the model", replace(none, gravity=np.zeros(3)), 0.0),
        ("with the stated gravity added to it", replace(none, weight=True), 1.0),
    ):
        yield Alternative(
            "torque_gravity_compensated", (), {},
            "The torque of this recording does not contain gravity: the controller compensates it; "
            f"{with_what}",
            correction, cost,
            remedy="record the whole torque of the joints (motor torque or current, not the torque "
            "that the controller adds to its gravity compensation)",
        )  # fmt: skip


def units(screen: Screen) -> Iterator[Alternative]:
    """Yield the factors between recorded and stated torque, as one unit or one per joint."""
    stated = screen.base.stated
    if stated is None:
        return
    known = np.isfinite(stated.gain) & (stated.gain > 0.0)
    with np.errstate(invalid="ignore"):
        part = (stated.gain * stated.share) ** 2 / stated.own**2
    known &= np.nan_to_num(part) > EXPLAINED
    if known.sum() < max(1, min(2, screen.n // 3)):
        return
    logs = np.log(stated.gain[known])
    middle = float(np.exp(np.median(logs)))
    if abs(np.log(middle)) < np.log(LEAST_FACTOR):
        return
    gains = np.where(known, stated.gain, middle)
    power = 10.0 ** round(np.log10(middle))
    unit = DECIMAL.get(power, "A")
    if (
        unit != "A"
        and np.exp(np.ptp(logs)) < ONE_UNIT
        and abs(np.log(middle / power)) < np.log(2.0)
    ):
        factor, gains = 1.0 / power, np.full(screen.n, power)
    else:
        factor, unit = 1.0 / middle, "A"
    constants = ",".join(f"{1.0 / g:.4g}" for g in gains)
    words = "in other units, such as amperes" if unit == "A" else f"in {unit}"
    words += ", or a current in mA" if unit == "N·cm" else ""
    yield Alternative(
        "torque_unit",
        tuple(np.argsort(-stated.own)[:3].tolist()),
        {"factor": float(f"{factor:.4g}"), "unit": unit},
        f"The torque is not in N·m but {words}: the stated masses need {factor:.3g} times the "
        f"recorded torque (joint by joint {constants}); with {{}}",
        torques(np.diag(1.0 / gains)),
        cost=1.0,
    )


def from_model(screen: Screen) -> bool:
    """Whether the torque has neither friction nor noise, as one that a model computes."""
    base, own = screen.base, screen.thin.own
    friction = np.std(np.einsum("jk,jkn->jn", base.free.own[:, 1:3], own[:, 1:3]), axis=1)
    moves = np.ptp(screen.thin.q, axis=0) > MOVES
    largest = np.maximum(friction, base.free.error)[moves] / base.scale[moves]
    return bool(moves.any() and largest.max() < COMPUTED)


def weightless(robot: Robot) -> bool:
    """Return whether the stated masses are placeholders."""
    if not robot.has_inertia:
        return False
    mass = float(robot.link_parameters[::10].sum())
    homes = [np.asarray(joint.home, dtype=float)[:3, 3] for joint in robot.joints]
    reach = sum(float(np.linalg.norm(b - a)) for a, b in pairwise(homes))
    return mass < WEIGHTLESS * max(reach, 0.1)


def not_checkable(robot: Robot, placeholder: bool) -> str | None:
    """Return why the unit of the torque is not identifiable, or None."""
    if not robot.has_inertia:
        return "the robot states no masses and inertias"
    return "the stated masses are placeholders" if placeholder else None
