"""What a MuJoCo model of a fit approximates and leaves out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lieid_casadi.exporters.mjcf.friction import MujocoFriction
from lieid_casadi.identification.fit import Fit
from lieid_casadi.simulation.play import plays_of

#: Effects that MuJoCo has itself.
EXPRESSED = frozenset(
    [
        "armature",
        "command_delay",
        "coulomb",
        "offset",
        "position_spring",
        "torque_saturation",
        "viscous",
    ]
)


def notes_of(fit: Fit, friction: Sequence[MujocoFriction]) -> list[str]:
    """Return notes on what the model approximates and leaves out, a sentence each."""
    robot, notes = fit.model.robot, []
    names = {p.effect.name for p in fit.model.placements}
    for j, own in enumerate(friction):
        if not own.exact:
            notes.append(
                f"joint {j + 1}: friction approximated by damping {own.damping:.4g} and "
                f"frictionloss {own.frictionloss:.4g}; RMS error {own.error:.3g} N·m, "
                f"{100.0 * own.share:.0f} % of the friction (speeds of 2 to 50 % of the limit, "
                "loads at rest over the position range)"
            )
    if not all(own.exact for own in friction):
        notes.append("lieid_casadi.simulation.mujoco_callback adds the exact torque of the fit")
    dry = {label.split(".")[0] for label in (c.name for c in fit.model.columns)}
    approximated = {
        p.effect.name
        for p in fit.model.placements
        if set(p.effect.signals) & {"dq", "sign"} and p.effect.name in dry
    }
    plays = plays_of(fit)
    rigid = {p.joint for p in fit.model.placements if p.effect.name == "backlash"}
    rigid -= {play.joint for play in plays}
    expressed = EXPRESSED | (set() if rigid else {"backlash"})
    left = sorted(names - expressed - approximated)
    notes.extend(
        f"joint {play.joint + 1}: a play of {play.width:.4g} rad is the joint NAME_play beside "
        "joint NAME, which is the motor's; qpos and qvel contain both"
        for play in plays
    )
    if left:
        notes.append(f"not part of the MuJoCo model: {', '.join(left)}")
    if "command_delay" in names:
        notes.append(
            "command delays are attributes of the actuators, which MuJoCo 4.0 has; if ctrl is held "
            "for an interval between commands, as in the recordings, subtract half of it"
        )
    relative = [drive for drive in robot.drives or () if drive.relative]
    if relative:
        notes.append(
            "the drive stiffness K is unknown: masses, inertias and torques are divided by it, "
            "and kp is 1; motion under commands is the same, forces are not in N"
        )
    if robot.drives is None and any(np.isnan(robot.limit("torque"))):
        notes.append("no torque limits are stated: the range of the motors is not limited")
    return notes
