"""Start of a search from the trajectory of a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import ExcitationError
from lieid_casadi.excitation.basis.trajectory import Parametrization

Array = NDArray[np.float64]


def load_positions(path: str | Path, n: int) -> Array:
    """Return the positions (N, n) of a trajectory file, equidistant in time.

    Parameters
    ----------
    path : str or Path
        CSV with the columns t, q1 … qn, as ``trajectory.csv``; lines with # precede the header.
    n : int
        Number of joints.

    Raises
    ------
    ExcitationError
        Not such a file; names what is missing.
    """
    try:
        lines = Path(path).read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ExcitationError(f"start: {path} cannot be read: {error}") from None
    rows = [line for line in lines if line.strip() and not line.startswith("#")]
    header = rows[0].split(",") if rows else []
    names = ["t", *(f"q{j + 1}" for j in range(n))]
    missing = [name for name in names if name not in header]
    if missing:
        raise ExcitationError(f"start: {path} has no column {missing[0]}; expected t, q1 … q{n}")
    try:
        columns = [header.index(name) for name in names]
        table = np.loadtxt(rows[1:], delimiter=",", usecols=columns, ndmin=2)
    except ValueError as error:
        raise ExcitationError(f"start: {path}: {error}") from None
    t = table[:, 0]
    if len(t) < 3 or not np.isfinite(table).all() or not np.all(np.diff(t) > 0.0):
        raise ExcitationError(
            f"start: {path}: expected 3 rows of finite numbers at least, with increasing times"
        )
    grid = np.linspace(t[0], t[-1], len(t))
    return np.column_stack([np.interp(grid, t, q) for q in table[:, 1:].T])


def warm_start(parametrization: Parametrization, positions: Array) -> Array:
    """Return the free variables (m,) of the trajectory nearest to positions (N, n), equidistant.

    The positions are taken as one period: their time is scaled to the period of the basis.
    """
    t = np.linspace(0.0, parametrization.basis.duration, len(positions))
    functions = parametrization.functions(t)[:, 0]  # (n, N, d)
    moved = positions - parametrization.pose
    return np.concatenate(
        [np.linalg.lstsq(f, q, rcond=None)[0] for f, q in zip(functions, moved.T, strict=True)]
    )
