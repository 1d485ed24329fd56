"""Excitation with a limit, a criterion and a wall of your own.

    python examples/own_limits.py [FOLDER]

The drives of the Panda may deliver at most 25 W in sum and the arm stays clear of a wall; the
trajectory minimizes the variances of the friction coefficients of joints 1 to 3 in place of the
condition number.
"""

import sys

import casadi as ca
import numpy as np

import lieid_casadi as lieid
from lieid_casadi.dynamics.lie import Motion
from lieid_casadi.dynamics.recursion import inverse_dynamics
from lieid_casadi.excitation import Criterion, SymbolicSet

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


class FrictionVariance(Criterion):
    """Logarithm of the sum of the variances of the friction coefficients."""

    name = "friction_variance"

    def evaluate(self, gram: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the value and its derivative by the information matrix."""
        covariance = np.linalg.inv(gram)
        total = covariance[FRICTION, FRICTION].sum()
        return np.log(total), -covariance[:, FRICTION] @ covariance[FRICTION] / total


def design(**options: object) -> lieid.Excitation:
    """Return the trajectory."""
    wall = lieid.Wall((0.0, -1.0, 0.0), 0.6, "wall")
    limits = [*lieid.default_limits(ROBOT), Power(25.0), wall]
    return lieid.excite(MODEL, criterion=FrictionVariance(), limits=limits, **options)


if __name__ == "__main__":
    found = design(starts=2)
    sys.stdout.write(found.summary() + "\n")
    if len(sys.argv) > 1:
        found.save(sys.argv[1], force=True)
