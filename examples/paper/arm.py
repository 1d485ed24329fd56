"""The simulated arm of the paper: Table II's Panda with the friction of Eq. 8.

Printed values are used where they are physically plausible; other values are chosen here. The
friction is implemented by the plant and does not use the library's effects.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.plant.arm import Drive

Array = NDArray[np.float64]
PRINTED: dict[str, Any] = yaml.safe_load((Path(__file__).parent / "printed.yaml").read_text())

ROBOT = lieid.robots.panda_luo2024()
N = ROBOT.n
PAYLOADS: tuple[float, ...] = tuple(PRINTED["verification_payloads"])
HEAVIEST: float = PRINTED["friction_payload"]
CENTRE = (0.04, 0.0, 0.05)  # m, in the tool's frame: beside axis 7, so that joint 7 is loaded too

# Torque noise (N·m per sample at 1 kHz) of a real Panda: the part above 3 Hz of a public recording
# (unisa-acg/inverse-dynamics-solver). Velocity noise and encoder resolution are of its order.
TORQUE_NOISE = (0.5, 0.3, 0.4, 0.35, 0.067, 0.072, 0.042)
VELOCITY_NOISE = 5e-4  # rad/s
COUNTS = 2**20  # per turn of the joint

LOADED_AT = np.array([15.0, 60.0, 40.0, 25.0, 6.0, 8.0, 1.2])  # N·m: typical largest loads
STATIC = 1.5  # f_s / f_c
WIDTH_STATIC, WIDTH_COULOMB = 0.06, 0.02  # f_s1, f_c1, rad/s
FADED = 0.3  # |f_τ1| / f_c
FADING_SPEED = 0.05  # rad/s, at which half the largest load leaves 1/e of it


@dataclass(frozen=True, eq=False)
class Friction:
    """The ten coefficients of Eq. 8 and the offset of Eq. 17, (7,) each."""

    f_v1: Array
    f_v2: Array
    f_v3: Array
    f_c: Array
    f_c1: Array
    f_s: Array
    f_s1: Array
    f_tau: Array
    f_tau1: Array
    f_tau2: Array
    f_b: Array

    def rows(self) -> dict[str, Array]:
        """Return each by its name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


@cache
def true_friction() -> Friction:
    """Return the friction of the paper, corrected where the printed values are implausible.

    f_v1, f_b and |f_c| are as printed. f_v2 and f_v3 are the printed values times the largest
    factor up to 1 that keeps the slope between 0.2 and 2 times f_v1 up to the maximum speed of
    the joint (the printed values give negative friction there on all joints but the first, down
    to −30 N·m). Values of f_c below 0.01 are replaced by the median of the others. f_τ follows
    from Fig. 5: the RMS and correlation printed there give the standard deviation of the
    friction, rms/√(1 − σ²), and loads between 0 and L have a standard deviation of 0.3·L.
    """
    table = {name: np.array(row, dtype=float) for name, row in PRINTED["table_4"].items()}
    coulomb = np.abs(table["f_c"])
    coulomb = np.where(coulomb < 0.01, np.median(coulomb[coulomb >= 0.01]), coulomb)
    shrink = _shrinkage(table["f_v1"], table["f_v2"], table["f_v3"], ROBOT.limit("velocity"))
    figure = {name: np.array(row) for name, row in PRINTED["figure_5"].items()}
    varies = figure["rms"] / np.sqrt(1.0 - figure["correlation"] ** 2)
    return Friction(
        f_v1=table["f_v1"],
        f_v2=shrink * table["f_v2"],
        f_v3=shrink * table["f_v3"],
        f_c=coulomb,
        f_c1=np.full(N, WIDTH_COULOMB),
        f_s=STATIC * coulomb,
        f_s1=np.full(N, WIDTH_STATIC),
        f_tau=varies / (0.3 * LOADED_AT),
        f_tau1=-FADED * coulomb,
        f_tau2=FADING_SPEED / (0.5 * LOADED_AT),
        f_b=table["f_b"],
    )


def _shrinkage(f1: Array, f2: Array, f3: Array, fastest: Array) -> Array:
    """Return the largest factors (7,) ≤ 1 on f2, f3 that keep the slope within 0.2…2 · f1."""
    speed = np.linspace(0.0, 1.0, 201)[:, None] * fastest
    bend = 2.0 * f2 * speed + 3.0 * f3 * speed**2
    allowed = np.where(bend > 0.0, f1, -0.8 * f1)
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = np.where(bend == 0.0, np.inf, allowed / bend)
    return np.asarray(np.minimum(1.0, factor.min(axis=0)))


@cache
def true_arm(payload: float = 0.0) -> plant.Arm:
    """Return the arm with a payload of this mass (kg) at its tool."""
    f = true_friction()
    effects: list[plant.HiddenEffect] = []
    for j in range(N):
        effects += [
            plant.ViscousPolynomial(j, quadratic=f.f_v2[j], cubic=f.f_v3[j]),
            # f_c·(1 − e^{−(q̇/f_c1)²}) + f_s·e^{−(q̇/f_s1)²}: two decaying terms besides f_c
            plant.Stribeck(j, extra=-f.f_c[j], velocity=f.f_c1[j]),
            plant.Stribeck(j, extra=f.f_s[j], velocity=f.f_s1[j]),
            plant.LoadFriction(j, gain=f.f_tau[j], extra=f.f_tau1[j], rate=f.f_tau2[j]),
        ]
    if payload:
        effects.append(plant.Payload(payload, CENTRE))
    own = plant.JointFriction(coulomb=f.f_c, viscous=f.f_v1, offset=f.f_b)
    return plant.Arm(ROBOT, plant.perturbed_inertias(ROBOT, seed=1), own, tuple(effects))


def friction_surface(joint: int, speed: Array, load: Array) -> Array:
    """Return the true friction (P,) of a joint at speeds (rad/s) and loads (N·m), (P,) each."""
    arm = true_arm()
    zero = np.zeros((len(speed), N))
    dq, forces = zero.copy(), zero.copy()
    dq[:, joint], forces[:, joint] = speed, load
    state = plant.JointState(np.zeros(len(speed)), zero, dq, np.sign(dq), forces, zero)
    drive = Drive(arm)
    return np.asarray((drive.level(state) + drive.smooth(state) - arm.friction.offset)[:, joint])


def sensors(rate: float = 1000.0) -> plant.Sensors:
    """Return the sensors; below 1 kHz each row is the mean of the samples of 1 kHz."""
    fewer = np.sqrt(rate / 1000.0)
    return plant.Sensors(
        rate=rate,
        counts_per_turn=COUNTS,
        velocity_noise=float(fewer * VELOCITY_NOISE),
        torque_noise=tuple(fewer * np.array(TORQUE_NOISE)),
    )


def with_payload(links: Array, mass: float) -> Array:
    """Return link parameters (70,) with a payload of this mass (kg) at the tool."""
    carrying = plant.Arm(
        ROBOT, links, plant.JointFriction.none(N), (plant.Payload(mass, CENTRE),) if mass else ()
    )
    return carrying.loaded_parameters
