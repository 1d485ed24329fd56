"""Columns that act on a joint or vary with shapes and load, and joints with dry friction."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.compiled import Compiled
from lieid_casadi.effects import ArmEffect
from lieid_casadi.model import Model


def varying_columns(model: Model) -> NDArray[np.bool_]:
    """Mark the effect columns (m,) that depend on shape parameters or on the load."""
    return np.array(
        [
            bool(p.effect.shapes) or "load" in p.effect.signals or isinstance(p.effect, ArmEffect)
            for p in model.placements
            for _ in p.effect.coefficients
        ],
        dtype=bool,
    )


def has_dry_friction(model: Model) -> NDArray[np.bool_]:
    """Mark the joints (n,) with an effect whose torque is undetermined at rest."""
    dry = np.zeros(model.n, dtype=bool)
    for placement in model.placements:
        if placement.effect.dry or "sign" in placement.effect.signals:
            dry[placement.joint] = True
    return dry


def active_columns(compiled: Compiled) -> list[NDArray[np.intp]]:
    """Return the base columns (a,) that can act on each joint (n)."""
    model, functions = compiled.model, compiled.functions
    acts = np.zeros((model.n, model.base.count), dtype=bool)
    rigid = functions.base_regressor
    acts[rigid.rows, rigid.columns] = True
    position = {int(k): i for i, k in enumerate(model.base.kept)}
    effects = functions.effect_columns
    for row, column in zip(effects.rows, effects.columns, strict=True):
        kept = position.get(10 * model.n + int(column))
        if kept is not None:
            acts[row, kept] = True
    first = 10 * model.n
    for p in model.placements:
        last = first + len(p.effect.coefficients)
        if isinstance(p.effect, ArmEffect):
            rows = p.joint if p.effect.reach == "joint" else slice(None)
            acts[rows, [position[k] for k in range(first, last) if k in position]] = True
        first = last
    return [np.flatnonzero(row) for row in acts]
