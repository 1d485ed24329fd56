"""True inertias of a simulated arm, near those of its description."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.robot import Robot
from lieid_casadi.robot.inertia import body_inertia, link_parameters

Array = NDArray[np.float64]

LEAST_MOMENT = 1e-3  # of the largest principal second moment of mass


def perturbed_inertias(
    robot: Robot, *, spread: float = 0.2, seed: int, payload: Array | None = None
) -> Array:
    """Return physically consistent link parameters (10 n,) near the nominal ones.

    Each mass is scaled by a uniform factor in 1 ± spread, each centre of mass moved by up to
    ``spread`` of its distance and of the body's radius of gyration, and the body stretched
    along its principal axes so that the second moments change by 1 ± spread. A description
    with a physically inconsistent body (flat or negative distribution of mass) is corrected first.

    Parameters
    ----------
    robot : Robot
    spread : float
    seed : int
    payload : (10,), optional
        Body at the tool: link parameters in the tool's frame, added to the last link.
    """
    random = np.random.default_rng(seed)
    links = [_perturbed(link, spread, random) for link in robot.link_parameters.reshape(-1, 10)]
    parameters = np.concatenate(links)
    return parameters if payload is None else with_payload(robot, parameters, payload)


def with_payload(robot: Robot, parameters: Array, payload: Array) -> Array:
    """Return link parameters with a body added at the tool.

    Parameters
    ----------
    robot : Robot
    parameters : (10 n,)
        Without the body.
    payload : (10,)
        Link parameters of the body in the tool's frame.
    """
    body = body_inertia(payload)
    rotation, origin = robot.tool[:3, :3], robot.tool[:3, 3]
    carried = link_parameters(
        body.mass, origin + rotation @ body.com, rotation @ body.inertia @ rotation.T
    )
    loaded = np.array(parameters, dtype=float)
    loaded[-10:] += carried
    return loaded


def _perturbed(link: Array, spread: float, random: np.random.Generator) -> Array:
    mass_factor, stretch = 1.0 + spread * random.uniform(-1, 1), random.uniform(-1, 1, 3)
    shift = spread * random.uniform(-1, 1, 3)
    if link[0] <= 0.0:
        return link.copy()
    body = body_inertia(link)
    # Σ = ∫ r rᵀ dm about the centre of mass: positive definite for every physical body.
    second_moment = 0.5 * np.trace(body.inertia) * np.eye(3) - body.inertia
    moments, axes = np.linalg.eigh(second_moment)
    moments = np.maximum(moments, LEAST_MOMENT * max(float(moments.max()), 1e-9))
    gyration = np.sqrt(moments.sum() / body.mass)
    com = body.com * (1.0 + shift) + 0.5 * shift[::-1] * gyration
    moments = moments * mass_factor * (1.0 + spread * stretch)
    sigma = axes @ np.diag(moments) @ axes.T
    return link_parameters(body.mass * mass_factor, com, np.trace(sigma) * np.eye(3) - sigma)
