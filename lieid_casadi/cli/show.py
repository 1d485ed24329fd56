"""``lieid show ROBOT``: joints, screws, limits, base parameters with their groupings."""

from __future__ import annotations

import argparse
from typing import Any

from lieid_casadi.cli import output, shared_options
from lieid_casadi.tables import make_table


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "show",
        help="joints, screws, limits, base parameters",
        description="Show the joints, screws and limits of a robot, and its base parameters.",
    )
    shared_options.add_robot(parser)
    shared_options.add_effects(parser, default="")
    shared_options.add_outputs(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> None:
    """Print the tables."""
    model = shared_options.model_of(args)
    robot = model.robot
    joints = [
        {
            "name": joint.name,
            "kind": "revolute" if joint.revolute else "prismatic",
            "screw": [float(x) + 0.0 for x in joint.screw],
            "limits": {
                "position": [joint.limits.position_lower, joint.limits.position_upper],
                "velocity": joint.limits.velocity,
                "acceleration": joint.limits.acceleration,
                "torque": joint.limits.torque,
            },
            "inertia": joint.link is not None,
        }
        for joint in robot.joints
    ]
    base = model.base
    _print(robot.name, joints)
    parameters = [
        {"name": base.names[k], "expression": base.expression(i), "unit": column.unit}
        for i, (k, column) in enumerate(zip(base.kept, model.base_columns, strict=True))
    ]
    output.show(
        make_table(
            f"{base.count} base parameters (of {len(base.names)} parameters, "
            f"{len(base.invisible)} of them without effect on the torque)",
            ["base parameter", "unit"],
            [[p["expression"], p["unit"]] for p in parameters],
        )
    )
    if not robot.has_inertia:
        output.say(f"No inertia stated for: {', '.join(robot.links_without_inertia)}")
    output.show_warnings(robot.warnings)
    content = {
        "robot": robot.name,
        "gravity": robot.gravity.tolist(),
        "joints": joints,
        "base_parameter_count": base.count,
        "base_parameters": parameters,
        "dropped": [base.names[k] for k in base.dropped],
        "warnings": [{"name": type(w).__name__, "message": str(w)} for w in robot.warnings],
    }
    files = output.Files()
    files.add_json(args.json, _null_for_nan(content))
    files.write()


def _print(name: str, joints: list[dict[str, Any]]) -> None:
    rows = []
    for i, joint in enumerate(joints, start=1):
        screw = " ".join(f"{x:.4g}" for x in joint["screw"])
        low, high = joint["limits"]["position"]
        limits = joint["limits"]
        rows.append(
            [
                f"{i} {joint['name']}",
                joint["kind"],
                f"[{screw}]",
                f"{low:.4g} … {high:.4g}",
                limits["velocity"],
                limits["acceleration"],
                limits["torque"],
            ]
        )
    output.show(
        make_table(
            f"{name}: {len(joints)} joints, screws [ω; v] in the base frame at the zero pose",
            ["joint", "kind", "screw", "position", "velocity", "acceleration", "torque"],
            rows,
        )
    )


def _null_for_nan(value: Any) -> Any:
    """Return JSON content with None where a limit is not stated."""
    if isinstance(value, float) and value != value:
        return None
    if isinstance(value, dict):
        return {key: _null_for_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_null_for_nan(item) for item in value]
    return value
