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
class Unknowns:
    """A solution [gains; others; 1] of the stacked rows."""

    gains: Array  # (n,) N·m/A; zero for a zero column, that is for a joint that never moves
    #: (q − 1,) Coefficients of the exact columns without the last column, whose coefficient is 1
    others: Array


def least_squares_start(factor: Factor, n: int) -> Unknowns | None:
    """Return the linear least-squares solution, or None if the other columns explain the last one.

    ``factor``: triangular factor of the rows: n noisy columns, then q exact columns, the last of
    which has coefficient 1.
    """
    size = np.linalg.norm(factor.r, axis=0)
    r = factor.r / np.where(size > 0.0, size, 1.0)
    if size[-1] == 0.0 or not size[:n].any() or _own_part(r[:, n:]) < INDEPENDENT:
        return None
    x = np.linalg.lstsq(r[:, :-1], -r[:, -1], rcond=RANK)[0] * size[-1]
    x /= np.where(size[:-1] > 0.0, size[:-1], 1.0)
    return Unknowns(x[:n], x[n:])


def most_likely(factors: Sequence[Factor], start: Unknowns, noise: Array) -> Unknowns:
    """Return gains and others that minimize Σ_j ‖i_j − torque_j/k_j‖² / σ_j².

    The unknowns are 1/k_j, so that a gain with a large uncertainty does not disturb the others.

    ``factors``: triangular factors of each joint's rows, with the columns of `least_squares_start`;
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
    return Unknowns(gains, x[len(moving) :])


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
        size = np.array([_size(j.matrix[:, k]) for k, j in enumerate(rows.joints)])
        found = least_squares_start(combine(_factors(rows), 1.0 / size), self.model.n)
        if found is None:
            raise IdentificationError(
                "the effect of the payload's mass cannot be separated from the unknown parameters "
                "of arm and payload; expected the same motions with and without the payload, slow "
                "and fast, or a known centre of mass (--com)"
            )
        gains, noise, converged = found.gains, self._noise(rows, found), False
        for _ in range(MOST_ITERATIONS):
            if self.moving_load and parameters is not None:
                rows = self._rows(parameters, body)
            found = most_likely(_factors(rows), found, noise)
            change = np.abs(found.gains - gains) / np.maximum(np.abs(found.gains), 1e-300)
            gains, noise = found.gains, self._noise(rows, found)
            values = found.others[: self.model.base.count]
            body = self.known.copy()
            body[self.unknown] = found.others[self.model.base.count :]
            parameters = self.model.base.lift(values, nominal_parameters(self.model))
            if change.max() <= CONVERGED:
                converged = True
                break
        torque_noise = np.where(gains != 0.0, np.abs(gains), 1.0) * noise
        return self._with_covariance(rows, found, body, torque_noise, converged)

    def _with_covariance(
        self, rows: Rows, found: Unknowns, body: Array, noise: Array, converged: bool
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

    def _noise(self, rows: Rows, found: Unknowns) -> Array:
        """Return the noise (n,) of the currents, A."""
        torque = np.array([_size(e) for e in self._residuals(rows, found)])
        return torque / np.where(found.gains != 0.0, np.abs(found.gains), 1.0)

    def _residuals(self, rows: Rows, found: Unknowns) -> list[Array]:
        solution = np.concatenate([found.gains, found.others, [1.0]])
        return [joint.matrix @ solution for joint in rows.joints]


def _factors(rows: Rows) -> list[Factor]:
    """Return the joints' triangular factors without the right-hand side, which is zero."""
    return [Factor(f.r[:, :-1], f.rows) for f in joint_factors(rows)]


def _size(error: Array) -> float:
    return max(float(np.sqrt(np.mean(error**2))), 1e-12) if len(error) else 1.0
