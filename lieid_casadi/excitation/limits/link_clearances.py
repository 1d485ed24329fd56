"""Distances of links from each other or from their surroundings as a constraint set."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from lieid_casadi.dynamics.lie import Motion as Symbols
from lieid_casadi.dynamics.lie import Pose
from lieid_casadi.excitation.limits.constraint_sets import ConstraintSet, UncheckedSet
from lieid_casadi.excitation.limits.symbolic_limits import SymbolicSet
from lieid_casadi.robot.robot import Robot

Array = NDArray[np.float64]
logger = logging.getLogger("lieid_casadi")
SCALE = 0.2  # m; unit in which violated distances are compared with other violations
TINY = 1e-12  # m²; keeps square roots and quotients of lengths smooth
PROBES = 500  # random poses at which distances are evaluated before the design


def point_in_base(pose: Pose, point: Array) -> ca.SX:
    """Return a point (3,) of a link in the base frame, m."""
    return ca.mtimes(pose.rotation, ca.DM(point)) + pose.translation


def link_name(robot: Robot, link: int) -> str:
    """Return a link's name in messages."""
    return "the base" if link == 0 else f"link {link}"


def clearances(
    name: str,
    robot: Robot,
    symbols: Symbols,
    labels: list[str],
    distances: list[ca.SX],
    clearance: float,
    slopes: list[ca.SX] | None = None,
    *,
    often: Sequence[float] = (),
) -> ConstraintSet | None:
    """Return the set distance ≥ clearance of the distances that depend on the pose.

    Parameters
    ----------
    name : str
        Of the set, in messages.
    robot : Robot
    symbols : Symbols
    labels : list of str
        Of the distances.
    distances : list of SX (1,)
        m.
    clearance : float
        m.
    slopes : list of SX (1, 3 n), optional
        Jacobians of the distances; differentiated by CasADi if left out.
    often : sequence of float
        Fraction of random poses for each distance: if it is below the clearance in as many or
        more, it is left out, and the set names it.
    """
    if not distances:
        return None
    touching, spread = _probed(robot, symbols, ca.vertcat(*distances), clearance)
    varying = np.flatnonzero((spread > 1e-9) & (touching < (often or np.inf)))
    coarse = [labels[k] for k in np.flatnonzero((spread > 1e-9) & (touching >= (often or np.inf)))]
    if coarse:
        logger.info(
            "%s: not checked, because the capsules are too coarse: %s", name, "; ".join(coarse)
        )
    if not len(varying):
        return UncheckedSet(coarse) if coarse else None
    count = len(varying)
    chosen = ca.vertcat(*(distances[k] for k in varying))
    jacobian = None if slopes is None else ca.vertcat(*(slopes[k] for k in varying))
    return SymbolicSet(
        "".join(c if c.isalnum() else "_" for c in name), symbols, chosen, jacobian,
        labels=[labels[k] for k in varying], units=["m"] * count,
        lower=np.full(count, clearance), upper=np.full(count, np.inf), scale=np.full(count, SCALE),
        remedy="another start pose, thinner capsules or a wider workspace", left_out=coarse,
    )  # fmt: skip


def _probed(
    robot: Robot, symbols: Symbols, distances: ca.SX, clearance: float
) -> tuple[Array, Array]:
    """Return the fraction of random poses below the clearance, and the range of each distance."""
    generator = np.random.default_rng(0)
    low, high = robot.limit("position_lower"), robot.limit("position_upper")
    low, high = np.where(np.isfinite(low), low, -np.pi), np.where(np.isfinite(high), high, np.pi)
    q = generator.uniform(low, high, (PROBES, robot.n))
    function = ca.Function("distances", [symbols.q, symbols.sin, symbols.cos], [distances])
    values = function(q.T, np.sin(q).T, np.cos(q).T).full()
    return np.mean(values < clearance, axis=1), np.ptp(values, axis=1)
