"""Precomputed quantities for screening candidates: rows, residuals and candidate columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns
from lieid_casadi.diagnosis.screening.candidate_evaluation import (
    ColumnCache,
    evaluate_candidates,
)
from lieid_casadi.diagnosis.screening.candidates import Candidate, list_candidates
from lieid_casadi.diagnosis.screening.cross_validation import time_blocks
from lieid_casadi.diagnosis.screening.effect_columns import SegmentSignals, scanned_grid
from lieid_casadi.diagnosis.screening.smooth_functions import SmoothFunction, smooth_candidates
from lieid_casadi.effects import Effect
from lieid_casadi.identification import Fit
from lieid_casadi.identification.regression.design_matrix import Design, Rows
from lieid_casadi.identification.regression.friction_uncertainty import friction_torque_std
from lieid_casadi.identification.regression.shape_fit import shape_columns
from lieid_casadi.identification.uncertainty.noise_model import Noise, Runs, runs_of, spread_of
from lieid_casadi.recording import Processed

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ScreeningContext:
    """A fit, its rows along recordings, and the columns of all candidates on these rows.

    Nothing in it is whitened.

    Attributes
    ----------
    fit : Fit
    segments : tuple of Processed
        Temperatures relative to the fit's mean.
    runs : tuple of Runs
        Instants of each joint that are used.
    model_columns : tuple of (N_j, p)
        Of each joint: the model's columns, then the derivatives by its shape parameters.
    torque, residual : tuple of (N_j,)
        Of each joint: measured torque, and its difference from the fit's prediction, N·m.
    signals : tuple of SegmentSignals
        One per segment.
    candidates : CandidateColumns
    cache : dict
        Columns that other fits on the same segments share.
    scanned : int
        Grid points tried by scans that are not among the candidates.
    options : DiagnosisOptions
    """

    fit: Fit
    segments: tuple[Processed, ...]
    runs: tuple[Runs, ...]
    model_columns: tuple[Array, ...]
    torque: tuple[Array, ...]
    residual: tuple[Array, ...]
    signals: tuple[SegmentSignals, ...]
    candidates: CandidateColumns[Candidate]
    cache: ColumnCache
    scanned: int
    options: DiagnosisOptions

    @classmethod
    def of(
        cls,
        fit: Fit,
        segments: Sequence[Processed],
        options: DiagnosisOptions,
        *,
        previous: ScreeningContext | None = None,
        model_fixed: bool = False,
        with_candidates: bool = True,
    ) -> ScreeningContext:
        """Evaluate the columns of the model and of all candidates.

        Parameters
        ----------
        fit : Fit
        segments : sequence of Processed
        options : DiagnosisOptions
        previous : ScreeningContext, optional
            Of another fit on the same segments. Its rows are kept, so that the two can be
            compared, and its columns where they do not depend on the fit.
        model_fixed : bool
            Whether the model is not fitted again, so that changes of its own effects are
            candidates too.
        with_candidates : bool
            False leaves the candidates out.
        """
        rows, matrices = _model_rows(fit, segments)
        runs = _runs(fit, rows, segments) if previous is None else previous.runs
        cache: ColumnCache = {} if previous is None else previous.cache
        torque = [joint.torque for joint in rows.joints]
        model_columns, torques, residuals = (
            _on_runs(rows, runs, values)
            for values in (matrices, torque, rows.residuals(fit.values))
        )
        signals = [SegmentSignals.of(fit, s) for s in segments]
        scanned = 0

        def scan(effect: Effect, joint: int) -> Array:
            nonlocal scanned
            at = runs[joint].all
            grid, count = scanned_grid(effect, signals, joint, residuals[joint], at, options)
            scanned += count
            return grid

        wanted: tuple[Candidate, ...] = ()
        if with_candidates:
            wanted = list_candidates(
                fit.model, segments, scan, options=options, model_fixed=model_fixed
            )
        return cls(
            fit,
            tuple(segments),
            runs,
            model_columns,
            torques,
            residuals,
            tuple(signals),
            evaluate_candidates(wanted, signals, runs, cache),
            cache,
            scanned,
            options,
        )

    def with_grids(self, grids: Mapping[int, Array]) -> ScreeningContext:
        """Return the context with other grids (G, s) of some candidates, given by index."""
        wanted = [
            replace(c, grid=grids[k]) if k in grids else c
            for k, c in enumerate(self.candidates.owners)
        ]
        columns = evaluate_candidates(wanted, self.signals, self.runs, self.cache)
        return replace(self, candidates=columns)

    @cached_property
    def smooth(self) -> CandidateColumns[SmoothFunction]:
        """Columns of smooth functions of all signals."""
        return smooth_candidates(self.signals, self.runs)

    @cached_property
    def white_noise(self) -> tuple[Noise, ...]:
        """White noise with the standard deviation of each joint's residual."""
        return tuple(
            Noise.white(spread_of(residual, runs.friction_std))
            for residual, runs in zip(self.residual, self.runs, strict=True)
        )

    def baseline(
        self, noise: Sequence[Noise], columns: NDArray[np.intp] | slice = slice(None)
    ) -> Baseline:
        """Return the baseline of the model, whitened.

        Parameters
        ----------
        noise : sequence of Noise
            One per joint.
        columns : (k,) int, optional
            The model's columns to use, by default all of them.
        """
        own = [matrix[:, columns] for matrix in self.model_columns]
        return Baseline.of(self.whitened(noise, own), self.whitened(noise, self.torque))

    def whitened(self, noise: Sequence[Noise], values: Sequence[Array]) -> list[Array]:
        """Return values (N_j, …) of each joint whitened by the noise of each joint."""
        return [n.whiten(v, r) for n, v, r in zip(noise, values, self.runs, strict=True)]

    def time_blocks(self, noise: Sequence[Noise], duration: float) -> NDArray[np.intp]:
        """Return the block of time (R,) of each whitened row, for blocks of a duration in s."""
        return time_blocks(self.segments, noise, self.runs, duration)

    def folds(self, noise: Sequence[Noise]) -> NDArray[np.intp]:
        """Return the fold (R,) of each whitened row: blocks of time go to the folds in turn."""
        return self.time_blocks(noise, self.options.fold_duration) % self.options.folds


def _runs(fit: Fit, rows: Rows, segments: Sequence[Processed]) -> tuple[Runs, ...]:
    doubt = [friction_torque_std(fit.compiled, s, fit.shapes, fit.parameters) for s in segments]
    usable = np.zeros((int(rows.segments[-1]), fit.model.n), dtype=bool)
    for j, joint in enumerate(rows.joints):
        usable[joint.instant, j] = True
    return runs_of(usable, segments, np.concatenate(doubt))


def _model_rows(fit: Fit, segments: Sequence[Processed]) -> tuple[Rows, list[Array]]:
    """Return the rows of a fit, and each joint's columns and derivatives by shape parameters."""
    design = Design(fit.compiled, segments)
    rows = design.rows(fit.shapes, fit.parameters)
    matrices = _dense(rows)
    if len(fit.shapes):
        slopes = shape_columns(design, fit.values, fit.shapes, fit.parameters)
        matrices = [np.column_stack([m, s]) for m, s in zip(matrices, slopes, strict=True)]
    return rows, matrices


def _dense(rows: Rows) -> list[Array]:
    """Return the matrix of each joint in all p columns (N_j, p)."""
    matrices = []
    for joint in rows.joints:
        wide = np.zeros((len(joint.torque), rows.count))
        wide[:, joint.columns] = joint.matrix
        matrices.append(wide)
    return matrices


def _on_runs(rows: Rows, runs: Sequence[Runs], values: Sequence[Array]) -> tuple[Array, ...]:
    """Return values (M_j, …) on the rows of each joint at the instants of its runs (N_j, …)."""
    found = []
    for joint, run, own in zip(rows.joints, runs, values, strict=True):
        line = np.zeros((int(rows.segments[-1]), *own.shape[1:]))
        line[joint.instant] = own
        found.append(line[run.all])
    return tuple(found)
