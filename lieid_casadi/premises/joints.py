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


def order(screen: Screen) -> Iterator[Alternative]:
    """Yield the best order of all signals, found by exchanges of two joints."""
    n, names = screen.n, [joint.name for joint in screen.robot.joints]
    found = _best_order(screen, _starts(names), lambda p: reordered(n, p))
    if found is not None:
        wrong = [i for i in range(n) if found[i] != i]
        text = " ".join(str(i + 1) for i in found)
        alphabetical = found == tuple(np.argsort(np.argsort(names)).tolist())
        what = "in alphabetical order" if alphabetical else _moved("", found)
        yield Alternative(
            "joint_order",
            tuple(wrong[:3]),
            {"order": [i + 1 for i in found], "signals": "all"},
            f"The recording has its joints {what}: with --joint-order {text}",
            f"--joint-order {text}",
            reordered(n, found),
            cost=0.3,
        )


def torque_order(screen: Screen) -> Iterator[Alternative]:
    """Yield the best order of the torques alone."""
    n = screen.n
    found = _best_order(screen, [tuple(reversed(range(n)))], lambda p: torques(np.eye(n)[list(p)]))
    if found is not None:
        wrong = [i for i in range(n) if found[i] != i]
        option = "--columns " + ",".join(f"tau{i + 1}=tau{found[i] + 1}" for i in wrong)
        yield Alternative(
            "joint_order",
            tuple(wrong[:3]),
            {"order": [i + 1 for i in found], "signals": "torque"},
            f"The recording has its torques {_moved('tau', found)}: with {option}",
            option,
            torques(np.eye(n)[list(found)]),
            cost=0.3,
        )


def _best_order(
    screen: Screen, starts: list[tuple[int, ...]], made: Callable[[tuple[int, ...]], Correction]
) -> tuple[int, ...] | None:
    """Return the order with the lowest errors: the recorded joint at each joint's place."""
    n = screen.n
    identity = tuple(range(n))

    def score(p: tuple[int, ...]) -> float:
        return 0.0 if p == identity else screen.score(made(p))

    tried = {p: score(p) for p in {identity, *starts}}
    best = min(tried, key=lambda p: tried[p])
    for _ in range(n):
        near = [_exchanged(best, i, j) for i, j in combinations(range(n), 2)]
        for p in near:
            if p not in tried:
                tried[p] = score(p)
        step = min(near, key=lambda p: tried[p])
        if tried[step] > tried[best] - ALIKE:
            break
        best = step
    return None if best == identity else best


def _exchanged(p: tuple[int, ...], i: int, j: int) -> tuple[int, ...]:
    swapped = list(p)
    swapped[i], swapped[j] = swapped[j], swapped[i]
    return tuple(swapped)


def _starts(names: list[str]) -> list[tuple[int, ...]]:
    """Return orders that recorders use: alphabetical and reversed."""
    n = len(names)
    return [tuple(np.argsort(np.argsort(names)).tolist()), tuple(reversed(range(n)))]


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
        sign = np.ones(n)
        sign[j] = -1.0
        option = "--joint-sign " + " ".join(f"{s:.0f}" for s in sign)
        yield Alternative(
            "joint_sign", (j,), {},
            f"Joint {j + 1} turns the other way in this recording: with {option}", option,
            replace(Correction.none(n), position=np.diag(sign)),
        )  # fmt: skip
        option = "--torque-sign " + " ".join(f"{s:.0f}" for s in sign)
        both = "--joint-sign " + " ".join(f"{s:.0f}" for s in sign) + " " + option
        yield Alternative(
            "torque_sign", (j,), {},
            f"The torque of joint {j + 1} has the opposite sign: with {option}", option,
            torques(np.diag(sign)),
        )  # fmt: skip
        yield Alternative(
            "joint_sign",
            (j,),
            {},
            f"Joint {j + 1} turns the other way in this recording, not its torque: with {both}",
            both,
            replace(Correction.none(n), position=np.diag(sign), torque=np.diag(sign)),
            cost=0.3,
        )
    every = "--torque-sign " + " ".join(n * ["-1"])
    yield Alternative(
        "torque_sign", (), {},
        f"All torques have the opposite sign (those of the surroundings on the arm): with {every}",
        every,
        torques(-np.eye(n)),
    )  # fmt: skip


def zeros(screen: Screen) -> Iterator[Alternative]:
    """Yield for each joint that turns the zero that suits the recording best."""
    n = screen.n
    for j, joint in enumerate(screen.robot.joints):
        if not joint.revolute:
            continue

        def score(x: float, j: int = j) -> float:
            return 0.0 if x == 0.0 else screen.score(zero_of(n, j, x))

        x = _best_angle(score)
        if abs(x) < LEAST_ZERO:
            continue
        option = "--joint-zero " + " ".join(f"{x:.4g}" if i == j else "0" for i in range(n))
        yield Alternative(
            "joint_zero", (j,), {"rad": round(x, 4)},
            f"The zero of joint {j + 1} is {abs(np.degrees(x)):.0f}° from the model's: with "
            f"{option}",
            option,
            zero_of(n, j, x),
            cost=0.5,
            small=abs(x) < SMALL_ZERO,
        )  # fmt: skip


def _best_angle(score: Callable[[float], float]) -> float:
    """Return the angle with the lowest score, 0 unless another one is clearly lower."""
    near = {x: score(x) for x in (-NEAR_ZERO, 0.0, NEAR_ZERO)}
    far = {k * ZERO_STEP: score(k * ZERO_STEP) for k in (-2, -1, 1, 2, 3)}
    tried = near | far
    best = min(tried, key=lambda x: tried[x])
    if tried[best] > -ALIKE:
        return 0.0
    width = NEAR_ZERO if best in near else ZERO_STEP
    x = best_on(score, best + width * np.array([-1.0, -0.5, 0.0, 0.5, 1.0]), rounds=4)
    return float((x + np.pi) % (2.0 * np.pi) - np.pi)


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
                option = f"--joint-coupling {i + 1}{'+' if sign > 0 else '-'}{j + 1}"
                yield Alternative(
                    "joint_coupling", (j, i), {"matrix": matrix.astype(int).tolist()},
                    f"Position {i + 1} of the recording is that of the motor, which joint {j + 1} "
                    f"moves too: with {option}",
                    option,
                    replace(Correction.none(n), position=matrix),
                    cost=0.5,
                )  # fmt: skip


def degrees(screen: Screen) -> Iterator[Alternative]:
    """Yield positions in degrees, where one is beyond a turn if it were in rad."""
    turning = np.array([joint.revolute for joint in screen.robot.joints])
    if float(np.abs(screen.thin.q[:, turning]).max(initial=0.0)) < TURN:
        return
    factor = np.where(turning, np.pi / 180.0, 1.0)
    yield Alternative(
        "position_unit", (), {"factor": round(np.pi / 180.0, 8), "unit": "deg"},
        "The positions are in degrees, not in rad: with --units deg",
        "--units deg",
        replace(Correction.none(screen.n), position=np.diag(factor), torque=np.diag(factor)),
    )  # fmt: skip


def alike(screen: Screen) -> str | None:
    """Return which joints the recording cannot distinguish, or None."""
    n = screen.n
    identity = tuple(range(n))
    pairs = [
        f"{i + 1} and {j + 1}"
        for i, j in combinations(range(n), 2)
        if abs(screen.score(reordered(n, _exchanged(identity, i, j)))) < ALIKE
    ]
    return f"joints {', '.join(pairs)} moved alike" if pairs else None
