"""A fit on its training data, ready to be asked what it lacks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.residual.unexplained import Smooth, smooth_bank
from lieid_casadi.diagnosis.screening.candidate_columns import Bank, Known, build_bank
from lieid_casadi.diagnosis.screening.candidates import Candidate, candidates
from lieid_casadi.diagnosis.screening.effect_columns import SegmentSignals, scanned_grid
from lieid_casadi.diagnosis.screening.screen import Baseline
from lieid_casadi.effects import Effect
from lieid_casadi.identification import Fit
from lieid_casadi.identification.regression.design_matrix import Design, Rows
from lieid_casadi.identification.regression.friction_uncertainty import friction_torque_std
from lieid_casadi.identification.regression.shape_fit import shape_columns
from lieid_casadi.identification.uncertainty.noise_model import Noise, Runs, runs_of, spread_of
from lieid_casadi.recording import Processed

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Scene:
    """A fit, its rows for tests, and every candidate's columns on them (not whitened).

    Attributes
    ----------
    fit : Fit
    segments : tuple of Processed
        Temperatures relative to the fit's mean.
    runs : tuple of Runs
        Of each joint.
    columns : tuple of (N_j, p)
        The model's own, with those of its shape parameters.
    torque, residual : tuple of (N_j,)
        Measured; and beside the fit's prediction, N·m.
    signals : tuple of SegmentSignals
        One per segment.
    bank : Bank
    known : dict
        Columns that another fit on the same segments has too.
    scanned : int
        Grid points that were tried in scans and are not in the bank.
    """

    fit: Fit
    segments: tuple[Processed, ...]
    runs: tuple[Runs, ...]
    columns: tuple[Array, ...]
    torque: tuple[Array, ...]
    residual: tuple[Array, ...]
    signals: tuple[SegmentSignals, ...]
    bank: Bank[Candidate]
    known: Known
    scanned: int

    @classmethod
    def of(
        cls,
        fit: Fit,
        segments: Sequence[Processed],
        *,
        before: Scene | None = None,
        kept: bool = False,
        tried: bool = True,
    ) -> Scene:
        """Evaluate the model's and all candidates' columns.

        ``before`` is a scene of another fit on the same segments: its rows are kept, so that the
        two can be compared, and its columns where the fit does not change them. ``kept``: the
        model stays as it is, so that a change of an effect that it has is a candidate too. Without
        ``tried`` there are no candidates.
        """
        design = Design(fit.compiled, segments)
        rows = design.rows(fit.shapes, fit.parameters)
        runs = _runs(fit, rows, segments) if before is None else before.runs
        known: Known = {} if before is None else before.known
        matrices = _dense(rows)
        if len(fit.shapes):
            slopes = shape_columns(design, fit.values, fit.shapes, fit.parameters)
            matrices = [np.column_stack([m, s]) for m, s in zip(matrices, slopes, strict=True)]
        on_line = [_on_time_line(rows, j, m) for j, m in enumerate(matrices)]
        torque = [_on_time_line(rows, j, rows.joints[j].torque) for j in range(fit.model.n)]
        residual = [_on_time_line(rows, j, r) for j, r in enumerate(rows.residuals(fit.values))]
        signals = [SegmentSignals.of(fit, s) for s in segments]
        scanned = 0

        def scan(effect: Effect, joint: int) -> Array:
            nonlocal scanned
            at = runs[joint].all
            grid, count = scanned_grid(effect, signals, joint, residual[joint][at], at)
            scanned += count
            return grid

        wanted = candidates(fit.model, segments, scan, present=kept) if tried else ()
        return cls(
            fit,
            tuple(segments),
            runs,
            tuple(m[run.all] for m, run in zip(on_line, runs, strict=True)),
            tuple(t[run.all] for t, run in zip(torque, runs, strict=True)),
            tuple(r[run.all] for r, run in zip(residual, runs, strict=True)),
            tuple(signals),
            build_bank(wanted, signals, runs, known),
            known,
            scanned,
        )

    def zoomed(self, points: Mapping[int, Sequence[int]]) -> Scene:
        """Return the scene with finer grids beside points (candidate → points)."""
        finer = {k: self.bank.candidates[k].zoomed(at).grid for k, at in points.items()}
        return self.with_grids(finer)

    def with_grids(self, grids: Mapping[int, Array]) -> Scene:
        """Return the scene with other grids of some candidates (G, s)."""
        wanted = [
            replace(c, grid=grids[k]) if k in grids else c
            for k, c in enumerate(self.bank.candidates)
        ]
        return replace(self, bank=build_bank(wanted, self.signals, self.runs, self.known))

    @cached_property
    def smooth(self) -> Bank[Smooth]:
        """Smooth functions of every signal, which no effect need be."""
        return smooth_bank(self.signals, self.runs)

    @cached_property
    def plain(self) -> tuple[Noise, ...]:
        """White noise of the size of the fit's residuals."""
        return tuple(
            Noise.white(spread_of(residual, runs.friction_std))
            for residual, runs in zip(self.residual, self.runs, strict=True)
        )

    def baseline(self, noise: Sequence[Noise]) -> Baseline:
        """Return the model's columns and the residual on whitened rows."""
        matrices = [n.whiten(m, r) for n, m, r in zip(noise, self.columns, self.runs, strict=True)]
        torques = [n.whiten(t, r) for n, t, r in zip(noise, self.torque, self.runs, strict=True)]
        return Baseline.of(matrices, torques)


def _runs(fit: Fit, rows: Rows, segments: Sequence[Processed]) -> tuple[Runs, ...]:
    doubt = [friction_torque_std(fit.compiled, s, fit.shapes, fit.parameters) for s in segments]
    usable = np.zeros((int(rows.segments[-1]), fit.model.n), dtype=bool)
    for j, joint in enumerate(rows.joints):
        usable[joint.instant, j] = True
    return runs_of(usable, segments, np.concatenate(doubt))


def _dense(rows: Rows) -> list[Array]:
    """Return each joint's matrix in all p columns."""
    matrices = []
    for joint in rows.joints:
        wide = np.zeros((len(joint.torque), rows.count))
        wide[:, joint.columns] = joint.matrix
        matrices.append(wide)
    return matrices


def _on_time_line(rows: Rows, joint: int, values: Array) -> Array:
    line = np.zeros((int(rows.segments[-1]), *values.shape[1:]))
    line[rows.joints[joint].instant] = values
    return line
