"""Excitation with a limit, a criterion and a keep-out box of your own.

    python examples/own_limits.py [FOLDER]

The drives of the Panda may deliver at most 25 W in sum and the arm stays clear of a pillar; the
trajectory minimizes the variances of the friction coefficients of joints 1 to 3 in place of the
condition number.
"""

import sys

import casadi as ca

import lieid_casadi as lieid

ROBOT = lieid.robots.panda()
MODEL = lieid.Model(ROBOT, effects=["coulomb:1+2+3", "viscous:1+2+3"])
FRICTION = [k for k, p in enumerate(MODEL.base_columns) if p.name.startswith(("coulomb", "visc"))]


def power(s: lieid.Symbols) -> ca.SX:
    """Return the mechanical power of all drives, W."""
    return ca.dot(s.tau, s.dq)


def friction_variance(information: ca.SX) -> ca.SX:
    """Return the logarithm of the sum of the variances of the friction coefficients."""
    covariance = ca.inv(information)
    return ca.log(sum(covariance[k, k] for k in FRICTION))


def design(**options: object) -> lieid.Excitation:
    """Return the trajectory."""
    power_limit = lieid.ExpressionLimit("power", power, upper=25.0, unit="W")
    pillar = lieid.Obstacle((0.4, -0.7, 0.0), (0.6, -0.4, 1.0), "pillar")
    limits = [*lieid.default_limits(ROBOT), power_limit, pillar]
    return lieid.excite(MODEL, criterion=friction_variance, limits=limits, **options)


if __name__ == "__main__":
    found = design(starts=2)
    sys.stdout.write(found.summary() + "\n")
    if len(sys.argv) > 1:
        found.save(sys.argv[1], force=True)
