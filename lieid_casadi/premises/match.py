"""Premises on what belongs together: the recording is of this robot, the test of another motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.premises.findings import Finding
from lieid_casadi.premises.screen import Errors
from lieid_casadi.recording import Recording

#: Part of the rigid torque that stated inertias may leave unexplained, as a ratio of RMS (the rated
#: payload of an arm, which they do not contain, is 0.2), and that from which the arm is another.
SOUND, OTHER = 0.3, 0.6
#: Relative error of the free fit from which the geometry itself does not describe the torque.
FREE_OTHER = 0.5
#: Distance of two motions that counts as the same, as part of the range, and instants compared.
SAME, INSTANTS = 1e-3, 2000
#: Part of a test's instants that repeat the training's from which they are one motion.
LEAST_PART = 0.5


def unexplained(errors: Errors) -> float | None:
    """Return the part of the rigid torque that the stated inertias do not explain, or None.

    RMS over the joints of what the stated inertias leave beyond the free fit's error, relative to
    what friction alone leaves beyond it.
    """
    if errors.stated is None:
        return None
    floor = errors.free.error**2
    left = np.maximum(errors.stated.error**2 - floor, 0.0)
    whole = np.maximum(errors.stated.own**2 - floor, 0.0)
    return float(np.sqrt(left.sum() / max(float(whole.sum()), 1e-300)))


def mismatch(errors: Errors) -> tuple[bool, float] | None:
    """Return whether it is certain that the arm is another, and the part left unexplained.

    None for a recording that the robot explains.
    """
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
    """Return the part of a test's instants whose positions are those of a training recording."""
    return max((_shared(recording, test) for recording in train), default=0.0)


def _shared(train: Recording, test: Recording) -> float:
    """Return the part of the test that follows the training at the best shift in time."""
    if train.n != test.n:
        return 0.0
    step = max(test.duration / INSTANTS, 1.0 / test.rate)
    t = np.arange(0.0, max(test.duration, train.duration), step)
    span = np.maximum(np.ptp(test.q, axis=0), 1e-9)
    a, b = (
        np.stack(
            [np.interp(t, r.t - r.t[0], x, left=np.nan, right=np.nan) for x in (r.q / span).T],
            axis=1,
        )
        for r in (train, test)
    )
    for r, x in ((train, a), (test, b)):
        x[t > r.duration] = np.nan
    shift = _best_shift(a, b)
    a = np.roll(a, -shift, axis=0)
    if shift > 0:
        a[-shift:] = np.nan
    elif shift < 0:
        a[:-shift] = np.nan
    with np.errstate(invalid="ignore"):
        same = np.all(np.abs(a - b) < SAME, axis=1)
    return float(same.sum() / max(int(np.isfinite(b[:, 0]).sum()), 1))


def _best_shift(a: Array, b: Array) -> int:
    """Return the shift in instants at which two motions correlate best."""
    size = 2 * len(a)
    x, y = (np.fft.rfft(np.nan_to_num(s - np.nanmean(s, axis=0)), size, axis=0) for s in (a, b))
    correlation = np.fft.irfft(np.sum(x * np.conj(y), axis=1), size)
    k = int(np.argmax(correlation))
    return k if k < size // 2 else k - size
