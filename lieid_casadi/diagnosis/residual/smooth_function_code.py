"""CasADi code of a smooth function, for a user-defined effect without a short formula."""

from __future__ import annotations

from lieid_casadi.diagnosis.residual.shapes import SmoothShape
from lieid_casadi.diagnosis.residual.signal_names import split_name
from lieid_casadi.diagnosis.screening.smooth_functions import (
    ANGLE_WAVES,
    FRICTION_WAVES,
    LOAD_STEP,
    SPEED_WAVES,
    is_friction_by_angle,
)

POWERS = 5
FUNCTIONS_OF_PAIR = 4  # of each of two signals
REACH = 1.05  # range of a signal in which a function varies, relative to that in training


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
            pair,
            FRICTION_WAVES if own else FUNCTIONS_OF_PAIR if pair else ANGLE_WAVES,
        )
        for name, grid in zip(shape.signals, shape.grid, strict=True)
    ]


def _list(
    name: str, member: str, low: float, high: float, pair: bool, waves: int
) -> tuple[str, int]:
    kind, _ = split_name(name)
    middle, half = 0.5 * (low + high), max(0.5 * (high - low), 1e-9)
    if kind == "q":
        turn = f"{0.5 / half:.6g} * ca.pi * ({_limited(member, low, high)} - {low:.6g})"
        return f"[ca.cos(k * {turn}) for k in range(1, {waves + 1})]", waves
    if kind == "dq":
        reach = max(abs(low), abs(high))
        sign, v = member.replace(".dq", ".sign"), _limited(member, -reach, reach)
        size = f"ca.fabs({v})"
        if pair:
            return f"[{sign}, {size}, {v}, {v} * {size}]", FUNCTIONS_OF_PAIR
        near = f"{sign} * ca.exp(-(({v} / {0.1 * reach:.6g}) ** 2))"
        wave = f"{sign} * ca.cos(k * ca.pi * {size} / {reach:.6g})"
        peaks = f"[{wave} for k in range(1, {SPEED_WAVES + 1})]"
        return f"[{size}, {v} * {size}, {v} ** 3, {near}, *{peaks}]", 4 + SPEED_WAVES
    count = FUNCTIONS_OF_PAIR if pair else 2 if kind == "temp" else POWERS
    limited = _limited(member, low, high)
    powers = f"(({limited} - {middle:.6g}) / {half:.6g}) ** k for k in range(1, {count + 1})"
    if kind == "load":
        width = LOAD_STEP * max(abs(low), abs(high), 1e-9)
        step = f"ca.tanh({limited} / {width:.6g}), ca.fabs({limited})"
        return f"[*({powers}), {step}]", count + 2
    return f"[{powers}]", count


def _limited(member: str, low: float, high: float) -> str:
    """Return a signal limited to its range in training and a little more.

    Outside of it the function is constant: its slope there is not determined.
    """
    margin = (REACH - 1.0) * 0.5 * (high - low)
    return f"ca.fmax({low - margin:.6g}, ca.fmin({high + margin:.6g}, {member}))"
