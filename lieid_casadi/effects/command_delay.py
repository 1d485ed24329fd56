"""Commands that reach the drive late."""

from lieid_casadi.effects.arm_effect import ArmEffect, Array, SegmentModel, on_joint
from lieid_casadi.effects.effect import Coefficient
from lieid_casadi.effects.registry import register
from lieid_casadi.robot.drive import Drive

LEAST = 1e-3  # s; below it the column is the derivative, not the difference quotient
PARTS = 4  # of a hold, in which a limited law has different torques
BUS, BUS_SPREAD = 0.005, 0.02  # s, what bus and drive add to the hold of a command


def known_delay(rate: float, drive: Drive | None) -> tuple[float, float]:
    """Return mean and standard deviation of a delay, s, of commands that are held at a rate, Hz."""
    return 0.5 / rate + BUS, BUS_SPREAD


def held_for(delay: float, hold: float) -> float:
    """Return the part of a hold, s, that commands with a mean delay can have: twice the delay."""
    return min(hold, 2.0 * delay)


@register
class CommandDelay(ArmEffect):
    """A drive follows an older command: q_cmd(t − δ) in its control law, δ in s.

    The law of the recorded command then exceeds the delivered torque by the difference. Commands
    that are held from row to row are late by half of that interval, which δ contains: before any
    data it is 0.5/rate + 5 ms with a standard deviation of 20 ms. Of position-controlled drives.
    Confused with viscous friction; a delay below one sampling interval is not resolved. Exported C
    computes the torque that the drives deliver.
    """

    name = "command_delay"
    finding = ("The commands of {joints} act late",)
    change = ("The delay of the commands of {joints} has {increased}",)
    formula = "law(q_cmd(t) − q) − law(q_cmd(t − δ) − q)"
    coefficients = (
        Coefficient(
            "delta", "s", lower=0.0, meaning="delay", resolved_by="sample_time", prior=known_delay
        ),
    )
    commanded = True
    reach = "joint"
    needs_past = True
    export_note = "omitted: the torque is that which the drives deliver"
    revealed_by = "commands that change quickly, of one direction and the other"
    confused_with = {
        "viscous": "a delay acts with the velocity of the command; vary accelerations",
        "back_emf": "as viscous",
        "deadband": "a delay vanishes when the command rests",
    }
    typical = "10 to 100 ms of teleoperation: bus, host, interpolation in the servo"

    def segment_columns(self, arm: SegmentModel, joint: int, values: Array) -> Array:
        assert arm.command is not None  # checked before identification
        assert arm.drives is not None
        q, dq, law = arm.motion[0][:, joint], arm.motion[1][:, joint], arm.drives[joint]
        delay = max(float(values[0]), LEAST)
        held = arm.held_command(joint, delay, held_for(delay, arm.hold), parts=PARTS)
        late = law.torque(held - q, dq)
        change = law.torque(arm.command[:, joint] - q, dq) - late.mean(axis=0)
        return on_joint(change / delay, joint, arm.load.shape[1])
