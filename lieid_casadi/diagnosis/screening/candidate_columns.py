"""The bank of candidates: columns of everything that could be missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.screening.effect_columns import (
    EffectFunction,
    SegmentSignals,
    columns_along,
)
from lieid_casadi.effects import ArmEffect
from lieid_casadi.identification.uncertainty.noise_model import Noise, Runs

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
SMALLEST_SUPPORT = 5.0  # rows that make most of a column: fewer are a few odd moments


class Tried(Protocol):
    """Anything that may be added to a model: an effect in one place, or a smooth function."""

    @property
    def joint(self) -> int:
        """The joint (from 0) whose rows it acts on first."""

    @property
    def lower(self) -> tuple[float, ...]:
        """Least values of its coefficients."""

    @property
    def parameters(self) -> int:
        """How many numbers it adds to a model."""


T = TypeVar("T", bound=Tried)


@dataclass(frozen=True, eq=False)
class Part:
    """What acts on one joint's rows: ``matrix`` (R, m) of the bank's ``columns`` (m,)."""

    columns: Indices
    matrix: Array


@dataclass(frozen=True, eq=False)
class Bank(Generic[T]):
    """Columns in groups: one group is one candidate at one point of its shape grid.

    Attributes
    ----------
    candidates : tuple
    candidate, point, start, size : (G,) int
        Of each group: which candidate, which grid point, its first column and how many.
    parts : tuple of Part
        One per joint.
    """

    candidates: tuple[T, ...]
    candidate: Indices
    point: Indices
    start: Indices
    size: Indices
    parts: tuple[Part, ...]

    @cached_property
    def count(self) -> int:
        """Number of columns m."""
        return int(self.size.sum())

    @cached_property
    def support(self) -> Array:
        """How many rows make each group's columns (G,): (Σ c²)² / Σ c⁴."""
        squares, fourth = np.zeros(self.count), np.zeros(self.count)
        for part in self.parts:
            square = part.matrix * part.matrix
            squares[part.columns] += square.sum(axis=0)
            fourth[part.columns] += np.einsum("rc,rc->c", square, square)
        # a column of zeros, as a planar arm has them, says nothing against the others
        each = np.divide(squares**2, fourth, out=np.full_like(squares, np.inf), where=fourth > 0.0)
        least = np.minimum.reduceat(each, self.start) if self.count else np.zeros(0)
        return np.where(np.isfinite(least), least, 0.0)

    @cached_property
    def inner(self) -> Array:
        """Products of each column with the ones after it in its group: by offset (k, m)."""
        width = int(self.size.max(initial=1))
        inner = np.zeros((width, self.count))
        for part in self.parts:
            for offset in range(min(width, part.matrix.shape[1])):
                count = part.matrix.shape[1] - offset
                product = np.einsum("rc,rc->c", part.matrix[:, :count], part.matrix[:, offset:])
                neighbours = part.columns[offset:] - part.columns[:count] == offset
                inner[offset, part.columns[:count][neighbours]] += product[neighbours]
        return inner

    @cached_property
    def lower_bounds(self) -> Array:
        """Least value of each column's coefficient (m,)."""
        return np.array([lower for k in self.candidate for lower in self.candidates[k].lower])

    def columns_of(self, group: int) -> Indices:
        """Return a group's columns."""
        return np.arange(self.start[group], self.start[group] + self.size[group])

    def dense(self, group: int) -> list[Array]:
        """Return a group's columns on every joint's rows: (R_j, k) each."""
        wanted = self.columns_of(group)
        found = []
        for part in self.parts:
            dense = np.zeros((part.matrix.shape[0], len(wanted)))
            at = np.searchsorted(part.columns, wanted)
            here = at < len(part.columns)
            here[here] = part.columns[at[here]] == wanted[here]
            dense[:, here] = part.matrix[:, at[here]]
            found.append(dense)
        return found

    def whitened(self, noise: Sequence[Noise], runs: Sequence[Runs]) -> Bank[T]:
        """Return the bank with every joint's rows whitened."""
        parts = tuple(
            Part(part.columns, each.whiten(part.matrix, run))
            for part, each, run in zip(self.parts, noise, runs, strict=True)
        )
        return replace(self, parts=parts)


Known = dict[str, dict[int, Array]]


def build_bank(
    wanted: Sequence[Candidate],
    signals: Sequence[SegmentSignals],
    runs: Sequence[Runs],
    known: Known | None = None,
) -> Bank[Candidate]:
    """Evaluate and filter all candidates' columns, on each joint's runs, not whitened.

    ``known`` keeps, by `Candidate.key`, columns that no later fit changes; pass it again with the
    same runs.
    """
    known = {} if known is None else known
    candidate: list[int] = []
    point: list[int] = []
    size: list[int] = []
    on_joint: list[list[tuple[int, Array]]] = [[] for _ in runs]
    first = 0
    for members in _by_effect(wanted):
        group = [wanted[k] for k in members]
        effect, grid = group[0].effect, group[0].grid
        fresh = [wanted[k] for k in members if wanted[k].key not in known]
        whole = isinstance(effect, ArmEffect)
        values = _along(fresh, signals, runs) if whole else _evaluated(fresh, signals, runs)
        for k in members:
            columns = known[wanted[k].key] if wanted[k].key in known else values[wanted[k].key]
            if "load" not in effect.signals and not whole:
                known[wanted[k].key] = columns
            for joint, matrix in columns.items():
                on_joint[joint].append((first, matrix))
            total = next(iter(columns.values())).shape[1]
            candidate += [k] * len(grid)
            point += range(len(grid))
            size += [total // len(grid)] * len(grid)
            first += total
    return assemble(wanted, candidate, point, size, on_joint, runs)


def _evaluated(
    group: Sequence[Candidate], signals: Sequence[SegmentSignals], runs: Sequence[Runs]
) -> Known:
    """Return the columns (N_j, G·c) on each joint they act on, of one effect's candidates."""
    if not group:
        return {}
    function, places = EffectFunction(group[0].effect), [c.placement for c in group]
    values = np.concatenate([columns_along(function, s, places, group[0].grid) for s in signals])
    return {
        c.key: {c.joint: values[runs[c.joint].all, k].reshape(runs[c.joint].count, -1)}
        for k, c in enumerate(group)
    }


def _along(
    group: Sequence[Candidate], signals: Sequence[SegmentSignals], runs: Sequence[Runs]
) -> Known:
    """Return the columns of effects on the whole arm or on what is measured."""
    found: Known = {}
    for c in group:
        assert isinstance(c.effect, ArmEffect)
        parts = [
            s.segment.filter(
                np.concatenate(
                    [c.effect.segment_columns(s.arm, c.joint, x) for x in c.grid], axis=2
                )
            )
            for s in signals
        ]
        values = np.concatenate(parts)
        joints = [c.joint] if c.effect.reach == "joint" else range(values.shape[1])
        found[c.key] = {j: values[runs[j].all, j] for j in joints}
    return found


def assemble(
    tried: Sequence[T],
    candidate: Sequence[int],
    point: Sequence[int],
    size: Sequence[int],
    on_joint: Sequence[Sequence[tuple[int, Array]]],
    runs: Sequence[Runs],
) -> Bank[T]:
    """Return a bank of groups; ``on_joint`` holds first column and columns (N, m) by joint."""
    sizes = np.array(size, dtype=np.intp)
    start = np.concatenate([[0], np.cumsum(sizes)]).astype(np.intp)[:-1]
    return Bank(
        tuple(tried),
        np.array(candidate, dtype=np.intp),
        np.array(point, dtype=np.intp),
        start,
        sizes,
        tuple(_joined(p, run.count) for p, run in zip(on_joint, runs, strict=True)),
    )


def _by_effect(wanted: Sequence[Candidate]) -> list[list[int]]:
    groups: dict[str, list[int]] = {}
    for k, candidate in enumerate(wanted):
        key = candidate.effect.label + candidate.grid.tobytes().hex()
        groups.setdefault(key, []).append(k)
    return list(groups.values())


def _joined(pieces: Sequence[tuple[int, Array]], rows: int) -> Part:
    if not pieces:
        return Part(np.zeros(0, dtype=np.intp), np.zeros((rows, 0)))
    columns = [np.arange(first, first + matrix.shape[1]) for first, matrix in pieces]
    return Part(np.concatenate(columns), np.concatenate([m for _, m in pieces], axis=1))
