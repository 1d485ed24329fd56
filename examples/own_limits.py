"""Excitation with a limit, a criterion and a keep-out box of your own.

    python examples/own_limits.py [FOLDER]

The drives of the Panda may deliver at most 25 W in sum and the arm stays clear of a pillar; the
trajectory minimizes the variances of the friction coefficients of joints 1 to 3 in place of the
condition number.
"""

import sys

import casadi as ca
import numpy as np

import lieid_casadi as lieid
from lieid_casadi.dynamics.lie import Motion
from lieid_casadi.dynamics.recursion import inverse_dynamics
from lieid_casadi.excitation import SymbolicSet

ROBOT = lieid.robots.panda()
MODEL = lieid.Model(ROBOT, effects=["coulomb:1+2+3", "viscous:1+2+3"])
FRICTION = [k for k, p in enumerate(MODEL.base_columns) if p.name.startswith(("coulomb", "visc"))]


class Power:
    """Mechanical power of all drives, by the rigid torque of the stated inertias."""

    name = "power"

    def __init__(self, most: float) -> None:
        self.most = most  # W

    def on(self, robot: lieid.Robot, fit: object = None) -> SymbolicSet:
        """Return the set of quantities that `lieid_casadi.excitation.Limit` asks for."""
        motion = Motion.symbols(robot.n)
        torque = inverse_dynamics(robot, motion, ca.SX(ca.DM(robot.link_parameters)))
        return SymbolicSet(
            "power", motion, ca.dot(torque, motion.dq),
            title=f"power of at most {self.most:g} W", labels=("power",), units=("W",),
            lower=np.array([-np.inf]), upper=np.array([self.most]), scale=np.array([self.most]),
            remedy="a longer duration",
        )  # fmt: skip


def friction_variance(information: ca.SX) -> ca.SX:
    """Return the logarithm of the sum of the variances of the friction coefficients."""
    covariance = ca.inv(information)
    return ca.log(sum(covariance[k, k] for k in FRICTION))


def design(**options: object) -> lieid.Excitation:
    """Return the trajectory."""
    pillar = lieid.Obstacle((0.4, -0.7, 0.0), (0.6, -0.4, 1.0), "pillar")
    limits = [*lieid.default_limits(ROBOT), Power(25.0), pillar]
    return lieid.excite(MODEL, criterion=friction_variance, limits=limits, **options)


if __name__ == "__main__":
    found = design(starts=2)
    sys.stdout.write(found.summary() + "\n")
    if len(sys.argv) > 1:
        found.save(sys.argv[1], force=True)
