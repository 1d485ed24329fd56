"""Block means of a recording, on which the checks work: less noise, and no gaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lieid_casadi.recording.arrays import Array
from lieid_casadi.recording.recording import Recording

#: Length of a block, s: short against the motion of an arm, long against sensor noise.
BLOCK_SECONDS = 0.04


@dataclass(frozen=True, eq=False)
class Blocks:
    """Means over B blocks; ``dq`` and ``ddq`` are differences of q, not the measured dq.

    Attributes
    ----------
    q, dq, ddq
        (B, n).
    tau, nominal
        (B, n) or None.
    travelled, integrated
        (B', n) change from one block's first row to the next one's: of q, and of the integral
        of the measured dq (None without dq).
    """

    q: Array
    dq: Array
    ddq: Array
    tau: Array | None
    nominal: Array | None
    travelled: Array
    integrated: Array | None


def block_means(recording: Recording, nominal: Array | None = None) -> Blocks:
    """Return block means of all segments; no block spans a gap.

    Parameters
    ----------
    recording
        N rows, n joints.
    nominal
        (N, n) nominal torque, N·m.
    """
    size = max(1, round(BLOCK_SECONDS * recording.rate))
    edges = _edges(recording, size)
    parts: dict[str, list[Array]] = {name: [] for name in Blocks.__dataclass_fields__}
    for first, last in edges:
        rows = slice(first, last)
        t, q = recording.t[rows], recording.q[rows]
        measured = None if recording.dq is None else recording.dq[rows]
        time = _means(t[:, None], size)[:, 0]
        parts["q"].append(_means(q, size))
        parts["dq"].append(np.gradient(parts["q"][-1], time, axis=0))
        parts["ddq"].append(np.gradient(parts["dq"][-1], time, axis=0))
        parts["travelled"].append(np.diff(q[::size], axis=0))
        if measured is not None:
            steps = 0.5 * (measured[1:] + measured[:-1]) * np.diff(t)[:, None]
            way = np.vstack([np.zeros((1, q.shape[1])), np.cumsum(steps, axis=0)])
            parts["integrated"].append(np.diff(way[::size], axis=0))
        if recording.tau is not None:
            parts["tau"].append(_means(recording.tau[rows], size))
        if nominal is not None:
            parts["nominal"].append(_means(nominal[rows], size))
    empty = np.empty((0, recording.n))
    joined = {name: np.concatenate(rows) if rows else None for name, rows in parts.items()}
    for name in ("q", "dq", "ddq", "travelled"):
        joined[name] = empty if joined[name] is None else joined[name]
    return Blocks(**joined)  # type: ignore[arg-type]


def _edges(recording: Recording, size: int) -> list[tuple[int, int]]:
    """Return first and last row of the segments that hold at least three blocks."""
    lengths = [len(segment) for segment in recording.segments()]
    ends = np.cumsum(lengths)
    return [
        (int(end - length), int(end))
        for length, end in zip(lengths, ends, strict=True)
        if length >= 3 * size
    ]


def _means(x: Array, size: int) -> Array:
    count = x.shape[0] // size
    return np.asarray(x[: count * size].reshape(count, size, x.shape[1]).mean(axis=1))
