"""Premises on time: the unit of the stamps, torque against position, recorded velocity."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.premises.correction import Correction
from lieid_casadi.premises.findings import Finding
from lieid_casadi.premises.plain_fit import Samples
from lieid_casadi.premises.screen import Alternative, Screen, best_on
from lieid_casadi.recording import Recording, sample_timing
from lieid_casadi.recording.plausibility import unit_of_velocity
from lieid_casadi.recording.repairs import time_late

#: Mean speed below which no arm is recorded to identify it, rad/s.
SLOWEST_ARM = 2e-3
#: Delays that are tried, s, and the least one that is reported.
DELAYS = np.array([-0.2, -0.1, -0.05, -0.025, 0.0, 0.025, 0.05, 0.1, 0.2])
LEAST_DELAY = 0.008
#: A delay up to this is what the effect `torque_delay` describes, s: a doubt at most.
SMALL_DELAY = 0.02
#: Relative error of a recorded velocity from which it is not the derivative of the position, and
#: ratio to which a filter must lower it to be named.
NOT_DERIVATIVE, BY_FILTER = 0.15, 0.5
#: The same of slow motion, if a filter or delay of at least so many seconds explains it.
NOT_DERIVATIVE_SLOW, LONG_LAG = 0.05, 0.05
#: Part of the instants that has most of the error of a velocity where a position jumps.
JUMP_PART, MOST_OF_JUMP = 0.05, 0.9
#: Jump of a position, rad or m, beyond every error of a velocity.
LEAST_JUMP = 0.05
#: Relative size of a recorded velocity that counts as zero.
ZERO_VELOCITY = 1e-3


def delays(screen: Screen) -> Iterator[Alternative]:
    """Yield the time by which the torque is late."""
    n = screen.n

    def scores(late: Array) -> Array:
        return screen.scores([replace(Correction.none(n), late=float(x)) for x in late])

    values = scores(DELAYS)
    k = int(np.argmin(values))
    if values[k] > -0.02 * n and k == len(DELAYS) // 2:
        around = DELAYS[k - 1 : k + 2]
    else:
        around = DELAYS[max(k - 1, 0) : k + 2]
    late = best_on(scores, np.sort(np.r_[around, 0.5 * (around[1:] + around[:-1])]), rounds=2)
    if abs(late) < LEAST_DELAY:
        return
    words = "late" if late > 0.0 else "early"
    yield Alternative(
        "time_offset", (), {"seconds": round(late, 4)},
        f"The torque is {abs(1e3 * late):.0f} ms {words} against the positions: with {{}}",
        replace(Correction.none(n), late=late), cost=0.3, small=abs(late) < SMALL_DELAY,
    )  # fmt: skip


def suspected_unit(recording: Recording) -> Finding | None:
    """Return the unit of time that the rate, the velocities or the lack of motion show."""
    rate = sample_timing.mean_rate(recording.t)
    possible = sample_timing.unit_of_rate(rate)
    if possible and not sample_timing.is_plausible_rate(rate):
        return _unit(possible, f"a mean rate of {rate:.3g} Hz", certain=True)
    if recording.dq is not None:
        found = unit_of_velocity(recording)
        return found and _unit(found[0], f"velocities {found[1]:.3g} times too large", certain=True)
    steps, q = np.diff(recording.t), np.asarray(recording.q)
    inside = steps <= sample_timing.gap_limit(recording.t)
    speed = np.abs(np.diff(q, axis=0))[inside].sum(axis=0) / max(float(steps[inside].sum()), 1e-12)
    if possible and float(speed.max()) < SLOWEST_ARM and np.ptp(q, axis=0).max() > 0.1:
        why = f"no joint moves faster than {speed.max():.2g} rad/s on average"
        return _unit(possible, why, certain=False)
    return None


def _unit(unit: str, why: str, *, certain: bool) -> Finding:
    """Return the finding of another unit of time."""
    option = f"--units {unit}"
    sentence = f"The time stamps are in {unit}, not in seconds ({why}): with {option}."
    value = {"factor": sample_timing.TIME_UNITS[unit], "unit": unit}
    return Finding("time_unit", (), value, sentence, option, certain=certain)


def with_measured_velocity(s: Samples) -> Samples:
    """Return samples whose velocity is the recorded one, and whose acceleration follows from it."""
    ddq = np.empty_like(s.dq)
    for stretch in np.unique(s.segment):
        at = np.flatnonzero(s.segment == stretch)
        ddq[at] = np.gradient(s.measured[at], s.t[at], axis=0) if len(at) > 2 else 0.0
    return replace(s, dq=s.measured, ddq=ddq)


def jump(s: Samples) -> tuple[Finding, Mask] | None:
    """Return where an encoder lost counts, or None.

    The velocity explains the motion before and after it. The mask (N,) leaves out the shorter side.
    """
    if not np.all(np.isfinite(s.measured)):
        return None
    size = np.sqrt(np.mean(s.dq**2, axis=0))
    squares = ((s.measured - s.dq) / np.maximum(size, 1e-3 * size.max())) ** 2
    wrong = np.sqrt(squares.mean(axis=0)) > NOT_DERIVATIVE
    sums = np.sort(squares[:, wrong].sum(axis=1))[::-1].cumsum()
    if not wrong.any() or np.searchsorted(sums, MOST_OF_JUMP * sums[-1]) > JUMP_PART * len(s.t):
        return None
    joints = np.flatnonzero(wrong)[:3]
    at = int(np.argmax(squares[:, wrong].sum(axis=1)))
    t, recording = float(s.t[at]), np.concatenate([[0], np.cumsum(np.diff(s.t) < 0.0)])
    own = recording == recording[at]
    near = own & (np.abs(s.t - t) < 2.0 * s.window)
    way = np.abs(np.trapezoid((s.dq - s.measured)[near], s.t[near], axis=0))
    names = ", ".join(str(j + 1) for j in joints)
    if way.max() < LEAST_JUMP:
        return None
    before, after = own & (s.t < t), own & (s.t > t)
    near |= before if before.sum() < after.sum() else after
    finding = Finding(
        "velocity_signal", tuple(joints.tolist()), {"seconds": 0.0},
        f"At t = {t:.4g} s, the position jumps by {way.max():.2g} rad, of which the velocity shows "
        f"nothing (joint {names}).",
        f"use the parts before and after: REC@:{t - s.window:.4g} or REC@{t + s.window:.4g}:",
        certain=True,
    )  # fmt: skip
    return finding, ~near


def velocity(s: Samples) -> Alternative | None:
    """Return what is wrong with the recorded velocity, or None."""
    if not np.all(np.isfinite(s.measured)):
        return None
    size = np.sqrt(np.mean(s.dq**2, axis=0))
    moved = size > 1e-3 * size.max()
    error = np.sqrt(np.mean((s.measured - s.dq) ** 2, axis=0)) / np.maximum(size, 1e-12)
    wrong = moved & (error > NOT_DERIVATIVE)
    slow = not wrong.any()
    joints = np.flatnonzero(moved & (error > NOT_DERIVATIVE_SLOW) if slow else wrong)
    if not joints.size:
        return None
    what, seconds = "is not the derivative of the position", 0.0
    ratio = np.sqrt(np.mean(s.measured**2, axis=0)) / np.maximum(size, 1e-12)
    if np.all(ratio[joints] < ZERO_VELOCITY):
        what = "is zero although the joints move"
    else:
        missing = (s.dq - s.measured)[:, joints] / size[joints]
        rates = with_measured_velocity(s).ddq[:, joints] / size[joints]
        late = float(time_late(missing.ravel(), rates.ravel()))
        if np.sum((missing - late * rates) ** 2) < BY_FILTER**2 * np.sum(missing**2):
            seconds, what = late, f"is low-pass filtered or delayed by {late:.3g} s"
    if slow and seconds < LONG_LAG:
        return None
    names = ", ".join(str(j + 1) for j in joints[:3])
    return Alternative(
        "velocity_signal", tuple(joints[:3].tolist()), {"seconds": round(seconds, 4)},
        f"The recorded velocity of joint{'s' if len(joints) > 1 else ''} {names} {what}: with {{}} "
        "(velocities from the positions)",
        Correction.none(s.n), remedy="--derive-velocity",
    )  # fmt: skip
