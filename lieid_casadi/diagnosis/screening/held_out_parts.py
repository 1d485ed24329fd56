"""Held-out parts of the training recordings: recordings, or blocks of time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.identification.uncertainty.noise_model import Noise, Runs
from lieid_casadi.recording import Processed
from lieid_casadi.recording.periods import detect_period

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Parts:
    """Held-out parts of the whitened rows.

    Attributes
    ----------
    names : tuple of str
        Of the P parts, as they appear in reasons.
    held : (R,) int
        Part of each row.
    near : (P, R) bool
        Rows of other parts that are not used when a part is held out, because their noise is
        correlated with it.
    recordings : bool
        Whether the parts are recordings, otherwise blocks of one or of all recordings.
    """

    names: tuple[str, ...]
    held: Indices
    near: NDArray[np.bool_]
    recordings: bool

    def out(self, part: int, rows: int) -> NDArray[np.bool_]:
        """Mark the rows (R + prior,) that are not used when a part is held out.

        Parameters
        ----------
        part : int
        rows : int
            Number of rows, with those of a prior, which are always used.
        """
        own = (self.held == part) | self.near[part]
        return np.pad(own, (0, rows - len(own)))

    def gram(self, part: int, basis: Array) -> Array:
        """Return the inner products (p, p) of a basis (R, p) on the rows that `out` marks.

        Those of the last basis are kept: a model is judged with many different columns.
        """
        if not self._grams or self._grams[0][0] is not basis:
            self._grams[:] = [(basis, {})]
        known = self._grams[0][1]
        if part not in known:
            inside = basis[self.out(part, len(basis))]
            known[part] = inside.T @ inside
        return known[part]

    @cached_property
    def _grams(self) -> list[tuple[Array, dict[int, Array]]]:
        return []


def recording_parts(
    segments: Sequence[Processed], noise: Sequence[Noise], runs: Sequence[Runs]
) -> Parts | None:
    """Return the recordings as parts; None if there is only one.

    Parameters
    ----------
    segments : sequence of Processed
    noise, runs : sequence
        Of each joint; they determine which instants have a whitened row.
    """
    keys = [(s.recording.name, s.recording.source_hash) for s in segments]
    order = list(dict.fromkeys(keys))
    if len(order) < 2:
        return None
    line = np.concatenate(
        [
            np.full(len(s.filtered_time), order.index(key), dtype=np.intp)
            for s, key in zip(segments, keys, strict=True)
        ]
    )
    names = tuple(name or f"recording {k + 1}" for k, (name, _) in enumerate(order))
    held = _on_rows(line, noise, runs)
    return Parts(names, held, np.zeros((len(order), len(held)), dtype=bool), True)


def block_parts(
    segments: Sequence[Processed],
    noise: Sequence[Noise],
    runs: Sequence[Runs],
    *,
    gap: float,
    options: DiagnosisOptions,
) -> Parts:
    """Return parts of contiguous blocks of time, which go to the parts in turn.

    Of periodic motion they are blocks of its phase: the same part of every period is in one
    block, so that no motion is on both sides.

    Parameters
    ----------
    segments : sequence of Processed
    noise, runs : sequence
        Of each joint; they determine which instants have a whitened row.
    gap : float
        Rows within this time of a part are not used when it is held out, s.
    options : DiagnosisOptions
    """
    count = options.held_out_parts
    line, times, first = [], [], 0.0
    for segment in segments:
        time = segment.filtered_time - segment.filtered_time[0]
        period = detect_period(segment.recording)
        cycle = float(time[-1]) * (1.0 + 1e-9) if period is None else period
        blocks = count * max(round(cycle / (count * options.held_out_duration)), 1)
        line.append(((time % cycle) / cycle * blocks).astype(np.intp) % count)
        times.append(first + time)
        first = float(times[-1][-1]) + 2.0 * gap + 1.0
    part, instants = np.concatenate(line), np.concatenate(times)
    held = _on_rows(part, noise, runs)
    near = [
        _on_rows((part != k) & (_distance(instants, instants[part == k]) < gap), noise, runs)
        for k in range(count)
    ]
    names = tuple(f"part {k + 1} of {count}" for k in range(count))
    return Parts(names, held, np.array(near), False)


def _distance(times: Array, others: Array) -> Array:
    """Return the distance of each time to the nearest of other sorted times."""
    if not len(others):
        return np.full(len(times), np.inf)
    after = np.searchsorted(others, times).clip(0, len(others) - 1)
    before = (after - 1).clip(0)
    return np.asarray(np.minimum(np.abs(times - others[after]), np.abs(times - others[before])))


def _on_rows(line: NDArray[np.generic], noise: Sequence[Noise], runs: Sequence[Runs]) -> Indices:
    return np.asarray(
        np.concatenate([line[n.instants(r)] for n, r in zip(noise, runs, strict=True)])
    )
