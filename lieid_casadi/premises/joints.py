"""Premises on joints: their order, the directions of their axes, their zeros, their couplings."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.premises.correction import Correction
from lieid_casadi.premises.screen import Alternative, Screen, best_on

#: Step of the scan of a joint's zero, rad.
ZERO_STEP, NEAR_ZERO = np.radians(60.0), np.radians(20.0)
#: Smallest error of a zero that is reported, rad.
LEAST_ZERO = np.radians(3.0)
#: An error up to this is what the effect `encoder_offset` describes, rad: a doubt at most.
SMALL_ZERO = np.radians(10.0)
TURN = 2.0 * np.pi
#: Change of the score below which two hypotheses cannot be distinguished.
ALIKE = 0.05
#: Exchanges that are tried again after the best one, and joints whose zero is refined.
TRIED_AGAIN, REFINED = 6, 2


def order(screen: Screen) -> Iterator[Alternative]:
    """Yield the best order of all signals, found by exchanges of two joints."""
    n, names = screen.n, [joint.name for joint in screen.robot.joints]
    alphabetical = tuple(np.argsort(np.argsort(names)).tolist())
    starts = [alphabetical, tuple(reversed(range(n)))]
    found = _best_order(screen, starts, lambda p: reordered(n, p))
    if found is not None:
        what = "in alphabetical order" if found == alphabetical else _moved("", found)
        yield _order("joints", found, what, reordered(n, found))


def torque_order(screen: Screen) -> Iterator[Alternative]:
    """Yield the best order of the torques alone."""
    n = screen.n
    found = _best_order(screen, [tuple(reversed(range(n)))], lambda p: torques(np.eye(n)[list(p)]))
    if found is not None:
        yield _order("torques", found, _moved("tau", found), torques(np.eye(n)[list(found)]))


def _order(of: str, found: tuple[int, ...], what: str, correction: Correction) -> Alternative:
    """Return another order of joints or torques as an alternative."""
    wrong = tuple(i for i in range(len(found)) if found[i] != i)
    signals = "all" if of == "joints" else "torque"
    value = {"order": [i + 1 for i in found], "signals": signals}
    text, again = (f"The recording has its {of} {x}: with {{}}" for x in (what, "in another order"))
    return Alternative("joint_order", wrong[:3], value, text, correction, cost=0.3, again=again)


def _best_order(
    screen: Screen, starts: list[tuple[int, ...]], made: Callable[[tuple[int, ...]], Correction]
) -> tuple[int, ...] | None:
    """Return the order with the lowest errors: the recorded joint at each joint's place."""
    identity = tuple(range(screen.n))
    pairs = list(combinations(range(screen.n), 2))
    tried = {identity: 0.0}
    tried |= zip(starts, screen.scores([made(p) for p in starts]), strict=True)
    best = min(tried, key=lambda p: tried[p])
    for _ in range(screen.n):
        near = [_exchanged(best, i, j) for i, j in pairs]
        tried |= zip(near, screen.scores([made(p) for p in near]), strict=True)
        step = min(near, key=lambda p: tried[p])
        if tried[step] > tried[best] - ALIKE:
            break
        moved = {k for k in identity if step[k] != best[k]}
        ranked = sorted(pairs, key=lambda pair: tried[_exchanged(best, *pair)])
        pairs = [p for k, p in enumerate(ranked) if k < TRIED_AGAIN or moved & set(p)]
        best = step
    return None if best == identity or tried[best] >= 0.0 else best


def _exchanged(p: tuple[int, ...], i: int, j: int) -> tuple[int, ...]:
    swapped = list(p)
    swapped[i], swapped[j] = swapped[j], swapped[i]
    return tuple(swapped)


def _moved(prefix: str, found: tuple[int, ...]) -> str:
    wrong = [i for i in range(len(found)) if found[i] != i]
    names = ", ".join(f"{prefix}{i + 1}" for i in wrong[:-1]) + f" and {prefix}{wrong[-1] + 1}"
    return f"{names} exchanged" if len(wrong) == 2 else f"{names} in another order"


def reordered(n: int, p: tuple[int, ...]) -> Correction:
    """Return the correction that takes recorded joint p[i] for joint i."""
    return replace(Correction.none(n), position=np.eye(n)[list(p)])


def torques(matrix: Array) -> Correction:
    """Return the correction that applies a matrix (n, n) to the torques alone."""
    return replace(Correction.none(len(matrix)), torque=matrix)


def directions(screen: Screen) -> Iterator[Alternative]:
    """Yield for each joint the opposite direction of its axis, and the opposite torque."""
    n = screen.n
    for j in range(n):
        flip = np.diag(np.where(np.arange(n) == j, -1.0, 1.0))
        turned = replace(Correction.none(n), position=flip)
        turns = f"Joint {j + 1} turns the other way in this recording"
        for premise, what, correction, cost in (
            ("joint_sign", turns, turned, 0.0),
            ("torque_sign", f"The torque of joint {j + 1} has the opposite sign", torques(flip), 0),
            ("joint_sign", f"{turns}, not its torque", replace(turned, torque=flip), 0.3),
        ):
            yield Alternative(premise, (j,), {}, f"{what}: with {{}}", correction, cost)
    what = "All torques have the opposite sign (those of the surroundings on the arm): with {}"
    yield Alternative("torque_sign", (), {}, what, torques(-np.eye(n)))


def zeros(screen: Screen) -> Iterator[Alternative]:
    """Yield the zeros, of those joints for which one suits the recording best."""
    n = screen.n
    turning = [j for j, joint in enumerate(screen.robot.joints) if joint.revolute]
    angles = [-NEAR_ZERO, NEAR_ZERO, *(k * ZERO_STEP for k in (-2, -1, 1, 2, 3))]
    every = [zero_of(n, j, x) for j in turning for x in angles]
    scores = screen.scores(every).reshape(len(turning), -1)
    best = sorted(
        (float(own.min()), j, k) for k, (j, own) in enumerate(zip(turning, scores, strict=True))
    )
    for low, j, k in best[:REFINED]:
        if low > -ALIKE:
            continue
        start = angles[int(np.argmin(scores[k]))]
        width = NEAR_ZERO if abs(start) == NEAR_ZERO else ZERO_STEP

        def scored(values: Array, j: int = j) -> Array:
            return screen.scores([zero_of(n, j, x) for x in values])

        x = best_on(scored, start + width * np.array([-1.0, -0.5, 0.0, 0.5, 1.0]), rounds=4)
        x = float((x + np.pi) % (2.0 * np.pi) - np.pi)
        if abs(x) < LEAST_ZERO:
            continue
        what = f"The zero of joint {j + 1} is {abs(np.degrees(x)):.0f}° from the model's: with {{}}"
        made, small = zero_of(n, j, x), abs(x) < SMALL_ZERO
        yield Alternative("joint_zero", (j,), {"rad": round(x, 4)}, what, made, 0.5, small)


def zero_of(n: int, joint: int, x: float) -> Correction:
    """Return the correction q_model = q + x of one joint."""
    return replace(Correction.none(n), zero=x * np.eye(n)[joint])


def couplings(screen: Screen) -> Iterator[Alternative]:
    """Yield sums and differences of neighbours: motor angles of wrists, and of parallel arms."""
    n = screen.n
    for i in range(1, n):
        for j in (i - 1, i - 2):
            if j < 0 or (j == i - 2 and i < n - 1):
                continue
            for sign in (-1.0, 1.0):
                matrix = np.eye(n)
                matrix[i, j] = sign
                yield Alternative(
                    "joint_coupling", (j, i), {"matrix": matrix.astype(int).tolist()},
                    f"Position {i + 1} of the recording is that of the motor, which joint {j + 1} "
                    "moves too: with {}",
                    replace(Correction.none(n), position=matrix), cost=0.5,
                )  # fmt: skip


def degrees(screen: Screen) -> Iterator[Alternative]:
    """Yield positions in degrees, of all joints or of those beyond a turn if it were in rad."""
    turning = np.array([joint.revolute for joint in screen.robot.joints])
    largest = np.abs(screen.thin.q).max(axis=0) * turning
    far = (largest > TURN) & (np.radians(largest) < TURN)
    some = [f"q{j + 1}" for j in np.flatnonzero(far)]
    edit = f"convert {', '.join(some)} (dq and ddq of these joints alike) to rad"
    for joints, which, what, remedy in (
        (turning, "", "with {}", "--units deg"),
        (far, f" {', '.join(some)} alone", "{}; then", edit),
    ):
        if far.any():
            factor = np.diag(np.where(joints, np.pi / 180.0, 1.0))
            concerned = tuple(np.flatnonzero(joints)[:3].tolist()) if joints is far else ()
            yield Alternative(
                "position_unit", concerned, {"factor": round(np.pi / 180.0, 8), "unit": "deg"},
                f"The positions{which} are in degrees, not in rad: {what}",
                replace(Correction.none(screen.n), position=factor, torque=factor), remedy=remedy,
            )  # fmt: skip


def alike(screen: Screen) -> str | None:
    """Return which joints the recording cannot distinguish, or None."""
    n = screen.n
    identity = tuple(range(n))
    pairs = list(combinations(range(n), 2))
    scores = screen.scores([reordered(n, _exchanged(identity, i, j)) for i, j in pairs])
    same = [
        f"{i + 1} and {j + 1}" for (i, j), s in zip(pairs, scores, strict=True) if abs(s) < ALIKE
    ]
    return f"joints {', '.join(same)} moved alike" if same else None
