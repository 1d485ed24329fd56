"""Held-out parts of the training recordings, and whether the gain of columns holds on them.

Part k is predicted with parameters of the other rows. On a part that can judge the columns the
sum of squares must fall; the rule is stated in :class:`HeldOut`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.held_out_parts import Parts
from lieid_casadi.identification.uncertainty.noise_model import Noise

Array = NDArray[np.float64]
#: Part of the information on a direction of the model that the other rows must contain. With less
#: the direction keeps its value of the whole fit when a part is held out.
LEAST_INFORMATION = 0.3


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Held-out errors without and with further columns.

    A part judges the columns if the gain that their coefficients predict there exceeds a number of
    standard deviations of its noise (`HeldOutRows.deviations`), and the error that the
    uncertainty of coefficients from the other parts would cause. The columns hold if the sum of
    squares falls on every part that judges them, and on all parts together.

    Attributes
    ----------
    parts : Parts
    gain : (P,)
        Fall of the whitened sum of squares on each part.
    judged : (P,) bool
        Whether the part can judge the columns.
    before, after : (n,)
        Held-out RMS error of each joint, N·m; NaN without rows.
    """

    parts: Parts
    gain: Array
    judged: NDArray[np.bool_]
    before: Array
    after: Array

    @property
    def holds(self) -> bool:
        """Whether the columns hold on every part that can judge them."""
        return bool(self.gain.sum() > 0.0 and (self.gain[self.judged] > 0.0).all())

    @property
    def is_confirmed(self) -> bool:
        """Whether the columns hold and some part can judge them."""
        return self.holds and bool(self.judged.any())

    @property
    def fall(self) -> Array:
        """Relative fall of the held-out error of each joint (n,); 0 without rows."""
        fall = 1.0 - self.after / np.where(self.before > 0.0, self.before, np.inf)
        return np.nan_to_num(fall, nan=0.0)

    @property
    def reason(self) -> str:
        """Why the columns do not hold; empty if they do."""
        if self.holds:
            return ""
        worse = ", ".join(np.array(self.parts.names)[self.judged & (self.gain <= 0.0)])
        if worse:
            return f"the error of held-out data rises on {worse}"
        return "the error of held-out data does not fall"


def redundancy_of(noise: Noise) -> float:
    """Return the rows per independent sample: long-run variance of a noise over its variance."""
    long_run = (noise.sigma / max(abs(float(noise.filter.sum())), 1e-3)) ** 2
    return max(long_run / noise.spread**2, 1.0)


@dataclass(frozen=True, eq=False)
class HeldOutRows:
    """What held-out errors need of the whitened rows besides columns and a baseline.

    Attributes
    ----------
    parts : tuple of Parts
        The first that can judge the columns are used.
    scale : (R,)
        N·m per unit of each whitened row.
    redundancy : (n,)
        Rows of each joint per independent sample of its noise.
    deviations : float
        Standard deviations that a part needs to judge columns; see `HeldOut`.
    """

    parts: tuple[Parts, ...]
    scale: Array
    redundancy: Array
    deviations: float

    def errors(self, columns: Array, baseline: Baseline, *, blocks: bool = False) -> HeldOut:
        """Return the held-out errors of a baseline without and with further columns.

        Parameters
        ----------
        columns : (…, k)
            On the rows of the joints, whitened as the baseline is.
        baseline : Baseline
        blocks : bool
            Use blocks of time even if there are several recordings.
        """
        results = []
        for parts in self.parts[-1:] if blocks else self.parts:
            results.append(_held_out(columns, baseline, parts, self))
            if results[-1].judged.any():
                break
        return results[-1] if results[-1].judged.any() else results[0]


def _held_out(columns: Array, baseline: Baseline, parts: Parts, rows: HeldOutRows) -> HeldOut:
    rest = baseline.outside(baseline.padded(columns))
    values = _solved(rest, baseline.residual)
    count, n = len(parts.names), len(rows.redundancy)
    least = rows.deviations**2
    gain, judged = np.zeros(count), np.zeros(count, dtype=bool)
    squares = np.zeros((2, n))
    joint = np.repeat(np.arange(n), np.diff(baseline.ends[: n + 1]))
    for k in range(count):
        held = np.pad(parts.held == k, (0, baseline.rows - len(parts.held)))  # rows of a prior
        if not held.any():
            continue
        both = _refitted(np.column_stack([baseline.residual, rest]), baseline, parts, k)
        used = ~parts.out(k, baseline.rows)
        before, own = both[held, 0], both[held, 1:]
        after = before - own @ _solved(both[used, 1:], both[used, 0])
        gain[k] = float(np.sum(before**2) - np.sum(after**2))
        judged[k] = _judges(
            own, both[used, 1:], values, rows.redundancy[joint[held[: len(joint)]]], least
        )
        for i, error in enumerate((before, after)):
            squares[i] += np.bincount(
                joint[held[: len(joint)]],
                weights=(error * rows.scale[held[: len(joint)]]) ** 2,
                minlength=n,
            )
    lengths = np.bincount(joint, minlength=n)
    mean = np.divide(squares, lengths, out=np.full_like(squares, np.nan), where=lengths > 0)
    before_and_after = np.sqrt(mean)
    return HeldOut(parts, gain, judged, before_and_after[0], before_and_after[1])


def _refitted(values: Array, baseline: Baseline, parts: Parts, part: int) -> Array:
    """Return values minus the baseline's columns, fitted to them without a part's rows.

    Parameters
    ----------
    values : (R, k)
        Outside the span of the baseline on all rows.
    baseline : Baseline
    parts : Parts
    part : int
        That is held out.
    """
    axes, added, out = baseline.axes, baseline.added, parts.out(part, baseline.rows)
    outside = np.hstack([added, values])[out]
    # products with values on the other rows are those on these rows with the opposite sign
    along = np.vstack([axes.T @ (baseline.model[out].T @ outside), added[out].T @ outside])
    mixed, fitted = along[:, : added.shape[1]], -along[:, added.shape[1] :]
    count = axes.shape[1]
    inside = np.empty((len(along), len(along)))
    inside[:count, :count] = axes.T @ parts.gram(part, baseline.model) @ axes
    inside[:, count:], inside[count:, :count] = mixed, mixed[:count].T
    sizes, directions = np.linalg.eigh(np.eye(len(inside)) - inside)
    seen = sizes > LEAST_INFORMATION
    solution = directions[:, seen] @ ((directions[:, seen].T @ fitted) / sizes[seen, None])
    own, further = np.split(solution, [count])
    return np.asarray(values - baseline.model @ (axes @ own) - added @ further)


def _solved(columns: Array, values: Array) -> Array:
    """Return the least-squares coefficients (k,) of columns (R, k) for values (R,)."""
    size = np.linalg.norm(columns, axis=0)
    size[size == 0.0] = 1.0
    return np.asarray(np.linalg.lstsq(columns / size, values, rcond=1e-6)[0] / size)


def _judges(own: Array, others: Array, values: Array, redundant: Array, least: float) -> bool:
    """Whether a part can judge columns with the coefficients of all rows.

    Parameters
    ----------
    own : (R_k, k)
        The columns on the part, outside the model's span.
    others : (R', k)
        The same on the rows that are used when the part is held out.
    values : (k,)
        Coefficients.
    redundant : (R_k,)
        Rows of the part per independent sample of their noise.
    least : float
        Square of the standard deviations that the part needs.
    """
    predicted = (own @ values) ** 2
    expected = float(predicted.sum())
    if expected == 0.0:
        return False
    redundancy = float(predicted @ redundant) / expected
    size = np.linalg.norm(others, axis=0)
    if not size.all():
        return False
    covariance = np.linalg.pinv((others / size).T @ (others / size), rcond=1e-10)
    inner = (own / size).T @ (own / size)
    uncertain = float(np.sum(inner * covariance)) * redundancy
    return expected > 4.0 * least * redundancy and expected > least * uncertain
