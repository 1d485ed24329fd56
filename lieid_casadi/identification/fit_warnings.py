"""What a fit has to say about its own parameters: aliases, bounds, unseen directions, rest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import (
    AliasWarning,
    BoundWarning,
    FrictionAtRestWarning,
    LieidWarning,
    UnidentifiableWarning,
)
from lieid_casadi.identification.regression.design_matrix import has_dry_friction
from lieid_casadi.identification.regression.fixed_point import State
from lieid_casadi.identification.regression.least_squares import Solution, name_direction
from lieid_casadi.identification.regression.shape_range import ShapeRange
from lieid_casadi.model import Model
from lieid_casadi.recording import Processed

Array = NDArray[np.float64]
WEAK = 0.05  # of a column's norm left beside the others: told, and fitted with care


def aliases(model: Model, remaining: Array) -> list[LieidWarning]:
    """Tell effects that the other columns absorb by structure, or almost by this data."""
    found: list[LieidWarning] = []
    base, first = model.base, 10 * model.n
    for k in base.dropped[base.dropped >= first]:
        users = [base.names[base.kept[i]] for i in np.flatnonzero(base.combination[:, k])]
        inside = f"part of {', '.join(users)}" if users else "without any torque"
        found.append(AliasWarning(f"{base.names[k]} is absorbed: {inside}; no data can tell"))
    for position, k in enumerate(base.kept):
        if k >= first and 0.0 < remaining[position] < WEAK:
            found.append(
                AliasWarning(
                    f"{base.names[k]} is weak: the other columns explain all but "
                    f"{remaining[position]:.1%} of its column on this data"
                )
            )
    return found


def bounds(model: Model, state: State) -> list[LieidWarning]:
    """Tell coefficients beyond the physics' bounds and shapes at the end of their range."""
    found: list[LieidWarning] = []
    for parameter, value in zip(model.base_columns, state.solution.values, strict=True):
        if not parameter.lower <= value <= parameter.upper:
            found.append(
                BoundWarning(
                    f"{parameter.label} = {value:.3g} {parameter.unit} is beyond its bound "
                    f"[{parameter.lower:g}, {parameter.upper:g}]: the model lacks something, or "
                    "the effect is not there"
                )
            )
    if len(state.shapes):
        for k in np.flatnonzero(ShapeRange.of(model.shapes).at_bound(state.shapes)):
            shape = model.shapes[k]
            found.append(
                BoundWarning(
                    f"{shape.label} ran to its bound {state.shapes[k]:.3g} {shape.unit} "
                    f"(range {shape.lower:g} to {shape.upper:g}); its effect is hardly there"
                )
            )
    return found


def hidden(model: Model, solution: Solution) -> list[LieidWarning]:
    """Tell directions that the data does not excite."""
    labels = [p.label for p in model.base_columns]
    return [
        UnidentifiableWarning(
            f"not excited by this data: {name_direction(direction, labels)}; "
            "the smallest value was taken"
        )
        for direction in solution.hidden
    ]


def rest(model: Model, segments: Sequence[Processed]) -> list[LieidWarning]:
    """Tell which joints rested for a part of the recordings."""
    moving = np.concatenate([segment.filtered_moving for segment in segments])
    share = 1.0 - moving.mean(axis=0)
    dry = has_dry_friction(model)
    still = [f"joint {j + 1} {share[j]:.0%}" for j in range(model.n) if dry[j] and share[j] > 0.01]
    if not still:
        return []
    return [
        FrictionAtRestWarning(
            f"at rest friction is undetermined; samples left out of the fit: {', '.join(still)}"
        )
    ]
