"""Premises on single samples, also repaired ones: not wrapped, no outliers, not held or clipped."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from lieid_casadi.errors import LieidWarning, OutlierWarning, WrappedAngleWarning
from lieid_casadi.messages import joints_text
from lieid_casadi.premises.findings import Finding
from lieid_casadi.recording import Recording
from lieid_casadi.recording.plausibility import clipped_joints

#: Positions that repeat while the arm moves count as held from this part of the rows, and this
#: many; an arm moves if it covers this angle within a quarter of a second, rad.
HELD, FEWEST_HELD, MOVES, WITHIN = 0.3, 20, 0.005, 0.25
#: Time for which torques stay the same, s, and the way of a joint in it, rad or m, from which the
#: torques count as not recorded.
FROZEN, FAR_MOVED = 0.5, 0.05
#: Outliers, which are left out on reading, from which the sensors are in doubt.
FEWEST_OUTLIERS = 3


def damages(recording: Recording) -> list[Finding]:
    """Return the damages of a repaired recording."""
    found = [d for warning in recording.warnings if (d := _repair(warning)) is not None]
    return [*found, *_held(recording), *_clipped(recording)]


def _repair(warning: LieidWarning) -> Finding | None:
    """Return a repair on reading as a finding, if it is more than one or two samples."""
    if isinstance(warning, WrappedAngleWarning):
        premise, remedy = "angle_wrapped", "record continuous angles"
    elif isinstance(warning, OutlierWarning) and warning.samples >= FEWEST_OUTLIERS:
        premise, remedy = "spikes", "look at the sensor that gave these samples"
    else:
        return None
    joints = tuple(j - 1 for j in warning.joints[:3])
    return Finding(premise, joints, {"samples": warning.samples}, f"{warning}.", remedy)


def _held(recording: Recording) -> Iterator[Finding]:
    """Yield positions that repeat although the arm moves before and after."""
    q = np.asarray(recording.q)
    width = max(3, int(WITHIN * recording.rate))
    if len(q) < 4 * width:
        return
    reach = maximum_filter1d(q, width, axis=0) - minimum_filter1d(q, width, axis=0)
    moving = np.any(reach > MOVES, axis=1)[1:]
    held = np.all(np.diff(q, axis=0) == 0.0, axis=1) & moving
    count, rows = int(held.sum()), int(moving.sum())
    if count >= max(HELD * rows, FEWEST_HELD):
        rate = recording.rate * (1.0 - count / rows)
        yield Finding(
            "held_samples", (), {"samples": count},
            f"{recording.title}: {count} rows repeat the positions of the row before although the "
            f"arm moves: the positions have a rate of about {rate:.3g} Hz.",
            "record at the rate of the positions, or leave the repeated rows out",
        )  # fmt: skip


def without_frozen_torque(recording: Recording) -> tuple[Recording, list[Finding]]:
    """Leave out rows in which all torques stay the same while the arm moves on, and report them."""
    t, tau = recording.t, np.asarray(recording.tau)
    same = np.concatenate([[False], np.all(np.diff(tau, axis=0) == 0.0, axis=1), [False]])
    starts, ends = np.flatnonzero(np.diff(same.astype(int))).reshape(-1, 2).T
    frozen = np.zeros(len(t), dtype=bool)
    for a, b in zip(starts, ends, strict=True):  # rows a + 1 to b repeat row a
        moved = np.ptp(recording.q[a : b + 1], axis=0).max()
        frozen[a + 1 : b + 1] = t[b] - t[a] > FROZEN and moved > FAR_MOVED
    if not frozen.any() or np.any(np.ptp(tau, axis=0) == 0.0):
        return recording, []
    count, first = int(frozen.sum()), float(t[int(np.argmax(frozen))])
    return recording.at(~frozen), [
        Finding(
            "held_samples", (), {"samples": count},
            f"{recording.title}: all torques stay the same in {count} rows from t = {first:.4g} s "
            "on, although the arm moves: they were not recorded there. The other rows were "
            "checked.",
            f"leave these rows out, as with {recording.title}@:{first:.4g}",
            certain=True,
        )
    ]  # fmt: skip


def constant_torque(recordings: Sequence[Recording]) -> Finding | None:
    """Return the joints whose torque is the same in all rows, so that no fit shows anything."""
    tau = np.concatenate([np.asarray(r.tau) for r in recordings])
    constant = np.ptp(tau, axis=0) == 0.0
    if not constant.any():
        return None
    return Finding(
        "clipped",
        tuple(np.flatnonzero(constant)[:3].tolist()),
        {"samples": len(tau)},
        f"The torque of {joints_text(constant)} is the same in all {len(tau)} rows: it was not "
        "recorded, and nothing else can be checked.",
        "record the torque of every joint",
    )


def _clipped(recording: Recording) -> Iterator[Finding]:
    """Yield torques that stay at their largest value while the joint moves."""
    assert recording.tau is not None
    clipped = clipped_joints(recording)
    if not clipped.any():
        return
    tau = np.abs(np.asarray(recording.tau))
    level = tau.max(axis=0)
    counts = np.sum(tau >= 0.999 * level, axis=0)
    joints, count = np.flatnonzero(clipped), int(counts[clipped].sum())
    levels = ", ".join(f"{level[j]:.3g}" for j in joints)
    yield Finding(
        "clipped", tuple(int(j) for j in joints[:3]), {"samples": count},
        f"{recording.title}: the torque of {joints_text(clipped)} stays at its largest value "
        f"({levels} N·m) in {count} samples.",
        "move with less acceleration or load, or leave these samples out",
    )  # fmt: skip
