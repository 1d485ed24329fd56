"""Regression of a loaded run on the payload and on the uncertain parameters of the fit.

For each joint, with M the filtered base columns along the loaded run (load friction at the load
with the payload) and β̂ the fit's values,

    torque − M·β̂ = M·B·π + J·δ + F·φ + noise,   δ ~ N(0, C),

where π are the ten parameters of the payload, B maps them to base parameters (a body at the tool
adds to the last link), J are the derivatives with respect to values and shapes, C is the fit's
covariance, and φ are changes of free parameters (refitted friction, drift). With δ = L·z and
C = L·Lᵀ, the fit's uncertainty is an additional set of rows z = 0 with unit weight. The estimate
is therefore that of a joint identification from both runs, as in Khalil, Gautier, Lemoine,
"Identification of the payload inertial parameters of industrial manipulators", ICRA 2007, but it
does not need the data of the first run.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lieid_casadi.arrays import Array, Indices, Mask
from lieid_casadi.identification import Fit
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.identification.regression.least_squares import (
    Factor,
    JointRows,
    Rows,
    combine,
    joint_factors,
    row_weights,
    solve,
)
from lieid_casadi.identification.regression.variable_projection import shape_columns
from lieid_casadi.identification.uncertainty.covariance import EXACT, hac_covariance, scaled_axes
from lieid_casadi.robot.inertia import parameter_transport

BODY = 10
MOST_ITERATIONS = 30
CONVERGED = 1e-8  # change of the payload's torque relative to the residual
STEP = 1e-3  # kg, kg·m, kg·m²: finite difference for the derivative of load friction


@dataclass(frozen=True, eq=False)
class LoadedRunEstimate:
    """Least-squares estimate from a loaded run."""

    parameters: Array  # (10,) Payload in the tool frame (kg, kg·m, kg·m²)
    covariance: Array  # (10, 10)
    #: (h, 10) Directions of the payload's parameters that cannot be identified from the run
    hidden: Array
    free: Array  # (f,) Changes of the fit's free parameters
    free_std: Array  # (f,) their standard deviations
    before: tuple[Array, ...]  # measured − predicted torque of the fit alone per joint, N·m
    #: the same with the payload and the refitted parameters, others of the fit unchanged
    after: tuple[Array, ...]
    #: (n,) Standard deviation of the residual per joint, N·m, after the fit's parameters have been
    #: adjusted within their uncertainty
    noise: Array
    converged: bool


class LoadedRun:
    """Equations of a loaded run for a fit that was made without the payload."""

    def __init__(self, fit: Fit, design: Design) -> None:
        self.fit, self.design = fit, design
        base, n = fit.model.base, fit.model.n
        self.transport = parameter_transport(fit.model.robot.tool)
        self.to_base = base.combination[:, BODY * (n - 1) : BODY * n] @ self.transport
        self.names = [p.name.split(".")[0] for p in fit.model.base_columns]
        effects = [p.effect for p in fit.model.placements for _ in p.effect.coefficients]
        drifting = [*[False] * (BODY * n), *(effect.per_recording for effect in effects)]
        self.drifting = np.array(drifting)[list(base.kept)]
        self.values = np.where(self.drifting, 0.0, fit.values)
        self.root = _root(fit.covariance)
        first = design.segments[0]
        step = float(np.median(np.diff(first.filtered_time)))
        # rows closer than half a period of the cut-off are not independent
        self.information = min(1.0, 2.0 * first.cutoff * step)

    def loaded_parameters(self, body: Array) -> Array:
        """Return link parameters and coefficients (10 n + m,) with a body at the tool."""
        parameters = self.fit.parameters.copy()
        last = BODY * self.fit.model.n
        parameters[last - BODY : last] += self.transport @ body
        return parameters

    def estimate(self, free: Mask) -> LoadedRunEstimate:
        """Estimate the payload; ``free`` marks base columns (p,) whose values are unconstrained."""
        free = free | self.drifting
        noise, body = self.fit.noise, np.zeros(BODY)
        converged, before = False, self._residuals(self._rows(body), body)
        for _ in range(MOST_ITERATIONS):
            rows, errors = self._equations(body, free)
            factor = self._with_prior(combine(joint_factors(rows), self._weights(noise)))
            solution = solve(factor)
            fresh = solution.values[:BODY]
            noise = self._noise(rows, solution.values, noise)
            moved = [j.matrix[:, :BODY] @ (fresh - body) for j in rows.joints]
            size = np.sqrt(sum(float(e @ e) for e in errors))
            change = np.sqrt(sum(float(x @ x) for x in moved))
            body = fresh
            if change <= CONVERGED * size:
                converged = True
                break
        unit = solution.unit_covariance
        each = row_weights(rows, self._weights(noise))
        covariance = hac_covariance(rows, each, rows.residuals(solution.values), unit)
        known = slice(BODY, BODY + self.root.shape[1])
        covariance = covariance + unit[:, known] @ unit[known, :]
        chosen = solution.values[BODY + self.root.shape[1] :]
        after = self._residuals(self._rows(body), body, np.flatnonzero(free), chosen)
        return LoadedRunEstimate(
            body,
            covariance[:BODY, :BODY],
            np.array([h[:BODY] for h in solution.unexcited]).reshape(-1, BODY),
            chosen,
            np.sqrt(np.diag(covariance)[BODY + self.root.shape[1] :]),
            tuple(before),
            tuple(after),
            noise,
            converged,
        )

    def _rows(self, body: Array) -> Rows:
        return self.design.rows(self.fit.shapes, self.loaded_parameters(body))

    def _residuals(
        self, rows: Rows, body: Array, free: Indices | None = None, change: Array | None = None
    ) -> list[Array]:
        values = self.values + self.to_base @ body
        if free is not None and change is not None:
            values[free] += change
        return rows.residuals(values)

    def _equations(self, body: Array, free: Mask) -> tuple[Rows, list[Array]]:
        """Return rows in [π; z; φ], linearized at a payload, and the residuals there."""
        rows, values = self._rows(body), self.values + self.to_base @ body
        errors = rows.residuals(values)
        parameters = self.loaded_parameters(body)
        by_load = self._load_slopes(rows, body, values)
        by_shape: list[Array] = [np.zeros((len(j.torque), 0)) for j in rows.joints]
        if len(self.fit.shapes):
            by_shape = shape_columns(self.design, values, self.fit.shapes, parameters)
        joints, count = [], BODY + self.root.shape[1] + int(free.sum())
        p = len(self.values)
        for joint, error, slope, shape in zip(rows.joints, errors, by_load, by_shape, strict=True):
            wide = np.zeros((len(error), p))
            wide[:, joint.columns] = joint.matrix
            payload = wide @ self.to_base + slope
            matrix = np.column_stack(
                [payload, wide @ self.root[:p] + shape @ self.root[p:], wide[:, free]]
            )
            target = error + payload @ body
            joints.append(JointRows(np.arange(count), matrix, target, joint.instant))
        return Rows(joints, count, rows.segments), errors

    def _load_slopes(self, rows: Rows, body: Array, values: Array) -> list[Array]:
        """Return the derivative of load friction with respect to the payload per joint (R, 10)."""
        varying, shapes = self.design.varying, self.fit.shapes
        slopes = [np.zeros((int(length), BODY)) for length in rows.lengths]
        if not len(varying):
            return slopes
        here = self.design.varying_rows(shapes, self.loaded_parameters(body))
        for k, unit in enumerate(STEP * np.eye(BODY)):
            there = self.design.varying_rows(shapes, self.loaded_parameters(body + unit))
            for slope, one, other in zip(slopes, here, there, strict=True):
                slope[:, k] = (other - one) @ values[varying] / STEP
        return slopes

    def _weights(self, noise: Array) -> Array:
        return np.asarray(np.sqrt(self.information) / noise)

    def _with_prior(self, factor: Factor) -> Factor:
        """Add the rows z = 0 of the fit's uncertainty."""
        known = self.root.shape[1]
        prior = np.zeros((known, factor.r.shape[1]))
        prior[:, BODY : BODY + known] = np.eye(known)
        return combine([factor, Factor(prior, known)], [1.0, 1.0])

    def _noise(self, rows: Rows, solved: Array, before: Array) -> Array:
        """Return each joint's residual standard deviation (n,)."""
        noise = before.copy()
        taken = 1.0 + BODY / max(rows.lengths.sum(), 1)
        for j, error in enumerate(rows.residuals(solved)):
            if len(error):
                noise[j] = max(float(np.sqrt(np.mean(error**2))) * taken, 1e-12)
        return noise


def _root(covariance: Array) -> Array:
    """Return L (p, k) with C = L·Lᵀ, without directions that are known exactly."""
    unit, variance, axes = scaled_axes(covariance)
    kept = variance > EXACT * max(float(variance[-1]), EXACT)
    return np.asarray(unit[:, None] * axes[:, kept] * np.sqrt(variance[kept]))
