"""Recording a motion: by the user's command, and whether what it wrote can be used."""

from __future__ import annotations

import shlex
import shutil
import signal
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import LieidError, PremiseError, RecordError, UsageError
from lieid_casadi.excitation.trajectory import MotionSamples
from lieid_casadi.experiments.motion import PlannedMotion
from lieid_casadi.identification import Fit
from lieid_casadi.model import Model
from lieid_casadi.premises import check
from lieid_casadi.recording import Recording

PATIENCE = 20.0  # s that a command has to end by itself after Ctrl-C
LOG = "record.log"
SHIFT = 0.01  # s, resolution of the start of a motion in its recording
DIFFERS = 1.0  # difference of torques along the probe, relative to the noise, that is reported
BIN = 0.25  # s over which they are averaged
MOVING = 0.1  # of the probe's largest speed, below which friction is undetermined
DEVIATION = 0.1  # rad between trajectory and recording that is reported


@dataclass(frozen=True)
class RecordCommand:
    """A command that moves the robot along a trajectory file and writes a recording.

    It is split into arguments as a shell does, and run without one: placeholders are replaced
    within each argument, so that paths with spaces remain one argument.
    """

    words: tuple[str, ...]
    load: Callable[[Path], Recording]

    @classmethod
    def parse(cls, text: str, load: Callable[[Path], Recording]) -> RecordCommand:
        """Return the command of ``--record``, if it can be run."""
        try:
            words = shlex.split(text)
        except ValueError as error:
            raise UsageError(f"--record {text}: {error}") from None
        for name in ("{trajectory}", "{recording}"):
            if not any(name in word for word in words):
                raise UsageError(
                    f"--record {text}: {name} is missing; expected "
                    "'COMMAND {trajectory} {recording}'"
                )
        if shutil.which(words[0]) is None:
            raise UsageError(f"--record {text}: {words[0]}: no such program")
        return cls(tuple(words), load)

    def __call__(self, motion: PlannedMotion) -> Recording:
        """Run the command, and load what it wrote; its output goes to ``record.log``."""
        assert motion.folder is not None
        paths = {
            "{trajectory}": str(motion.folder / "trajectory.csv"),
            "{recording}": str(motion.folder / "recording.csv"),
        }
        words = list(self.words)
        for name, path in paths.items():
            words = [word.replace(name, path) for word in words]
        written = motion.folder / "recording.csv"
        written.unlink(missing_ok=True)
        log = motion.folder / LOG
        status = _run(words, log)
        if status != 0:
            last = log.read_text(errors="replace").strip().splitlines()[-1:] or ["no output"]
            how = f"signal {signal.Signals(-status).name}" if status < 0 else f"status {status}"
            raise RecordError(
                f"the command ended with {how} ({last[0].strip()}); its output is in {log}"
            )
        if not written.exists():
            raise RecordError(f"the command wrote no {written}; its output is in {log}")
        return self.load(written)


def _run(words: list[str], log: Path) -> int:
    """Run a command and return its status.

    Ctrl-C reaches the command, too, which has time to stop the robot before it is ended.
    """
    with log.open("wb") as output:
        try:
            process = subprocess.Popen(words, stdout=output, stderr=subprocess.STDOUT)
        except OSError as error:
            raise RecordError(f"{words[0]}: cannot be run: {error.strerror}") from error
        try:
            return process.wait()
        except KeyboardInterrupt:
            try:
                process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                process.terminate()
                process.wait()
            raise


def check_premises(model: Model, recording: Recording) -> list[str]:
    """Return doubts about a recording in sentences.

    Raises
    ------
    PremiseError
        It certainly does not belong to the robot.
    """
    if recording.tau is None or recording.command is not None:
        return []
    try:
        found = check(model, [recording])
    except LieidError:
        return []  # too short for this test
    sentences = [finding.sentence for finding in found.findings]
    if found.verdict == "wrong":
        raise PremiseError(
            f"robot and recording do not belong together: {sentences[0]} Correct it, or continue "
            "with --despite-check"
        )
    return sentences


def deviation(motion: MotionSamples, recording: Recording) -> tuple[float, Array]:
    """Return when a motion starts in its recording (s), and the RMS of their differences (n,)."""
    t = np.arange(0.0, motion.t[-1], SHIFT)
    planned = _at(motion.t, motion.q, t)
    slack = max(recording.t[-1] - recording.t[0] - motion.t[-1], 0.0)
    begin = float(recording.t[0])
    starts = begin + np.arange(0.0, slack + SHIFT, SHIFT)
    q = np.asarray(recording.q)
    errors = [np.square(_at(recording.t, q, t + start) - planned).mean(axis=0) for start in starts]
    best = int(np.argmin([error.sum() for error in errors]))
    return float(starts[best]), np.sqrt(errors[best])


def repeatability(
    probe: MotionSamples, fit: Fit, first: tuple[Recording, float], new: tuple[Recording, float]
) -> Array:
    """Return the difference (n,) of the torques along the probe of two recordings, N·m.

    It is the RMS of averages over a quarter of a second of the model's errors in motion, which the
    differences between the two motions hardly change.

    Parameters
    ----------
    first, new : (Recording, float)
        Each with the time at which the motion starts in it, s.
    """
    t = np.arange(0.0, probe.t[-1], SHIFT)
    residuals = []
    for recording, start in (first, new):
        assert recording.tau is not None
        error = np.asarray(recording.tau) - fit.predict(recording)
        residuals.append(_at(recording.t, error, t + start))
    difference = residuals[1] - residuals[0]
    speed = np.abs(_at(probe.t, probe.dq, t))
    difference[speed < MOVING * speed.max(axis=0)] = np.nan
    length = round(BIN / SHIFT)
    count = len(t) // length
    bins = difference[: count * length].reshape(count, length, -1)
    known = np.isfinite(bins)
    means = np.where(known, bins, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    full = known.mean(axis=1) > 0.5
    square = (means**2 * full).sum(axis=0) / np.maximum(full.sum(axis=0), 1)
    return np.asarray(np.sqrt(square))


def _at(t: Array, values: Array, when: Array) -> Array:
    return np.column_stack([np.interp(when, t, column) for column in values.T])
