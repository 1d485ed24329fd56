"""``lieid show ROBOT|FIT``: joints, limits, base parameters; effects and values of a fit."""

from __future__ import annotations

from typing import Any

import lieid_casadi as lieid
from lieid_casadi.cli import inputs, output
from lieid_casadi.cli.options import Args, command
from lieid_casadi.errors import warning_list
from lieid_casadi.json_numbers import number_or_none, numbers_or_none
from lieid_casadi.tables import Table, make_table, std_text, value_text


@command("show", "joints, screws, limits, base parameters, values of a fit")
def run(args: Args) -> output.Outcome:
    """Show the joints, screws and limits of a robot, and its base parameters.

    Of a fit, also its effects and the values of all parameters.

    @ROBOT_OR_FIT @NO_EFFECTS @EFFECTS_FILE
    --symbolic  base parameters with symbols for the lengths between link frames
    @JSON
    """
    from lieid_casadi.dynamics.symbolic_lengths import symbolic_base

    fit = lieid.Fit.load(args.robot) if inputs.is_fit(args) and not args.effects else None
    model = inputs.model_of(args) if fit is None else fit.model
    robot = model.robot
    joints = _joints(robot)
    base, lengths = model.base, list[dict[str, Any]]()
    if args.symbolic:
        base, found = symbolic_base(
            robot, lambda r: lieid.Model.of_placements(r, model.placements).base
        )
        lengths = [
            {"name": x.name, "value": float(f"{x.value:.9g}"), "meaning": x.meaning} for x in found
        ]
    parameters = [
        {"name": base.names[k], "expression": base.expression(i), "unit": column.unit}
        for i, (k, column) in enumerate(zip(base.kept, model.base_columns, strict=True))
    ]
    content = {
        "robot": robot.name,
        "tip": robot.tool_name,
        "gravity": robot.gravity.tolist(),
        "joints": joints,
        "base_parameter_count": base.count,
        "base_parameters": parameters,
        "dropped": [base.names[k] for k in base.dropped],
        "warnings": warning_list(robot.warnings),
    }
    if args.symbolic:
        content["lengths"] = lengths

    shown = [
        _joint_table(robot, joints),
        make_table(
            f"{base.count} base parameters (of {len(base.names)} parameters, "
            f"{len(base.invisible)} of them without effect on the torque)",
            ["base parameter", "unit"],
            [[p["expression"], p["unit"]] for p in parameters],
        ),
        make_table(
            "lengths",
            ["symbol", "value, m", "length"],
            [[x["name"], x["value"], x["meaning"]] for x in lengths],
        ),
    ]
    if fit is not None:
        content["effects"] = fit.model.effects
        content["parameters"] = fit.parameter_table()
        shown.append(_value_table(fit))
    no_inertia = ", ".join(robot.links_without_inertia)
    notes = [] if robot.has_inertia else [f"No inertia stated for: {no_inertia}"]
    return output.Outcome((*shown, *notes, *robot.warnings), json=content)


def _joints(robot: lieid.Robot) -> list[dict[str, Any]]:
    return [
        {
            "name": joint.name,
            "kind": "revolute" if joint.revolute else "prismatic",
            "screw": [float(x) + 0.0 for x in joint.screw],
            "limits": {
                "position": numbers_or_none(
                    [joint.limits.position_lower, joint.limits.position_upper]
                ),
                "velocity": number_or_none(joint.limits.velocity),
                "acceleration": number_or_none(joint.limits.acceleration),
                "torque": number_or_none(joint.limits.torque),
            },
            "inertia": joint.link is not None,
        }
        for joint in robot.joints
    ]


def _joint_table(robot: lieid.Robot, joints: list[dict[str, Any]]) -> Table:
    rows = []
    for i, joint in enumerate(joints, start=1):
        screw = " ".join(f"{round(x, 9) + 0.0:.4g}" for x in joint["screw"])
        limits = joint["limits"]
        rows.append(
            [
                f"{i} {joint['name']}",
                joint["kind"],
                f"[{screw}]",
                _range(*limits["position"]),
                limits["velocity"],
                limits["acceleration"],
                limits["torque"],
            ]
        )
    return make_table(
        f"{robot.name}: {len(joints)} joints, tip {robot.tool_name}, "
        "screws [ω; v] in the base frame at the zero pose",
        ["joint", "kind", "screw", "position", "velocity", "acceleration", "torque"],
        rows,
    )


def _value_table(fit: lieid.Fit) -> Table:
    """Return the identified values, those of effects after those of links."""
    effects = ", ".join(fit.model.effects) or "no effects"
    return make_table(
        f"Values ({fit.method}, {effects})",
        ["parameter", "joint", "value", "std", "unit"],
        [
            (
                r["expression"],
                r["joint"],
                value_text(r["value"], r["std"]),
                std_text(r["std"]),
                r["unit"],
            )
            for r in fit.parameter_table()
        ],
    )


def _range(*ends: float | None) -> str:
    """Return limits of the position as text."""
    texts = ["unlimited" if end is None else f"{end:.4g}" for end in ends]
    return " … ".join(dict.fromkeys(texts) if ends[0] is None else texts)
