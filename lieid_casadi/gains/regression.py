"""The stacked equations of drive gains, solved by total least squares.

The equation of joint j is i_j·k_j − M_j·β − M_j·B·π = 0, in which the known mass of the payload is
one column with coefficient 1: M. Gautier, S. Briot, "Global identification of joint drive gains and
dynamic parameters of robots", J. Dynamic Systems, Measurement, and Control 2014. Only the currents
are noisy, each with its own noise level. `null_vector` eliminates the exact columns first (Golub,
Hoffman, Stewart, Linear Algebra and its Applications 1987) and weights the rows of all joints
equally. `most_likely` starts from its result and maximizes the likelihood, which weights the error
of each current with that current's noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from lieid_casadi.arrays import Array
from lieid_casadi.errors import IdentificationError
from lieid_casadi.identification.regression.design_matrix import (
    Design,
    varying_columns,
)
from lieid_casadi.identification.regression.fixed_point import nominal_parameters
from lieid_casadi.identification.regression.least_squares import (
    Factor,
    JointRows,
    Rows,
    combine,
    joint_factors,
    row_weights,
    solve,
)
from lieid_casadi.identification.uncertainty.covariance import hac_covariance
from lieid_casadi.robot.inertia import parameter_transport

RANK = 1e-9  # relative tolerance on singular values of scaled columns
INDEPENDENT = 1e-6  # least part of the known column that the other columns may not explain
MOST_EVALUATIONS = 50  # of the nonlinear least-squares search


@dataclass(frozen=True, eq=False)
class NullVector:
    """The null vector [gains; others; 1] of the stacked rows."""

    gains: Array  # (n,) N·m/A; zero for a zero column, that is for a joint that never moves
    #: (q − 1,) Coefficients of the exact columns without the last column, whose coefficient is 1
    others: Array


def null_vector(factor: Factor, noise: Array) -> NullVector | None:
    """Return the null vector, or None if the other columns explain the last column.

    ``factor``: triangular factor of the weighted rows: n noisy columns, then q exact columns, the
    last of which has coefficient 1; ``noise`` (n,): expected norm of the noise in the weighted rows
    of each noisy column.
    """
    n, r = len(noise), factor.r
    moves = np.linalg.norm(r[:, :n], axis=0) > 0.0
    noisy, exact = r[:, :n][:, moves] / noise[moves], r[:, n:]
    size = np.linalg.norm(exact, axis=0)
    exact = exact / np.where(size > 0.0, size, 1.0)
    if size[-1] == 0.0 or not moves.any() or _own_part(exact) < INDEPENDENT:
        return None
    u, singular, _ = np.linalg.svd(exact, full_matrices=False)
    basis = u[:, singular > RANK * singular[0]]
    _, _, vt = np.linalg.svd(noisy - basis @ (basis.T @ noisy))
    direction = vt[-1]
    coefficients = np.linalg.lstsq(exact, -noisy @ direction, rcond=RANK)[0]
    coefficients = coefficients / np.where(size > 0.0, size, 1.0)
    if coefficients[-1] == 0.0:
        return None
    gains = np.zeros(n)
    gains[moves] = direction / noise[moves] / coefficients[-1]
    return NullVector(gains, coefficients[:-1] / coefficients[-1])


def most_likely(factors: Sequence[Factor], start: NullVector, noise: Array) -> NullVector:
    """Return gains and others that minimize Σ_j ‖i_j − torque_j/k_j‖² / σ_j².

    The unknowns are 1/k_j, so that a gain with a large uncertainty does not disturb the others.

    ``factors``: triangular factors of each joint's rows, with the columns of `null_vector`;
    ``start``: a point near the minimum; ``noise`` (n,): standard deviations σ_j of the currents'
    noise, A.
    """
    n = len(noise)
    moving = [int(j) for j in np.flatnonzero(start.gains)]
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

    first = np.concatenate([1.0 / start.gains[moving], start.others])
    x = least_squares(
        error,
        first,
        slopes,
        x_scale="jac",
        max_nfev=MOST_EVALUATIONS,
        ftol=1e-12,
        xtol=1e-12,
        gtol=1e-12,
    ).x
    gains = np.zeros(n)
    gains[moving] = 1.0 / x[: len(moving)]
    return NullVector(gains, x[len(moving) :])


def _own_part(exact: Array) -> float:
    """Return the norm of the last column's part that the other columns do not explain."""
    others, last = exact[:, :-1], exact[:, -1]
    fitted = others @ np.linalg.lstsq(others, last, rcond=RANK)[0]
    return float(np.linalg.norm(last - fitted))


BODY = 10
MOST_ITERATIONS = 20
CONVERGED = 1e-5  # relative change of the gains


@dataclass(frozen=True, eq=False)
class GainSolution:
    """Gains, base parameters and payload, with their common covariance."""

    gains: Array  # (n,) N·m/A
    values: Array  # (p,) Base parameters, N·m
    body: Array  # (10,) Payload in the tool frame: m, m·c, inertia about the tool frame's origin
    #: (n + p + u, n + p + u) Covariance of gains, base parameters and the u unknown parameters of
    #: the payload
    covariance: Array
    hidden: Array  # (h, n + p + u) Directions that cannot be identified from the data
    residuals: tuple[Array, ...]  # one array per joint, N·m
    currents: tuple[Array, ...]  # one array per joint, filtered, A
    converged: bool


class GainProblem:
    """Stacked equations of an arm's runs without and with a payload.

    ``unloaded``, ``loaded``: design matrices of the same model; their torques are currents in A;
    ``known`` (10,): parameters of the payload in the tool frame, NaN where unknown.
    """

    def __init__(self, unloaded: Design, loaded: Design, known: Array) -> None:
        self.unloaded, self.loaded = unloaded, loaded
        self.model = unloaded.model
        n, base = self.model.n, self.model.base
        self.transport = parameter_transport(self.model.robot.tool)
        to_base = base.combination[:, BODY * (n - 1) : BODY * n] @ self.transport
        self.unknown = np.isnan(known)
        self.known = np.where(self.unknown, 0.0, known)
        self.to_unknown = to_base[:, self.unknown]
        self.by_mass = to_base @ self.known
        self.moving_load = bool(varying_columns(self.model).any())

    @property
    def width(self) -> int:
        """Number of unknowns."""
        return self.model.n + self.model.base.count + int(self.unknown.sum())

    def solve(self) -> GainSolution:
        """Alternate between gains, noise levels and load until the gains converge."""
        parameters, body = None, np.zeros(BODY)
        rows = self._rows(parameters, body)
        noise = _own_noise(rows)
        gains = np.zeros(self.model.n)
        found: NullVector | None = None
        converged = False
        for _ in range(MOST_ITERATIONS):
            if self.moving_load and parameters is not None:
                rows = self._rows(parameters, body)
            factors = [
                Factor(f.r[:, :-1], f.rows) for f in joint_factors(rows)
            ]  # the right-hand side is zero
            if found is None:
                # after division by its noise level, each current has noise 1 in each row
                size = np.sqrt(np.maximum(rows.lengths, 1))
                found = null_vector(combine(factors, 1.0 / noise), size)
            if found is None:
                raise IdentificationError(
                    "the effect of the payload's mass cannot be separated from the unknown "
                    "parameters of arm and payload; expected the same motions with and without "
                    "the payload, slow and fast, or a known centre of mass (--com)"
                )
            found = most_likely(factors, found, noise)
            change = np.abs(found.gains - gains) / np.maximum(np.abs(found.gains), 1e-300)
            gains = found.gains
            residuals = self._residuals(rows, found)
            noise = np.array(
                [
                    _size(e) / abs(k) if len(e) else 1.0
                    for e, k in zip(residuals, gains, strict=True)
                ]
            )
            values = found.others[: self.model.base.count]
            body = self.known.copy()
            body[self.unknown] = found.others[self.model.base.count :]
            parameters = self.model.base.lift(values, nominal_parameters(self.model))
            if change.max() <= CONVERGED:
                converged = True
                break
        assert found is not None
        torque_noise = np.where(gains != 0.0, np.abs(gains), 1.0) * noise
        return self._with_covariance(rows, found, body, torque_noise, converged)

    def _with_covariance(
        self, rows: Rows, found: NullVector, body: Array, noise: Array, converged: bool
    ) -> GainSolution:
        """Evaluate the covariance at the noise-free currents that the solution predicts."""
        residuals = self._residuals(rows, found)
        n = self.model.n
        clean = []
        for j, (joint, e) in enumerate(zip(rows.joints, residuals, strict=True)):
            matrix = joint.matrix[:, :-1].copy()
            if len(e):
                matrix[:, j] -= e / found.gains[j]
            clean.append(JointRows(joint.columns[:-1], matrix, e, joint.instant))
        exact = Rows(clean, self.width, rows.segments)
        weights = row_weights(exact, 1.0 / noise)
        least = solve(combine(joint_factors(exact), 1.0 / noise))
        return GainSolution(
            gains=found.gains,
            values=found.others[: self.model.base.count],
            body=body,
            covariance=hac_covariance(exact, weights, residuals, least.unit_covariance),
            hidden=np.array(least.unexcited).reshape(-1, self.width),
            residuals=tuple(residuals),
            currents=tuple(j.matrix[:, k] for k, j in enumerate(rows.joints[:n])),
            converged=converged,
        )

    def _rows(self, parameters: Array | None, body: Array) -> Rows:
        """Return rows of the homogeneous system in [gains; base parameters; payload; 1]."""
        shapes = self.model.initial_shapes
        loaded = parameters
        if parameters is not None:
            last = BODY * self.model.n
            loaded = parameters.copy()
            loaded[last - BODY : last] += self.transport @ body
        empty = self.unloaded.rows(shapes, parameters)
        full = self.loaded.rows(shapes, loaded)
        first = int(empty.segments[-1])
        joints = []
        for j, (one, other) in enumerate(zip(empty.joints, full.joints, strict=True)):
            joints.append(
                JointRows(
                    np.arange(self.width + 1),
                    np.vstack([self._wide(j, one, False), self._wide(j, other, True)]),
                    np.zeros(len(one.torque) + len(other.torque)),
                    np.concatenate([one.instant, first + other.instant]),
                )
            )
        segments = np.concatenate([empty.segments, first + full.segments[1:]])
        return Rows(joints, self.width + 1, segments)

    def _wide(self, j: int, joint: JointRows, with_payload: bool) -> Array:
        n, p = self.model.n, self.model.base.count
        matrix = np.zeros((len(joint.torque), self.width + 1))
        matrix[:, j] = joint.torque
        matrix[:, n + joint.columns] = -joint.matrix
        if with_payload:
            matrix[:, n + p : -1] = -joint.matrix @ self.to_unknown[joint.columns]
            matrix[:, -1] = -joint.matrix @ self.by_mass[joint.columns]
        return matrix

    def _residuals(self, rows: Rows, found: NullVector) -> list[Array]:
        solution = np.concatenate([found.gains, found.others, [1.0]])
        return [joint.matrix @ solution for joint in rows.joints]


def _own_noise(rows: Rows) -> Array:
    """Return the RMS of each current's part that the other columns do not explain, A."""
    found = []
    for j, joint in enumerate(rows.joints):
        if not len(joint.torque):
            found.append(1.0)
            continue
        others = np.delete(joint.matrix, j, axis=1)
        size = np.linalg.norm(others, axis=0)
        others = others[:, size > 0.0] / size[size > 0.0]
        current = joint.matrix[:, j]
        error = current - others @ np.linalg.lstsq(others, current, rcond=1e-9)[0]
        found.append(_size(error))
    return np.array(found)


def _size(error: Array) -> float:
    return max(float(np.sqrt(np.mean(error**2))), 1e-12)
