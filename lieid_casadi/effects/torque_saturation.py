"""A drive that delivers less than its control law asks for."""

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Columns, Effect, Shape, ShapeSymbols, Signals
from lieid_casadi.effects.registry import register
from lieid_casadi.robot.drive import Drive

KNOWN = 1e-3  # relative standard deviation of a stiffness that the drive's law states


def stiffness_of_law(rate: float, drive: Drive | None) -> tuple[float, float] | None:
    """Return the stiffness of the drive, which the limit of its torque does not change."""
    return None if drive is None else (drive.stiffness, KNOWN * drive.stiffness)


@register
class TorqueSaturation(Effect):
    """Torque stops growing at the error e_s: the law exceeds it by K·(|e| − e_s)·sgn(e), |e| > e_s.

    e = q_cmd − q in rad, K in N·m/rad (the drive's stiffness, which its law states); the limit of
    the torque is K·e_s in N·m. It replaces a higher limit of the law, beyond which e does not act.
    Of position-controlled drives. Confused with `torque_gain`.
    """

    name = "torque_saturation"
    finding = ("The drive of {joints} delivers less than its law states at large errors",)
    change = (
        "The drive of {joints} delivers less at large errors than before",
        "The drive of {joints} delivers more at large errors than before",
    )
    formula = "K·max(|q_cmd − q| − e_s, 0)·sgn(q_cmd − q)"
    coefficients = (
        Coefficient(
            "K", "N·m/rad", lower=0.0, meaning="stiffness of the drive", prior=stiffness_of_law
        ),
    )
    shapes = (
        Shape(
            "e_s", "rad", 0.1, 0.003, 3.0,
            meaning="error at which torque saturates", resolved_by="command_error",
        ),
    )  # fmt: skip
    signals = ("command_error",)
    commanded = True
    revealed_by = "position errors well beyond the limit: fast commands, heavy loads"
    confused_with = {
        "torque_gain": "a gain acts on small errors, too; cover both",
        "command_delay": "both grow with fast commands; load the arm at rest",
    }
    typical = "a supply voltage or a current limit below the one that the law assumes"

    def columns(self, s: Signals, shape: ShapeSymbols) -> Columns:
        beyond = ca.fmax(ca.fabs(s.command_error) - shape["e_s"], 0.0)
        return [beyond * ca.sign(s.command_error)]
