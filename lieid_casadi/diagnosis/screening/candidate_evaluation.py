"""Evaluation of the columns of candidate effects on the rows of each joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns, assemble_columns
from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.screening.effect_columns import (
    EffectFunction,
    SegmentSignals,
    columns_along,
)
from lieid_casadi.diagnosis.screening.shape_scan import ShapeScan
from lieid_casadi.diagnosis.screening.smooth_functions import SmoothColumns
from lieid_casadi.effects import ArmEffect, Effect
from lieid_casadi.identification.regression.design_matrix import FilteredColumns
from lieid_casadi.identification.uncertainty.noise_model import Runs

Array = NDArray[np.float64]
#: Columns (N_j, c) by joint, of one candidate at one grid point.
PointColumns = dict[int, Array]


@dataclass(frozen=True, eq=False)
class ColumnStore:
    """Columns that were evaluated, by label and grid point, so that none is evaluated twice.

    Attributes
    ----------
    lasting : dict
        Columns that depend on the measured signals alone, shared by all fits on the same runs.
    of_fit : dict
        Columns that depend on the fit.
    smooth : SmoothColumns
        Smooth functions of the measured signals.
    scans : dict
        By an effect's label and joint, of effects that depend on the measured signals alone.
    motion : sequence of FilteredColumns, optional
        Of each segment: columns of models, see `Design`.
    """

    lasting: dict[str, PointColumns] = field(default_factory=dict)
    of_fit: dict[str, PointColumns] = field(default_factory=dict)
    smooth: SmoothColumns = field(default_factory=dict)
    scans: dict[tuple[str, int], ShapeScan] = field(default_factory=dict)
    motion: Sequence[FilteredColumns] | None = None

    def for_another_fit(self) -> ColumnStore:
        """Return the store without the columns that depend on the fit."""
        return ColumnStore(self.lasting, smooth=self.smooth, scans=self.scans, motion=self.motion)

    def of(self, effect: Effect) -> dict[str, PointColumns]:
        """Return the part in which an effect's columns are kept."""
        return self.of_fit if _depends_on_fit(effect) else self.lasting

    def scan(
        self,
        effect: Effect,
        joint: int,
        signals: Sequence[SegmentSignals],
        runs: Sequence[Runs],
        options: DiagnosisOptions,
    ) -> ShapeScan:
        """Return the scan of an effect's one shape parameter on a joint.

        Parameters
        ----------
        effect : Effect
        joint : int
            From 0.
        signals : sequence of SegmentSignals
            One per segment.
        runs : sequence of Runs
            One per joint.
        options : DiagnosisOptions
        """
        key = effect.label, joint
        found = self.scans.get(key)
        if found is None:
            found = ShapeScan.of(effect, signals, joint, runs[joint].all, options)
            if not _depends_on_fit(effect):
                self.scans[key] = found
        return found


def _depends_on_fit(effect: Effect) -> bool:
    return isinstance(effect, ArmEffect) or "load" in effect.signals


def evaluate_candidates(
    wanted: Sequence[Candidate],
    signals: Sequence[SegmentSignals],
    runs: Sequence[Runs],
    store: ColumnStore,
) -> CandidateColumns[Candidate]:
    """Evaluate and filter the columns of all candidates, on the runs of each joint.

    Parameters
    ----------
    wanted : sequence of Candidate
    signals : sequence of SegmentSignals
        One per segment.
    runs : sequence of Runs
        One per joint.
    store : ColumnStore
        Grid points that are in it are not evaluated again; the others are added.

    Returns
    -------
    CandidateColumns
        Not whitened.
    """
    owner: list[int] = []
    point: list[int] = []
    size: list[int] = []
    on_joint: list[list[tuple[int, Array]]] = [[] for _ in runs]
    first = 0
    _evaluate_missing(wanted, signals, runs, store)
    for k, candidate in enumerate(wanted):
        found = store.of(candidate.effect)
        for number, row in enumerate(candidate.grid):
            columns = found[_key(candidate, row)]
            for joint, matrix in columns.items():
                on_joint[joint].append((first, matrix))
            width = len(candidate.effect.coefficients)
            owner.append(k)
            point.append(number)
            size.append(width)
            first += width
    return assemble_columns(wanted, owner, point, size, on_joint, runs)


def _key(candidate: Candidate, row: Array) -> str:
    return f"{candidate.placement.label} {row.tobytes().hex()}"


def _evaluate_missing(
    wanted: Sequence[Candidate],
    signals: Sequence[SegmentSignals],
    runs: Sequence[Runs],
    store: ColumnStore,
) -> None:
    """Evaluate the grid points that are not in the store, those of one effect together."""
    together: dict[str, list[Candidate]] = {}
    for candidate in wanted:
        found = store.of(candidate.effect)
        missing = [row for row in candidate.grid if _key(candidate, row) not in found]
        if missing:
            new = replace(candidate, grid=np.array(missing))
            together.setdefault(f"{new.effect.label} {new.grid.tobytes().hex()}", []).append(new)
    for group in together.values():
        effect, grid = group[0].effect, group[0].grid
        evaluate = _arm_effect_columns if isinstance(effect, ArmEffect) else _joint_effect_columns
        for candidate, columns in zip(group, evaluate(group, signals, runs), strict=True):
            for k, row in enumerate(grid):
                width = len(effect.coefficients)
                store.of(effect)[_key(candidate, row)] = {
                    j: matrix[:, k * width : (k + 1) * width] for j, matrix in columns.items()
                }


def _joint_effect_columns(
    group: Sequence[Candidate], signals: Sequence[SegmentSignals], runs: Sequence[Runs]
) -> list[PointColumns]:
    """Return the columns (N_j, G·c) of the candidates of one effect by joint."""
    function, places = EffectFunction(group[0].effect), [c.placement for c in group]
    values = np.concatenate([columns_along(function, s, places, group[0].grid) for s in signals])
    return [
        {c.joint: values[runs[c.joint].all, k].reshape(runs[c.joint].count, -1)}
        for k, c in enumerate(group)
    ]


def _arm_effect_columns(
    group: Sequence[Candidate], signals: Sequence[SegmentSignals], runs: Sequence[Runs]
) -> list[PointColumns]:
    """Return the columns of effects that are computed along a whole segment."""
    found = []
    for c in group:
        assert isinstance(c.effect, ArmEffect)
        grid = c.grid
        if c.effect.shapes:
            grid = np.hstack([np.zeros((len(grid), len(c.effect.coefficients))), grid])
        own = [c.joint] if c.effect.reach == "joint" else list(range(len(runs)))
        parts = [
            s.segment.filter(
                np.concatenate(
                    [c.effect.segment_columns(s.arm, c.joint, x)[:, own] for x in grid], axis=2
                )
            )
            for s in signals
        ]
        values = np.concatenate(parts)
        found.append({j: values[runs[j].all, k] for k, j in enumerate(own)})
    return found
