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
    ColumnStore,
    evaluate_candidates,
)
from lieid_casadi.diagnosis.screening.candidates import Candidate, list_candidates
from lieid_casadi.diagnosis.screening.cross_validation import time_blocks
from lieid_casadi.diagnosis.screening.effect_columns import SegmentSignals
from lieid_casadi.diagnosis.screening.held_out import HeldOutRows, redundancy_of
from lieid_casadi.diagnosis.screening.held_out_parts import block_parts, recording_parts
from lieid_casadi.diagnosis.screening.model_factor import ModelFactor
from lieid_casadi.diagnosis.screening.smooth_functions import SmoothFunction, smooth_candidates
from lieid_casadi.effects import Effect
from lieid_casadi.identification import Fit
from lieid_casadi.identification.regression.design_matrix import Design, FilteredColumns, Rows
from lieid_casadi.identification.regression.shape_fit import shape_columns
from lieid_casadi.identification.uncertainty.noise_model import (
    RATE_OVER_CUTOFF,
    Noise,
    Runs,
    friction_torque_std,
    runs_of,
    spread_of,
)
from lieid_casadi.recording import Processed

Array = NDArray[np.float64]
#: Longest gap between held-out data and the rest, relative to the length of a block.
LARGEST_GAP = 0.25
FACTORS = 3  # factorisations that are kept, each of one noise


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
    store : ColumnStore
        Of the candidates' columns.
    scanned : int
        Grid points tried by scans that are not among the candidates.
    options : DiagnosisOptions
    apart : tuple of (N_j, a)
        Of each joint: columns of what differs between the recordings; the last of
        ``model_columns``. Empty if there are none.
    """

    fit: Fit
    segments: tuple[Processed, ...]
    runs: tuple[Runs, ...]
    model_columns: tuple[Array, ...]
    torque: tuple[Array, ...]
    residual: tuple[Array, ...]
    signals: tuple[SegmentSignals, ...]
    candidates: CandidateColumns[Candidate]
    store: ColumnStore
    scanned: int
    options: DiagnosisOptions
    apart: tuple[Array, ...] = ()

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
        known: Sequence[FilteredColumns] | None = None,
    ) -> ScreeningContext:
        """Evaluate the columns of the model and of all candidates.

        Parameters
        ----------
        fit : Fit
        segments : sequence of Processed
        options : DiagnosisOptions
        previous : ScreeningContext, optional
            Of another fit on the same segments. Its rows are kept, so that the two can be
            compared, its columns where they do not depend on the fit, and those set apart.
        model_fixed : bool
            Whether the model is not fitted again, so that changes of its own effects are
            candidates too.
        with_candidates : bool
            False leaves the candidates out.
        known : sequence of FilteredColumns, optional
            Of each segment, see `Design`; those of ``previous`` if it is given.
        """
        store = ColumnStore(motion=known) if previous is None else previous.store.for_another_fit()
        rows, matrices = _model_rows(fit, segments, store.motion)
        runs = _runs(fit, rows, segments) if previous is None else previous.runs
        torque = [joint.torque for joint in rows.joints]
        model_columns, torques, residuals = (
            _on_runs(rows, runs, values)
            for values in (matrices, torque, rows.residuals(fit.values))
        )
        signals = [SegmentSignals.of(fit, s, model_fixed=model_fixed) for s in segments]
        scanned = 0

        def scan(effect: Effect, joint: int) -> Array:
            nonlocal scanned
            found = store.scan(effect, joint, signals, runs, options)
            scanned += len(found.grid)
            return found.peaks(residuals[joint], options)

        wanted: tuple[Candidate, ...] = ()
        if with_candidates:
            wanted = list_candidates(
                fit.model, segments, scan, options=options, model_fixed=model_fixed
            )
        found = cls(
            fit,
            tuple(segments),
            runs,
            model_columns,
            torques,
            residuals,
            tuple(signals),
            evaluate_candidates(wanted, signals, runs, store),
            store,
            scanned,
            options,
        )
        return found.with_apart(previous.apart) if previous and previous.apart else found

    def with_apart(self, columns: Sequence[Array]) -> ScreeningContext:
        """Return the context with further columns (N_j, a) of each joint beside the model's."""
        model_columns = _side_by_side(self.model_columns, columns)
        apart = _side_by_side(self.apart, columns) if self.apart else tuple(columns)
        return replace(self, model_columns=model_columns, apart=apart)

    def with_grids(self, grids: Mapping[int, Array]) -> ScreeningContext:
        """Return the context with other grids (G, s) of some candidates, given by index."""
        wanted = [
            replace(c, grid=grids[k]) if k in grids else c
            for k, c in enumerate(self.candidates.owners)
        ]
        columns = evaluate_candidates(wanted, self.signals, self.runs, self.store)
        return replace(self, candidates=columns)

    @cached_property
    def smooth(self) -> CandidateColumns[SmoothFunction]:
        """Columns of smooth functions of all signals."""
        return smooth_candidates(self.signals, self.runs, known=self.store.smooth)

    @cached_property
    def white_noise(self) -> tuple[Noise, ...]:
        """White noise with the standard deviation of each joint's residual."""
        return tuple(
            Noise.white(spread_of(residual, runs.friction_std))
            for residual, runs in zip(self.residual, self.runs, strict=True)
        )

    def factor(self, noise: Sequence[Noise]) -> ModelFactor:
        """Return the factorisation of the model's whitened columns; the last ones are kept.

        Parameters
        ----------
        noise : sequence of Noise
            One per joint.
        """
        key = tuple(noise)
        if key not in self._factors:
            while len(self._factors) >= FACTORS:
                del self._factors[next(iter(self._factors))]
            matrices, torque = (self.whitened(noise, v) for v in (self.model_columns, self.torque))
            self._factors[key] = ModelFactor.of(matrices, torque)
        return self._factors[key]

    @cached_property
    def _factors(self) -> dict[tuple[Noise, ...], ModelFactor]:
        return {}

    def baseline(self, noise: Sequence[Noise]) -> Baseline:
        """Return the baseline of the model, whitened."""
        return self.factor(noise).baseline()

    def whitened(self, noise: Sequence[Noise], values: Sequence[Array]) -> list[Array]:
        """Return values (N_j, …) of each joint whitened by the noise of each joint."""
        return [n.whiten(v, r) for n, v, r in zip(noise, values, self.runs, strict=True)]

    def time_blocks(self, noise: Sequence[Noise], duration: float) -> NDArray[np.intp]:
        """Return the block of time (R,) of each whitened row, for blocks of a duration in s."""
        return time_blocks(self.segments, noise, self.runs, duration)

    def held_out_rows(self, white: Sequence[Noise], coloured: Sequence[Noise]) -> HeldOutRows:
        """Return the held-out parts of the rows: recordings if there are several, and blocks.

        Parameters
        ----------
        white : sequence of Noise
            White noise of each joint, by which the rows are whitened.
        coloured : sequence of Noise
            Autoregressive noise of each joint, whose correlation time is the gap between parts.
        """
        redundancy = np.array([redundancy_of(noise) for noise in coloured])
        gap = float(redundancy.max()) / (RATE_OVER_CUTOFF * self.segments[0].cutoff)
        gap = min(gap, LARGEST_GAP * self.options.held_out_duration)
        blocks = block_parts(self.segments, white, self.runs, gap=gap, options=self.options)
        recordings = recording_parts(self.segments, white, self.runs)
        return HeldOutRows(
            (blocks,) if recordings is None else (recordings, blocks),
            np.concatenate(
                [n.sigma / r.weights(n.spread) for n, r in zip(white, self.runs, strict=True)]
            ),
            redundancy,
            self.options.held_out_deviations,
        )

    def folds(self, noise: Sequence[Noise]) -> NDArray[np.intp]:
        """Return the fold (R,) of each whitened row: blocks of time go to the folds in turn."""
        return self.time_blocks(noise, self.options.fold_duration) % self.options.folds


def _side_by_side(own: Sequence[Array], further: Sequence[Array]) -> tuple[Array, ...]:
    """Return columns (N_j, k) of each joint with further ones."""
    return tuple(np.hstack(both) for both in zip(own, further, strict=True))


def _runs(fit: Fit, rows: Rows, segments: Sequence[Processed]) -> tuple[Runs, ...]:
    doubt = [friction_torque_std(fit.compiled, s, fit.shapes, fit.parameters) for s in segments]
    usable = np.zeros((int(rows.segments[-1]), fit.model.n), dtype=bool)
    for j, joint in enumerate(rows.joints):
        usable[joint.instant, j] = True
    return runs_of(usable, segments, np.concatenate(doubt))


def _model_rows(
    fit: Fit, segments: Sequence[Processed], known: Sequence[FilteredColumns] | None
) -> tuple[Rows, list[Array]]:
    """Return the rows of a fit, and each joint's columns and derivatives by shape parameters."""
    design = Design(fit.compiled, segments, known=known)
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
