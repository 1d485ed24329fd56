"""Triangular factors of processed arrays, block by block, without the full regressor."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieid_casadi.compiled import Compiled, array_checks
from lieid_casadi.compiled.triangular_factors import block_triangles
from lieid_casadi.errors import IdentificationError
from lieid_casadi.identification.regression.least_squares import Factor, widened

Array = NDArray[np.float64]


def factors(
    compiled: Compiled,
    q: ArrayLike,
    dq: ArrayLike,
    ddq: ArrayLike,
    tau: ArrayLike,
    *,
    load: ArrayLike | None = None,
    temperature: ArrayLike | None = None,
    time: ArrayLike | None = None,
    shapes: ArrayLike | None = None,
    dead_zone: ArrayLike | None = None,
    size: int = 384,
    threads: int | None = None,
) -> list[Factor]:
    """Return one triangular factor per joint of its equations ``tau = base regressor @ β``.

    Memory is that of a few blocks for any N. Each joint has only the columns that can act on it.
    The factor is that of a Householder QR of all rows, which keeps small singular values accurate
    (a Gram matrix would square the condition number).

    Parameters
    ----------
    compiled : Compiled
    q, dq, ddq, tau : (N, n)
        Processed signals, rad, rad/s, rad/s², N·m; they are not filtered here.
    load, temperature, time, shapes, dead_zone
        As for `Compiled.base_regressor`.
    size : int
        Samples per block; by default a block fits into the second-level cache.
    threads : int, optional
        Number of threads; that of ``compiled`` if left out.

    Returns
    -------
    list of Factor
        For ``combine`` and ``solve`` of
        `lieid_casadi.identification.regression.least_squares`.

    Raises
    ------
    ModelError
        Arrays of the wrong shape or kind.
    IdentificationError
        A sample that is not finite.

    Examples
    --------
    >>> import lieid_casadi as lieid, numpy as np
    >>> from lieid_casadi.identification.regression.least_squares import combine, solve
    >>> model = lieid.Model(lieid.robots.two_link(), effects=["viscous"])
    >>> arm, (q, dq, ddq) = lieid.compile(model), np.random.default_rng(0).normal(size=(3, 500, 2))
    >>> tau = arm.base_regressor(q, dq, ddq) @ np.arange(1.0, 9.0)
    >>> joints = factors(arm, q, dq, ddq, tau)
    >>> solve(combine(joints, np.ones(2))).values.round(9)
    array([1., 2., 3., 4., 5., 6., 7., 8.])
    """
    blocks = compiled.base_blocks(
        q, dq, ddq, load=load, temperature=temperature, time=time, shapes=shapes,
        dead_zone=dead_zone, size=size,
    )  # fmt: skip
    torque = array_checks.samples("tau", tau, compiled.n, blocks.samples)
    small = block_triangles(blocks, torque, compiled.threads if threads is None else threads)
    if not all(np.isfinite(r).all() for r in small):
        _name_bad_sample(np.asarray(q), np.asarray(dq), np.asarray(ddq), torque)
    p = compiled.model.base.count
    return [
        widened(r, columns, p, blocks.samples)
        for r, columns in zip(small, blocks.columns, strict=True)
    ]


def _name_bad_sample(q: Array, dq: Array, ddq: Array, tau: Array) -> None:
    for name, signal in (("q", q), ("dq", dq), ("ddq", ddq), ("tau", tau)):
        bad = np.argwhere(~np.isfinite(signal))
        if len(bad):
            sample, joint = bad[0]
            raise IdentificationError(
                f"{name}: sample {sample}, joint {joint + 1} is {signal[sample, joint]}; "
                "expected a finite number"
            )
    raise IdentificationError("columns of effects are not finite at some sample")
