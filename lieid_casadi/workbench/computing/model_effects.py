"""The effects of a fitted model as rows: formula, values and standard deviations."""

from __future__ import annotations

from collections.abc import Sequence

from lieid_casadi.effects import Placement
from lieid_casadi.effects.registry import make
from lieid_casadi.identification import Fit
from lieid_casadi.workbench.computing.results import EffectRow
from lieid_casadi.workbench.state.proposals import ProposedEffect


def effect_rows(fit: Fit) -> tuple[EffectRow, ...]:
    """Return one row per effect and joint, in the model's order."""
    values: dict[tuple[str, int], list[str]] = {}
    for row in fit.parameter_table():
        name, _, parameter = row["name"].rpartition(".")
        values.setdefault((name, row["joint"] - 1), []).append(_text(parameter, row))
    return tuple(
        EffectRow(
            label=placement.label,
            effect=placement.effect.name,
            joint=None if placement.whole_arm else placement.joint,
            formula=placement.effect.formula,
            values=tuple(values.get((placement.effect.label, placement.joint), ()))
            or (_not_identified(placement),),
        )
        for placement in fit.model.placements
    )


def change_rows(changes: Sequence[ProposedEffect]) -> tuple[EffectRow, ...]:
    """Return one row per change since a fit."""
    return tuple(
        EffectRow(
            label=change.label,
            effect=change.effect,
            joint=change.joints[0] - 1 if change.joints else None,
            formula=make(change.label.partition(":")[0]).formula,
            values=(f"change: {change.value}",),
        )
        for change in changes
    )


def _text(parameter: str, row: dict[str, object]) -> str:
    unit = "" if row["unit"] in ("", "1") else f" {row['unit']}"
    std = "" if row["std"] is None else f" ± {row['std']:.2g}"
    return f"{parameter} = {row['value']:.4g}{std}{unit}"


def _not_identified(placement: Placement) -> str:
    return f"{placement.effect.label} is not identifiable apart from the other parameters"
