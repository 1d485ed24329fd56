"""The stacked equations of drive gains, and the gains of largest likelihood.

The equation of joint j is i_j·k_j − M_j·β − M_j·B·π = 0, in which the known mass of the payload is
one column with coefficient 1: M. Gautier, S. Briot, "Global identification of joint drive gains and
dynamic parameters of robots", J. Dynamic Systems, Measurement, and Control 2014. Only the currents
are noisy, each with its own noise level: the likelihood weights the error of each current with that
current's noise, which linear least squares, the start of the search, does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from lieid_casadi.arrays import Array
from lieid_casadi.errors import IdentificationError
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.identification.regression.least_squares import (
    Factor,
    JointRows,
    Rows,
    combine,
    row_weights,
    solve,
)
from lieid_casadi.identification.uncertainty.covariance import hac_covariance
from lieid_casadi.robot.inertia import parameter_transport

BODY = 10  # parameters of a payload, the first of which is the mass
RANK = 1e-9  # relative tolerance on singular values of scaled columns
INDEPENDENT = 1e-6  # least part of the known column that the other columns may not explain
MOST_EVALUATIONS = 50  # of the nonlinear least-squares search
MOST_ITERATIONS = 20
CONVERGED = 1e-5  # relative change of the gains


@dataclass(frozen=True, eq=False)
class GainSolution:
    """Gains, with the covariance of all parameters."""

    gains: Array  # (n,) N·m/A; zero for a joint that never moves
    mass: float  # of the payload, kg
    covariance: Array  # (n + p + 9,) square, of gains, base parameters and payload without mass
    hidden: Array  # (h, n + p + 9) Directions that cannot be identified from the data
    residuals: tuple[Array, ...]  # one array per joint, N·m
    currents: tuple[Array, ...]  # one array per joint, filtered, A
    converged: bool


def solve_gains(unloaded: Design, loaded: Design, mass: float) -> GainSolution:
    """Alternate between gains and noise levels of the currents (in place of torques), A."""
    n = unloaded.model.n
    rows = _rows(unloaded, loaded, mass)
    # triangular factors without the right-hand side, which is zero
    factors = [Factor(f.r[:, :-1], f.rows) for f in rows.factors]
    size = np.array([_size(j.matrix[:, k]) for k, j in enumerate(rows.joints)])
    found, converged = _linear_start(combine(factors, 1.0 / size), n), False
    for _ in range(MOST_ITERATIONS):
        gains = np.where(found[:n] != 0.0, np.abs(found[:n]), 1.0)
        noise = np.array([_size(e) for e in _residuals(rows, found)]) / gains
        before, found = found[:n], _most_likely(factors, found, noise)
        change = np.abs(found[:n] - before) / np.maximum(np.abs(found[:n]), 1e-300)
        converged = bool(change.max() <= CONVERGED)
        if converged:
            break
    residuals = _residuals(rows, found)
    # the covariance is that at the noise-free currents that the solution predicts
    exact = Rows(
        [_clean(joint, j, e, found[j]) for j, (joint, e) in enumerate(
            zip(rows.joints, residuals, strict=True)
        )],
        rows.count - 1, rows.segments,
    )  # fmt: skip
    weights = row_weights(exact, 1.0 / np.array([_size(e) for e in residuals]))
    least = solve(combine(exact.factors, [1.0 / _size(e) for e in residuals]))
    return GainSolution(
        gains=found[:n],
        mass=mass,
        covariance=hac_covariance(exact, weights, residuals, least.unit_covariance),
        hidden=np.array(least.unexcited).reshape(-1, exact.count),
        residuals=tuple(residuals),
        currents=tuple(j.matrix[:, k] for k, j in enumerate(rows.joints)),
        converged=converged,
    )


def _rows(unloaded: Design, loaded: Design, mass: float) -> Rows:
    """Return rows of the homogeneous system in [gains; base parameters; payload; 1]."""
    model = unloaded.model
    n, p = model.n, model.base.count
    combination = model.base.combination[:, BODY * (n - 1) : BODY * n]
    to_base = combination @ parameter_transport(model.robot.tool)

    def wide(j: int, joint: JointRows, with_payload: bool) -> Array:
        matrix = np.zeros((len(joint.torque), n + p + BODY))
        matrix[:, j] = joint.torque
        matrix[:, n + joint.columns] = -joint.matrix
        if with_payload:
            own = -joint.matrix @ to_base[joint.columns]
            matrix[:, n + p :] = np.column_stack([own[:, 1:], mass * own[:, 0]])
        return matrix

    empty, full = (d.rows(model.initial_shapes, None) for d in (unloaded, loaded))
    first, joints = int(empty.segments[-1]), []
    for j, (one, other) in enumerate(zip(empty.joints, full.joints, strict=True)):
        matrix = np.vstack([wide(j, one, False), wide(j, other, True)])
        instants = np.concatenate([one.instant, first + other.instant])
        joints.append(JointRows(np.arange(n + p + BODY), matrix, np.zeros(len(matrix)), instants))
    segments = np.concatenate([empty.segments, first + full.segments[1:]])
    return Rows(joints, n + p + BODY, segments)


def _clean(joint: JointRows, j: int, error: Array, gain: float) -> JointRows:
    """Return the rows without the last column, with the current that the solution predicts."""
    matrix = joint.matrix[:, :-1].copy()
    if len(error):
        matrix[:, j] -= error / gain
    return JointRows(joint.columns[:-1], matrix, error, joint.instant)


def _linear_start(factor: Factor, n: int) -> Array:
    """Return the linear solution [gains; others]; the last column has coefficient 1."""
    size = np.linalg.norm(factor.r, axis=0)
    r = factor.r / np.where(size > 0.0, size, 1.0)
    others, last = r[:, n:-1], r[:, -1]
    own_part = last - others @ np.linalg.lstsq(others, last, rcond=RANK)[0]
    if not size[:n].any() or np.linalg.norm(own_part) < INDEPENDENT:
        raise IdentificationError(
            "the effect of the payload's mass cannot be separated from the unknown parameters "
            "of arm and payload; expected the same motions with and without the payload, slow "
            "and fast"
        )
    x = np.linalg.lstsq(r[:, :-1], -last, rcond=RANK)[0] * size[-1]
    return np.asarray(x / np.where(size[:-1] > 0.0, size[:-1], 1.0))


def _most_likely(factors: Sequence[Factor], start: Array, noise: Array) -> Array:
    """Return [gains; others] that minimize Σ_j ‖i_j − torque_j/k_j‖² / σ_j², σ (n,) of currents."""
    n = len(noise)
    moving = np.flatnonzero(start[:n]).tolist()
    current = [factors[j].r[:, j] / noise[j] for j in moving]
    torque = [-factors[j].r[:, n:] / noise[j] for j in moving]

    def error(x: Array) -> Array:
        others = np.append(x[len(moving) :], 1.0)
        return np.concatenate(
            [i - a * (m @ others) for i, a, m in zip(current, x, torque, strict=False)]
        )

    def slopes(x: Array) -> Array:
        others = np.append(x[len(moving) :], 1.0)
        blocks = []
        for k, (a, m) in enumerate(zip(x, torque, strict=False)):
            block = np.zeros((len(m), len(x)))
            block[:, k], block[:, len(moving) :] = -m @ others, -a * m[:, :-1]
            blocks.append(block)
        return np.vstack(blocks)

    first = np.concatenate([1.0 / start[moving], start[n:]])
    x = least_squares(
        error, first, slopes, x_scale="jac", max_nfev=MOST_EVALUATIONS,
        ftol=1e-12, xtol=1e-12, gtol=1e-12,
    ).x  # fmt: skip
    found = np.concatenate([np.zeros(n), x[len(moving) :]])
    found[moving] = 1.0 / x[: len(moving)]
    return found


def _residuals(rows: Rows, found: Array) -> list[Array]:
    return [joint.matrix @ np.append(found, 1.0) for joint in rows.joints]


def _size(error: Array) -> float:
    return max(float(np.sqrt(np.mean(error**2))), 1e-12) if len(error) else 1.0
