"""Friction with hysteresis at reversals: Dahl and LuGre, integrated exactly."""

import casadi as ca

from lieid_casadi.effects.effect import (
    Coefficient,
    Columns,
    Effect,
    MemoryState,
    Shape,
    ShapeSymbols,
    Signals,
)
from lieid_casadi.effects.registry import register


@register
class Presliding(Effect):
    """Dry friction that builds up over a distance w after each reversal; replaces `coulomb`.

    τ = f_c·z/w, with f_c in N·m, and the state z and the width w in rad. The bristle deflection z
    obeys dz/dq = 1 − s·z/w, s = sgn(dq) (Dahl, 1968), whose solution over a step in one direction
    is

        z ← s·w + (z − s·w)·e^{−|Δq|/w},

    the same for one long step as for many short ones. z is 0 at the start of every segment and is
    held where a sample is not finite (`Effect.next_states`). Confused with Coulomb and Stribeck
    friction where reversals are fast.
    """

    name = "presliding"
    finding = ("Friction on {joints} builds up over a small angle after each reversal",)
    change = ("Friction on {joints} builds up differently after reversals than before",)
    options = {
        "load": "an additional term proportional to |τ_load|",
        "square": "an additional term proportional to τ_load²",
        "lugre": (
            "Canudas de Wit et al. 1995: the width follows the Stribeck curve, "
            "w·(1 + r·e^{−(q̇/v_s)²}) at the mean velocity of a step, and σ1·ż damps the bristle; "
            "beside viscous"
        ),
    }
    states = (MemoryState("z", "rad"),)
    dry = True
    replaces = ("coulomb",)
    revealed_by = "slow reversals, sampled several times within the width w"
    confused_with = {
        "coulomb": "differs only within a few w after a reversal; reverse slowly",
        "stribeck": "both act near reversals; vary the speed of the reversal",
        "joint_elasticity": "both give hysteresis over position; only elasticity scales with load",
    }
    typical = "w of 0.001 to 0.05 rad"
    references = (
        "Dahl, A solid friction model, Aerospace Corp. TOR-158, 1968",
        "Canudas de Wit, Olsson, Åström, Lischinsky, IEEE TAC 40(3), 1995",
        "Madsen et al., Control Engineering Practice 2020",
    )

    def __init__(self, *, option: str = "") -> None:
        super().__init__(option=option)
        self.formula = "f_c·z/w, dz/dq = 1 − sgn(q̇)·z/w"
        self.coefficients = (
            Coefficient("f_c", "N·m", lower=0.0, meaning="dry friction in sliding"),
        )
        width = "width of the hysteresis"
        self.shapes = (Shape("w", "rad", 0.01, 1e-4, 0.5, meaning=width, resolved_by="distance"),)
        self.signals = ("q", "dq", "time")
        self.counted_as = ("coulomb", "load_friction") if option == "load" else ("coulomb",)
        if option in ("load", "square"):
            power = "|τ_load|" if option == "load" else "τ_load²"
            self.formula = f"(f_c + f_τ·{power})·z/w, dz/dq = 1 − sgn(q̇)·z/w"
            name, unit = ("f_tau", "1") if option == "load" else ("f_tau_square", "1/(N·m)")
            self.coefficients += (Coefficient(name, unit, meaning=f"friction per {power}"),)
            self.signals = ("q", "dq", "load", "time")
        elif option == "lugre":
            self.formula = "f_c·z/w + σ1·ż, ż = q̇ − |q̇|·z/(w·(1 + r·e^{−(q̇/v_s)²}))"
            self.coefficients += (
                Coefficient("sigma1", "N·m·s/rad", lower=0.0, meaning="bristle damping"),
            )
            self.shapes += (
                Shape("r", "1", 0.3, 1e-2, 5.0, meaning="relative excess of static friction"),
                Shape(
                    "v_s", "rad/s", 0.1, 1e-3, 2.0,
                    meaning="Stribeck velocity", resolved_by="speed",
                ),
            )  # fmt: skip

    def columns(self, s: Signals, shape: ShapeSymbols) -> Columns:
        built = s.state["z"] / shape["w"]
        if self.option == "load":
            return [built, built * ca.fabs(s.load)]
        if self.option == "square":
            return [built, built * s.load**2]
        if self.option == "lugre":
            return [built, *self.state_rates(s, shape)]
        return [built]

    def advance(self, before: Signals, now: Signals, shape: ShapeSymbols) -> Columns:
        """Return the deflection after a step, which may contain one reversal."""
        moved, width = now.q - before.q, self._width((before.dq + now.dq) / 2, shape)
        first = _until_reversal(before, now)
        return [_slide(_slide(before.state["z"], first, width), moved - first, width)]

    def state_rates(self, s: Signals, shape: ShapeSymbols) -> Columns:
        """Return ż = q̇ − |q̇|·z/w."""
        return [s.dq - ca.fabs(s.dq) * s.state["z"] / self._width(s.dq, shape)]

    def _width(self, dq: ca.SX, shape: ShapeSymbols) -> ca.SX:
        if self.option != "lugre":
            return shape["w"]
        return shape["w"] * (1 + shape["r"] * ca.exp(-((dq / shape["v_s"]) ** 2)))


def _slide(z: ca.SX, moved: ca.SX, width: ca.SX) -> ca.SX:
    """Return the deflection after a motion in one direction."""
    relative = ca.fabs(moved) / width
    return z * ca.exp(-relative) - ca.sign(moved) * width * ca.expm1(-relative)


def _until_reversal(before: Signals, now: Signals) -> ca.SX:
    """Return the motion up to a reversal within the step, by a linear velocity; 0 without one."""
    turns = before.dq * now.dq < 0
    total = ca.if_else(turns, ca.fabs(before.dq) + ca.fabs(now.dq), 1)
    return turns * before.dq * ca.fabs(before.dq) / total * (now.time - before.time) / 2
