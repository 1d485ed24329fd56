"""Bodies that link inertias are drawn towards: the nominal ones, or neutral balls."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import IdentificationError, LieidWarning, NominalInertiaWarning
from lieid_casadi.identification.regression.least_squares import Factor
from lieid_casadi.model import Model
from lieid_casadi.robot.inertia import body_inertia, link_parameters, pseudo_inertia
from lieid_casadi.robot.robot import Robot

Array = NDArray[np.float64]
FLAT = 1e-6  # least over greatest second moment that still passes for a body
MENDED_FLATNESS = 1e-3  # the same of a mended body
MENDED_GYRATION = 0.01  # m, radius of gyration along each axis that a mended body has at least
SMALLEST_RADIUS = 0.05  # m, of a neutral ball
DENSITY = (100.0, 5000.0)  # kg/m³, of neutral balls


def reference_bodies(model: Model, factor: Factor) -> tuple[Array, tuple[LieidWarning, ...]]:
    """Return a positive definite pseudo-inertia per link (n, 4, 4).

    A link that states its inertia is its own reference; one that no body can have (flat, or
    violating the triangle inequalities) is mended and told. A link that states none gets a
    uniform ball half-way to the next joint; all balls have one density, the one that fits best.

    Parameters
    ----------
    factor : Factor
        Weighted, for the density.

    Raises
    ------
    IdentificationError
        A link states a negative mass.
    """
    found: list[LieidWarning] = []
    links = []
    for joint in model.robot.joints:
        if joint.link is None:
            links.append(np.full(10, np.nan))
            continue
        name = joint.link_name or joint.name
        if joint.link[0] <= 0.0:
            raise IdentificationError(
                f"robot {model.robot.name!r}: link {name!r} states a mass of {joint.link[0]:g} kg; "
                "expected a positive mass, or none"
            )
        mended = _mended(joint.link)
        if mended is not joint.link:
            found.append(
                NominalInertiaWarning(
                    f"no body can have the inertia that link {name!r} states; a nearby one that "
                    "can exist took its place as the reference of method feasible"
                )
            )
        links.append(mended)
    known = _with_balls(model, np.array(links), factor)
    return np.array([pseudo_inertia(link) for link in known]), tuple(found)


def _mended(link: Array) -> Array:
    """Return a body whose second moments are all positive; the same object if they are."""
    body = body_inertia(link)
    moments, axes = np.linalg.eigh(0.5 * np.trace(body.inertia) * np.eye(3) - body.inertia)
    if moments[0] > FLAT * max(float(moments[-1]), FLAT * body.mass):
        return link
    least = max(MENDED_FLATNESS * float(moments[-1]), body.mass * MENDED_GYRATION**2)
    sigma = axes @ np.diag(np.maximum(moments, least)) @ axes.T
    return link_parameters(body.mass, body.com, np.trace(sigma) * np.eye(3) - sigma)


def _with_balls(model: Model, links: Array, factor: Factor) -> Array:
    missing = np.isnan(links[:, 0])
    if not missing.any():
        return links
    balls = np.array([_ball(model.robot, i) for i in range(model.n)])
    known = np.where(missing[:, None], 0.0, links)
    density = _density(model, factor, known, np.where(missing[:, None], balls, 0.0))
    return np.where(missing[:, None], density * balls, links)


def _ball(robot: Robot, i: int) -> Array:
    """Return a ball of unit density between joint i and the next one, or the tool."""
    here = robot.joints[i].home
    following = robot.joints[i + 1].home if i + 1 < robot.n else here @ robot.tool
    centre = 0.5 * (np.linalg.solve(here, following))[:3, 3]
    radius = max(float(np.linalg.norm(centre)), SMALLEST_RADIUS)
    mass = 4.0 / 3.0 * np.pi * radius**3
    return link_parameters(mass, centre, 0.4 * mass * radius**2 * np.eye(3))


def _density(model: Model, factor: Factor, known: Array, balls: Array) -> float:
    """Return the density that fits best, the effects' coefficients being free."""
    combination, links = model.base.combination, 10 * model.n
    r, z = factor.r[:, :-1], factor.r[:, -1]
    columns = r @ combination
    matrix = np.column_stack([columns[:, :links] @ balls.ravel(), columns[:, links:]])
    target = z - columns[:, :links] @ known.ravel()
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale == 0.0] = 1.0
    best = np.linalg.lstsq(matrix / scale, target, rcond=1e-9)[0][0] / scale[0]
    return float(np.clip(best, *DENSITY))
