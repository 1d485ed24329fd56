"""The motion of an arm under commands that a fit predicts on data which the fit did not see.

Of such an arm the motion counts, and its torque is that of a control law, not measured. Windows of
the training recordings, each within one held-out part, are simulated from measured states with the
coefficients of the effects that follow from the data outside of that part (one step of Newton's
method from the fit; link and shape parameters remain). As elsewhere in a diagnosis, the gain is the
mean of the logarithm of a part's error without an effect over that with it: an effect that acts at
times, such as saturation, is not hidden by the scatter of its gain. The error of a part is that at
all instants of its windows: at their ends alone, some are near zero by chance.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from lieid_casadi.arrays import Array, Indices
from lieid_casadi.diagnosis.folds import Folds, places
from lieid_casadi.diagnosis.rows import Rows
from lieid_casadi.diagnosis.step import MotionGain
from lieid_casadi.identification import Fit
from lieid_casadi.identification.prediction import torque_along
from lieid_casadi.identification.regression.segment_columns import effects_along
from lieid_casadi.simulation.runs import (
    Run,
    require_positive_mass_matrix,
    run_of,
    window_errors,
    with_coefficients,
)

LONGEST_WINDOW = 1.0  # s
MOST_WINDOWS = 60
LEAST_PART = 1e-3  # of a coefficient that is at its bound of zero without some part
RIDGE = 1e-3  # of a coefficient's information: of a joint that moves in one part alone, it remains


@dataclass(frozen=True, eq=False)
class UnseenMotion:
    """Windows of the training recordings: of each run their starts and held-out parts (W,)."""

    rows: Rows
    folds: Folds
    window: float  # s
    windows: tuple[tuple[Run, Indices, Indices], ...]
    errors: dict[Fit, Array] = field(default_factory=dict)  # of the fits that were simulated

    @classmethod
    def of(cls, rows: Rows, folds: Folds) -> UnseenMotion | None:
        """Return the windows that lie within one part each; None without commands or any."""
        fit, segments = rows.fit, rows.segments
        if fit.model.robot.drives is None or any(s.recording.command is None for s in segments):
            return None
        part = places(rows, folds.count)
        edges = rows.times[np.flatnonzero(np.diff(part)) + 1]
        # half a stretch: each has whole windows
        window = min(LONGEST_WINDOW, 0.5 * float(np.median(np.diff(edges))))
        found = []
        for k, segment in enumerate(segments):
            run = run_of(fit, segment, window, "command")
            starts, own = run.starts, part[rows.segment_of == k]
            begin, end = (
                own[np.searchsorted(segment.filtered_time, segment.t[at]).clip(0, len(own) - 1)]
                for at in (starts, starts + run.per_window)
            )
            found.append((run, starts[begin == end], begin[begin == end]))
        total = sum(len(starts) for _, starts, _ in found)
        if not total:
            return None
        every = -(-total // MOST_WINDOWS)
        return cls(rows, folds, window, tuple((r, s[::every], p[::every]) for r, s, p in found))

    def gain(self, before: Fit, after: Fit, joint: int | None = None) -> MotionGain:
        """Compare two fits, of one joint or all; a `LieidError` states why one is not simulated."""
        parts = np.concatenate([part for _, _, part in self.windows])
        return MotionGain.of(self._errors(before), self._errors(after), self.window, parts, joint)

    def _errors(self, fit: Fit) -> Array:
        """Return simulated minus measured positions (W, T, n) in the windows."""
        if fit not in self.errors:
            require_positive_mass_matrix(fit, [run for run, _, _ in self.windows])
            fits, used = self._fits_without(fit), [w for w in self.windows if len(w[1])]
            found = [window_errors([fits[k] for k in part], run, s) for run, s, part in used]
            count = min(errors.shape[1] for errors in found)  # of instants: rates may differ
            at = [np.arange(1, count + 1) * e.shape[1] // count - 1 for e in found]
            self.errors[fit] = np.concatenate([e[:, own] for e, own in zip(found, at, strict=True)])
        return self.errors[fit]

    def _fits_without(self, fit: Fit) -> list[Fit]:
        """Return the fit without each of the held-out parts."""
        rows, parts = self.rows, self.folds.count
        columns, residual = [], []
        for s in rows.segments:
            assert s.tau is not None  # that of the drives' law
            own = effects_along(fit.compiled, s, fit.shapes, fit.parameters)
            columns.append(s.filter(own.reshape(len(s), -1)).reshape(-1, *own.shape[1:]))
            torque = torque_along(fit.compiled, s, fit.parameters, fit.shapes)
            residual.append(s.filter(s.tau - torque))
        line, rest = np.concatenate(columns), np.concatenate(residual)
        errors = [rest[run.all, j] for j, run in enumerate(rows.runs)]
        count, first = line.shape[2], 0
        whole, gram, score = np.zeros((count, count)), np.zeros((parts, count, count)), []
        for j, weight in enumerate(rows.weights(rows.spread(errors))):
            a, r = line[rows.runs[j].all, j] * weight[:, None], errors[j] * weight
            out = self.folds.out[:, first : first + len(r)].astype(float)
            first += len(r)
            whole += a.T @ a
            gram += np.einsum("kr,ra,rb->kab", out, a, a, optimize=True)
            score.append(out @ (a * r[:, None]))
        size = np.sqrt(np.diag(whole)) + 1e-12
        lower, upper = (
            np.array([getattr(c, end) for c in fit.model.columns]) for end in ("lower", "upper")
        )
        values = np.zeros((parts, count))
        for k, (own, slope) in enumerate(zip(gram, np.sum(score, axis=0), strict=True)):
            outside = (whole - own) / np.outer(size, size) + RIDGE * np.eye(count)
            change = np.linalg.solve(outside, slope / size) / size
            values[k] = np.clip(fit.effect_coefficients - change, lower, upper)
        # without any play a joint has one angle less: all these models have the same states
        least = LEAST_PART * np.abs(values).max(axis=0)
        return [with_coefficients(fit, v) for v in np.where(values == 0.0, least, values)]
