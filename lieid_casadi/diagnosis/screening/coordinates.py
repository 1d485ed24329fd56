"""Inner products of candidate columns outside the span of a baseline, without forming that part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.baseline import Baseline
from lieid_casadi.diagnosis.screening.candidate_columns import CandidateColumns

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Coordinates of candidate columns along the span of a baseline, by the parts of its basis.

    Attributes
    ----------
    candidates : CandidateColumns
    model : (p, m)
        Along the model's basis.
    in_model : (k, m)
        Inner products of ``model`` within groups, by offset.
    left_out : (s, m)
        Along the directions of that basis that the baseline does not span.
    added : (a, m)
        Along the basis of the columns added.
    """

    candidates: CandidateColumns[Any]
    model: Array
    in_model: Array
    left_out: Array
    added: Array

    @classmethod
    def of(cls, candidates: CandidateColumns[Any], baseline: Baseline) -> Coordinates:
        """Return the coordinates of all columns."""
        model, in_model = candidates.along_model(baseline.model, baseline.ends)
        added = candidates.along(baseline.added, baseline.ends)
        return cls(candidates, model, in_model, baseline.left_out.T @ model, added)

    def gram(self) -> Array:
        """Return inner products (k, m) of the projected columns within groups, by offset."""
        within = self.candidates.inner_along
        return self.candidates.inner - self.in_model + within(self.left_out) - within(self.added)

    def inner_with(self, group: int) -> Array:
        """Return inner products (m, k) of the projected columns with those of a group."""
        inner, own = self.candidates.inner_with(group), self.candidates.columns_of(group)
        for sign, along in ((-1.0, self.model), (1.0, self.left_out), (-1.0, self.added)):
            inner += sign * (along.T @ along[:, own])
        return inner

    def products(self, baseline: Baseline, rows: Array) -> Array:
        """Return inner products (m, B) of the columns with the projections of rows (R, B).

        Parameters
        ----------
        baseline : Baseline
            On whose span the rows are projected.
        rows : (R, B)
        """
        inside = baseline.model.T @ rows
        inside -= baseline.left_out @ (baseline.left_out.T @ inside)
        return self.model.T @ inside + self.added.T @ (baseline.added.T @ rows)
