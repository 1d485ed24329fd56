"""What parameters may be before any data: as rows of a regression, in units of the noise.

Short recordings leave sums of link parameters nearly undetermined, and least squares gives them
whatever noise and missing friction fit best: impossible bodies that other motion shows.
"""

from __future__ import annotations

import numpy as np

from lieid_casadi.arrays import Array, Indices
from lieid_casadi.identification.regression.design_matrix import Design, rows_per_independent
from lieid_casadi.identification.regression.least_squares import (
    NO_TORQUE,
    VANISHING,
    Factor,
    combine,
    independent_axes,
    size_of_function,
)
from lieid_casadi.model import Model
from lieid_casadi.robot.description import STANDARD_GRAVITY
from lieid_casadi.robot.inertia import (
    link_parameters,
    parameter_transport,
    pseudo_inertia,
    relative,
)
from lieid_casadi.robot.robot import Robot

#: Standard deviation of a smooth function's coefficients before any data, in `size_of_function`;
#: at least, of the largest torque.
LARGER, LEAST = 2.0, 1e-6
SMALLEST_RADIUS = 0.05  # m, of a sphere
#: Least and largest scale of links' standard deviations, in the moment that gravity turns into the
#: largest torque, and by how many of its own standard deviations it is above the likeliest one.
SCALES, DEVIATIONS = (0.1, 3.0), 2.0


def with_priors(factor: Factor, design: Design) -> Factor:
    """Return a factor of rows in units of the noise, with those of what is known before any data.

    A prior counts as one independent row; filtered rows that depend on each other count as more
    than they are, and the prior by the same factor.
    """
    return with_rows(factor, design, known_before(factor, design, of_effects=True))


def with_rows(factor: Factor, design: Design, known: Array) -> Factor:
    """Return a factor with rows (k, p + 1) that each count as one independent row."""
    counted = np.sqrt(rows_per_independent(design.segments[0])) * known
    return combine([factor, Factor(counted, 0)], np.ones(2))


def known_before(factor: Factor, design: Design, *, of_effects: bool) -> Array:
    """Return rows (k, p + 1) of what parameters may be before any data, in units of that.

    What no row shows is at most the largest torque. ``of_effects`` adds the priors of effects'
    coefficients; those of a function are as large together as what they explain.
    """
    model, rate = design.model, design.segments[0].recording.rate
    laws = model.robot.drives or (None,) * model.n
    taus = [s.tau for s in design.segments if s.tau is not None]
    own = [(p, c) for p in model.placements for c in p.effect.coefficients]
    largest = max(float(np.mean(np.concatenate(taus) ** 2, axis=0).max() ** 0.5), 1e-6)
    size = np.linalg.norm(factor.r, axis=0)
    of_links = np.flatnonzero(model.base.kept < 10 * model.n)
    rows = np.zeros((model.base.count, factor.r.shape[1]))
    independent = factor.r / np.sqrt(rows_per_independent(design.segments[0]))
    links = _of_links(independent, model, of_links, largest)
    rows[np.ix_(of_links, np.append(of_links, -1))] = links
    functions: dict[str, list[int]] = {}
    for k in np.flatnonzero(model.base.kept >= 10 * model.n):
        placement, coefficient = own[model.base.kept[k] - 10 * model.n]
        prior = coefficient.prior if of_effects else None
        if of_effects and placement.effect.orthonormal:
            functions.setdefault(placement.label, []).append(int(k))
            rows[k, k] = 1.0 / largest
        elif prior or size[k] <= NO_TORQUE * size.max():
            known = prior(rate, laws[placement.joint]) if prior else (0.0, largest)
            if known is not None:
                rows[k, k], rows[k, -1] = 1.0 / known[1], known[0] / known[1]
    for together in functions.values():
        spread = LARGER * size_of_function(np.vstack([independent, rows]), np.array(together))
        rows[together, together] = 1.0 / np.clip(spread, LEAST * largest, largest)
    return rows


def _of_links(independent: Array, model: Model, own: Indices, torque: float) -> Array:
    """Return the rows (k, k + 1) of the base parameters of links (k,).

    These are sums of link parameters, which vary as if the pseudo-inertia of the stated body and a
    sphere between the joints were distorted at random; beside that, inertia about each joint's axis
    as its rotor may add, and all of the last link as a tool may. The means are the stated bodies
    times the factor by which these explain most of the ``independent`` rows (p, p + 1): the unit of
    these may be another one. The rows say how far off such statements are.
    """
    robot, mean = model.robot, np.zeros(len(own))
    sums = model.base.combination[own, : 10 * model.n]
    half, rotors = np.empty_like(sums), np.zeros((10 * model.n, model.n))
    stated = robot.link_parameters if robot.has_inertia else np.zeros(10 * model.n)
    spheres = [sphere_between_joints(robot, i) for i in range(model.n)]
    masses = np.array([radius for _, radius in spheres])  # together as the stated ones, if any
    masses *= (abs(float(stated[::10].sum())) or 1.0) / masses.sum()
    for i, (joint, (sphere, _)) in enumerate(zip(robot.joints, spheres, strict=True)):
        link = slice(10 * i, 10 * i + 10)
        sizes, axes = np.linalg.eigh(pseudo_inertia(stated[link] + masses[i] * sphere))
        root = axes * np.sqrt(np.abs(sizes))  # of impossible bodies, too
        half[:, link] = sums[:, link] @ parameter_transport(root)
        inertia = np.outer(joint.axis[:3], joint.axis[:3])[np.tril_indices(3)]
        rotors[link, i] = [float(not joint.revolute), 0.0, 0.0, 0.0, *inertia]
    half /= np.linalg.norm(half, axis=1).max(initial=VANISHING)
    half = np.hstack([half, sums @ rotors, sums[:, -10:]]) * torque / -STANDARD_GRAVITY[2]
    _, triangle = np.linalg.qr(half.T)  # squared: the covariance of base parameters
    if robot.has_inertia:
        mean = sums @ stated
        along = independent[:, own] @ mean
        mean *= float(along @ independent[:, -1]) / max(float(along @ along), VANISHING)
    rows = np.linalg.inv(_scale(independent, own, triangle.T, mean) * triangle.T)
    return np.column_stack([rows, rows @ mean])


def _scale(rows: Array, own: Indices, root: Array, mean: Array) -> float:
    """Return the largest factor of a covariance's root (k, k) that rows (p, p + 1) do not reject.

    As far as the stated bodies are from those that the rows determine, others may be as well. The
    further parameters may have any value (MacKay, Neural Computation 1992).
    """
    beside, _, _ = independent_axes(np.delete(rows[:, :-1], own, axis=1))
    found = np.column_stack([rows[:, own] @ root, rows[:, -1] - rows[:, own] @ mean])
    found -= beside @ (beside.T @ found)
    axes, sizes, _ = np.linalg.svd(found[:, :-1], full_matrices=False)
    scales = np.geomspace(*SCALES, 100)
    variances = 1.0 + np.outer(scales, sizes) ** 2
    # minus twice the logarithm of the likelihood
    unlikely = np.sum(np.log(variances) + (axes.T @ found[:, -1]) ** 2 / variances, axis=1)
    best = int(np.argmin(unlikely))
    return float(np.interp(unlikely[best] + DEVIATIONS**2, unlikely[best:], scales[best:]))


def sphere_between_joints(robot: Robot, i: int) -> tuple[Array, float]:
    """Return a sphere of 1 kg between joint i and what follows (10,), and its radius, m."""
    end = robot.joints[i + 1].home if i + 1 < robot.n else robot.joints[i].home @ robot.tool
    centre = 0.5 * relative(robot.joints[i].home, end)[:3, 3]
    radius = max(float(np.linalg.norm(centre)), SMALLEST_RADIUS)
    return link_parameters(1.0, centre, 0.4 * radius**2 * np.eye(3)), radius
