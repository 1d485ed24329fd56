"""Reference bodies of the regularization: nominal link inertias, or uniform spheres."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import IdentificationError, LieidWarning, NominalInertiaWarning
from lieid_casadi.identification.regression.least_squares import Factor
from lieid_casadi.model import Model
from lieid_casadi.robot.inertia import body_inertia, link_parameters, pseudo_inertia
from lieid_casadi.robot.robot import Robot

Array = NDArray[np.float64]
FLAT = 1e-6  # smallest ratio of second moments of a body that is used as it is
CORRECTED_FLATNESS = 1e-3  # smallest ratio of second moments of a corrected body
CORRECTED_GYRATION = 0.01  # m, smallest radius of gyration of a corrected body
SMALLEST_RADIUS = 0.05  # m, of a sphere
DENSITY = (100.0, 5000.0)  # kg/m³, range for spheres


def reference_bodies(model: Model, factor: Factor) -> tuple[Array, tuple[LieidWarning, ...]]:
    """Return the reference pseudo-inertias (n, 4, 4), positive definite, and warnings.

    The reference of a link is its nominal inertia; one that is physically impossible (flat, or
    violating the triangle inequalities) is corrected and a warning returned. Links without
    nominal inertia get a uniform sphere half-way to the next joint, all of the density that fits
    the data best.

    Parameters
    ----------
    model : Model
    factor : Factor
        Of the weighted rows, for the density.

    Raises
    ------
    IdentificationError
        A nominal mass is not positive.
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
                f"robot {model.robot.name!r}: link {name!r} has a mass of {joint.link[0]:g} kg; "
                "expected a positive mass, or none"
            )
        corrected = _corrected(joint.link)
        if corrected is not joint.link:
            found.append(
                NominalInertiaWarning(
                    f"the nominal inertia of link {name!r} is physically impossible; method "
                    "feasible uses a possible one near it as its reference; correct the robot "
                    "description"
                )
            )
        links.append(corrected)
    stated = _with_spheres(model, np.array(links), factor)
    return np.array([pseudo_inertia(link) for link in stated]), tuple(found)


def _corrected(link: Array) -> Array:
    """Return link parameters (10,) with positive second moments; the same array if they are."""
    body = body_inertia(link)
    moments, axes = np.linalg.eigh(0.5 * np.trace(body.inertia) * np.eye(3) - body.inertia)
    if moments[0] > FLAT * max(float(moments[-1]), FLAT * body.mass):
        return link
    least = max(CORRECTED_FLATNESS * float(moments[-1]), body.mass * CORRECTED_GYRATION**2)
    sigma = axes @ np.diag(np.maximum(moments, least)) @ axes.T
    return link_parameters(body.mass, body.com, np.trace(sigma) * np.eye(3) - sigma)


def _with_spheres(model: Model, links: Array, factor: Factor) -> Array:
    missing = np.isnan(links[:, 0])
    if not missing.any():
        return links
    spheres = np.array([_sphere(model.robot, i) for i in range(model.n)])
    stated = np.where(missing[:, None], 0.0, links)
    density = _density(model, factor, stated, np.where(missing[:, None], spheres, 0.0))
    return np.where(missing[:, None], density * spheres, links)


def _sphere(robot: Robot, i: int) -> Array:
    """Return a sphere of unit density between joint i and the next one, or the tool."""
    here = robot.joints[i].home
    following = robot.joints[i + 1].home if i + 1 < robot.n else here @ robot.tool
    centre = 0.5 * (np.linalg.solve(here, following))[:3, 3]
    radius = max(float(np.linalg.norm(centre)), SMALLEST_RADIUS)
    mass = 4.0 / 3.0 * np.pi * radius**3
    return link_parameters(mass, centre, 0.4 * mass * radius**2 * np.eye(3))


def _density(model: Model, factor: Factor, stated: Array, spheres: Array) -> float:
    """Return the density that fits best, with free effect coefficients, kg/m³.

    Parameters
    ----------
    model : Model
    factor : Factor
    stated : (n, 10)
        Nominal links, zero where not stated.
    spheres : (n, 10)
        Of unit density, zero where a link is stated.
    """
    combination, links = model.base.combination, 10 * model.n
    r, z = factor.r[:, :-1], factor.r[:, -1]
    columns = r @ combination
    matrix = np.column_stack([columns[:, :links] @ spheres.ravel(), columns[:, links:]])
    target = z - columns[:, :links] @ stated.ravel()
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale == 0.0] = 1.0
    best = np.linalg.lstsq(matrix / scale, target, rcond=1e-9)[0][0] / scale[0]
    return float(np.clip(best, *DENSITY))
