"""Premises on what belongs together: the recording is of this robot, the test of another motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from lieid_casadi.arrays import Array
from lieid_casadi.premises.findings import Finding
from lieid_casadi.premises.screen import Errors
from lieid_casadi.recording import Recording

#: Part of the rigid torque that stated inertias may leave unexplained, as a ratio of RMS (the rated
#: payload of an arm, which they do not contain, is 0.2), and that from which the arm is another.
SOUND, OTHER = 0.3, 0.6
#: Relative error of the free fit from which the geometry itself does not describe the torque.
FREE_OTHER = 0.5
#: Distance of two motions that counts as the same, and of one instant and a later one that counts
#: as motion, as part of the range; the time between these, s; instants compared, and with which the
#: motion is followed.
SAME, MOVES, LATER, INSTANTS, DENSEST = 1e-3, 5e-3, 0.1, 1000, 100_000
#: Part of a test's instants that repeat the training's from which they are one motion.
LEAST_PART = 0.5


def unexplained(errors: Errors) -> float | None:
    """Return the part (RMS over joints) of the rigid torque beyond the stated inertias, or None."""
    if errors.stated is None:
        return None
    floor = errors.free.error**2
    left = np.maximum(errors.stated.error**2 - floor, 0.0)
    whole = np.maximum(errors.stated.own**2 - floor, 0.0)
    return float(np.sqrt(left.sum() / max(float(whole.sum()), 1e-300)))


def mismatch(errors: Errors) -> tuple[bool, float] | None:
    """Return whether it is certain that the arm is another, and the part left unexplained."""
    part = unexplained(errors)
    if part is not None and part > SOUND:
        return part > OTHER, part
    relative = errors.free.held_out / errors.scale
    loaded = errors.scale > 0.2 * errors.scale.max()
    left = float(np.sqrt(np.mean(relative[loaded] ** 2)))
    return (False, left) if left > FREE_OTHER else None


def same_motions(train: Sequence[Recording], tests: Sequence[Recording]) -> list[Finding]:
    """Return the tests that repeat the motion of the training."""
    findings = []
    for test in tests:
        part = same_motion(train, test)
        if part > LEAST_PART:
            findings.append(
                Finding(
                    "same_motion",
                    (),
                    {"fraction": round(part, 3)},
                    f"{test.title} repeats the motion of the training in {100.0 * part:.0f} % of "
                    "its samples: its error is no test of the model. Test on another motion.",
                    "test on another motion, or leave --test out",
                )
            )
    return findings


def same_motion(train: Sequence[Recording], test: Recording) -> float:
    """Return the part of a test's instants in motion that pass as one of a training recording.

    Those pass where the training was, and both are in one place again a moment later: the same
    way at another speed is another motion.
    """
    span = np.maximum(np.ptp(test.q, axis=0), 1e-9)
    way = _now_and_later(test, span, min(len(test), INSTANTS))
    way = way[np.abs(np.diff(way.reshape(len(way), 2, -1), axis=1)).max(axis=(1, 2)) > MOVES]
    best = 0.0
    for recording in train:
        if recording.n == test.n and len(way):
            speed = np.abs(np.diff(recording.q, axis=0) / span).max(axis=1).sum()
            near = _now_and_later(recording, span, int(np.clip(2.0 * speed / SAME, 2, DENSEST)))
            distance, _ = cKDTree(near).query(way, p=np.inf, distance_upper_bound=SAME)
            best = max(best, float(np.mean(np.isfinite(distance))))
    return best


def _now_and_later(recording: Recording, span: Array, count: int) -> Array:
    """Return positions over a span at so many instants, and `LATER` seconds after each (N, 2 n)."""
    t = np.linspace(recording.t[0], recording.t[-1] - LATER, count)
    return np.hstack(
        [
            np.interp(x, recording.t, q)[:, None]
            for x in (t, t + LATER)
            for q in (recording.q / span).T
        ]
    )
