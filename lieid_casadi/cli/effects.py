"""``lieid effects [NAME]``: the library of effects."""

from __future__ import annotations

from typing import Any

import lieid_casadi as lieid
from lieid_casadi.cli import output
from lieid_casadi.cli.options import Args, command
from lieid_casadi.tables import Table, make_table


@command("effects", "the library of effects, or one effect of it")
def run(args: Args) -> output.Outcome:
    """List the library of effects, or describe one effect.

    name [NAME]  effect to describe; default: list all effects
    @EFFECTS_FILE @JSON
    """
    from lieid_casadi.effects import make
    from lieid_casadi.effects.description import describe
    from lieid_casadi.effects.registry import REGISTER

    effects = [make(label) for label in (sorted(REGISTER) if args.name is None else [args.name])]
    shown: str | Table
    if args.name is None:
        shown = make_table(
            f"{len(effects)} effects and options (lieid effects NAME describes one)",
            ("effect", "torque on the joint", "coefficients"),
            [
                (e.label, e.formula, ", ".join(f"{c.name} [{c.unit}]" for c in e.coefficients))
                for e in effects
            ],
        )
    else:
        facts = [("effect", args.name), *describe(effects[0])]
        facts.append(("documentation", f"effects/{effects[0].name}.html"))
        width = max(len(name) for name, _ in facts) + 2
        shown = "\n".join(f"{name:<{width}}{text}" for name, text in facts)
    return output.Outcome([shown], json={"effects": [_to_dict(effect) for effect in effects]})


def _to_dict(effect: lieid.Effect) -> dict[str, Any]:
    """Return an effect as JSON content."""
    return {
        "name": effect.label,
        "formula": effect.formula,
        "coefficients": [
            {"name": c.name, "unit": c.unit, "meaning": c.meaning} for c in effect.coefficients
        ],
        "shapes": [
            {"name": s.name, "unit": s.unit, "meaning": s.meaning, "range": [s.lower, s.upper]}
            for s in effect.shapes
        ],
        "signals": list(effect.signals),
        "options": dict(effect.options),
        "revealed_by": effect.revealed_by,
        "confused_with": dict(effect.confused_with),
        "typical": effect.typical,
        "references": list(effect.references),
    }
