"""CasADi code of a smooth function, for a user-defined effect without a short formula."""

from __future__ import annotations

from lieid_casadi.diagnosis.residual.shapes import SmoothShape
from lieid_casadi.diagnosis.residual.signal_names import split_name
from lieid_casadi.diagnosis.screening.smooth_functions import is_friction_by_angle

ANGLE_WAVES, TIME_WAVES, POWERS = 8, 12, 5
FUNCTIONS_OF_PAIR = 4  # of each of two signals


def smooth_lists(shape: SmoothShape, members: dict[str, str]) -> list[tuple[str, int]]:
    """Return, for each signal of a shape, a list of CasADi expressions as code, and its length.

    Parameters
    ----------
    shape : SmoothShape
    members : dict
        Signal → expression of it in the effect's function, such as ``s.other.dq``.
    """
    pair = len(shape.signals) > 1
    own = is_friction_by_angle(shape.signals)
    return [
        _list(
            name,
            members[name],
            float(grid[0]),
            float(grid[-1]),
            pair and not (own and name == shape.signals[0]),
        )
        for name, grid in zip(shape.signals, shape.grid, strict=True)
    ]


def _list(name: str, member: str, low: float, high: float, pair: bool) -> tuple[str, int]:
    kind, _ = split_name(name)
    middle, half = 0.5 * (low + high), max(0.5 * (high - low), 1e-9)
    if kind in ("q", "t"):
        count = FUNCTIONS_OF_PAIR if pair else ANGLE_WAVES if kind == "q" else TIME_WAVES
        turn = f"{0.5 / half:.6g} * ca.pi * ({member} - {low:.6g})"
        return f"[ca.cos(k * {turn}) for k in range(1, {count + 1})]", count
    if kind == "dq":
        sign, v = member.replace(".dq", ".sign"), member
        size = f"ca.fabs({v})"
        if pair:
            return f"[{sign}, {size}, {v}, {v} * {size}]", FUNCTIONS_OF_PAIR
        near = f"{sign} * ca.exp(-(({v} / {0.1 * max(abs(low), abs(high)):.6g}) ** 2))"
        return f"[{size}, {v} * {size}, {v} ** 3, {near}]", 4
    count = FUNCTIONS_OF_PAIR if pair else 2 if kind == "temp" else POWERS
    x = f"(({member} - {middle:.6g}) / {half:.6g})"
    if kind != "temp":
        x = f"ca.fmax(-1.2, ca.fmin(1.2, {x}))"
    return f"[{x} ** k for k in range(1, {count + 1})]", count
