"""Recording a motion by the user's command, and doubts about what it recorded."""

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
from lieid_casadi.errors import PremiseError, RecordError, UsageError
from lieid_casadi.excitation.trajectory import MotionSamples
from lieid_casadi.experiments.motion import PlannedMotion
from lieid_casadi.identification import Fit
from lieid_casadi.messages import joints_text
from lieid_casadi.model import Model
from lieid_casadi.premises import check_where_possible
from lieid_casadi.recording import Recording

PATIENCE = 20.0  # s that a command has to end by itself after Ctrl-C
STEP = 0.01  # s, resolution of the start of a motion in its recording
DIFFERS = 1.0  # difference of torques along the probe, relative to the noise, that is reported
AVERAGED = 25  # steps over which they are averaged
MOVING = 0.1  # of the probe's largest speed, below which friction is undetermined
DEVIATION = 0.1  # rad between trajectory and recording that is reported
OTHER_MOTION = 0.5  # of the motion of a joint, from which on it did not follow the trajectory

Recorded = tuple[Recording, float]  # with the time at which the motion starts in it, s


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
        trajectory, recording = (motion.folder / f"{x}.csv" for x in ("trajectory", "recording"))
        words = [word.replace("{trajectory}", str(trajectory)) for word in self.words]
        words = [word.replace("{recording}", str(recording)) for word in words]
        if recording.exists():  # of a call that was refused
            recording.replace(recording.with_name("recording-before.csv"))
        log = motion.folder / "record.log"
        status = _run(words, log)
        if status != 0:
            last = log.read_text(errors="replace").strip().splitlines()[-1:] or ["no output"]
            how = f"signal {signal.Signals(-status).name}" if status < 0 else f"status {status}"
            raise RecordError(
                f"the command ended with {how} ({last[0].strip()}); its output is in {log}"
            )
        if not recording.exists():
            raise RecordError(f"the command wrote no {recording}; its output is in {log}")
        return self.load(recording)


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


def doubts(
    motion: PlannedMotion, recording: Recording, fit: Fit | None, first: Recorded | None
) -> tuple[float, list[str]]:
    """Return when a motion starts in its recording (s), and doubts about the recording.

    With a fit and the ``first`` recording, the torques along the probe are compared. A
    `RecordError` refuses the recording of another motion.
    """
    start, far = deviation(motion.samples, recording)
    moved = motion.samples.q.std(axis=0)
    other = far > np.maximum(OTHER_MOTION * moved, DEVIATION)
    if other.any():
        worst = int(np.argmax(np.where(other, far, 0.0)))
        raise RecordError(
            f"{joints_text(other)} did not follow the trajectory: the recording "
            f"({recording.duration:.3g} s) differs by {far[worst]:.2g} rad from the motion "
            f"({motion.duration:.3g} s) of joint {worst + 1}, which moves by {moved[worst]:.2g} rad"
        )
    found = [
        f"The recorded motion of joint {j + 1} differs from the trajectory by {far[j]:.2g} rad."
        for j in np.flatnonzero(far > DEVIATION)
    ]
    if fit is not None and first is not None and motion.probe > 0.0:
        samples = motion.samples.at(np.flatnonzero(motion.samples.t <= motion.probe))
        changed = repeatability(samples, fit, first, (recording, start))
        found += [
            f"The torque of joint {j + 1} along the probe motion differs from the first "
            f"recording by {changed[j]:.2g} N·m (noise: {fit.noise[j]:.2g} N·m): warm-up, "
            "another load, or a fault."
            for j in np.flatnonzero(changed > DIFFERS * fit.noise)
        ]
    return start, found


def check_premises(model: Model, recording: Recording) -> list[str]:
    """Return doubtful premises in sentences; one that is certainly wrong is a `PremiseError`."""
    found = check_where_possible(model, [recording])
    if found.refusal:
        raise PremiseError(f"{found.refusal} Correct it, or continue with --despite-check")
    return [finding.sentence for finding in found.findings]


def deviation(motion: MotionSamples, recording: Recording) -> tuple[float, Array]:
    """Return when a motion starts in its recording (s), and the RMS of their differences (n,)."""
    t = np.arange(0.0, motion.t[-1], STEP)
    planned = _at(motion.t, motion.q, t)
    slack = max(recording.duration - motion.t[-1], 0.0)
    starts = recording.t[0] + np.arange(0.0, slack + STEP, STEP)
    errors = [
        np.square(_at(recording.t, recording.q, t + start) - planned).mean(axis=0)
        for start in starts
    ]
    best = int(np.argmin([error.sum() for error in errors]))
    return float(starts[best]), np.sqrt(errors[best])


def repeatability(probe: MotionSamples, fit: Fit, first: Recorded, new: Recorded) -> Array:
    """Return the difference (n,) of the torques along the probe of two recordings, N·m.

    It is the RMS of averages over a quarter of a second of the model's errors in motion, which the
    differences between the two motions hardly change.
    """
    t = np.arange(0.0, probe.t[-1], STEP)
    residuals = []
    for recording, start in (first, new):
        assert recording.tau is not None
        residuals.append(_at(recording.t, recording.tau - fit.predict(recording), t + start))
    speed = np.abs(_at(probe.t, probe.dq, t))
    count = len(t) // AVERAGED
    shape = (count, AVERAGED, -1)
    moving = (speed > MOVING * speed.max(axis=0))[: count * AVERAGED].reshape(shape)
    difference = (residuals[1] - residuals[0])[: count * AVERAGED].reshape(shape)
    means = (difference * moving).sum(axis=1) / np.maximum(moving.sum(axis=1), 1)
    used = moving.mean(axis=1) > 0.5
    return np.asarray(np.sqrt((means**2 * used).sum(axis=0) / np.maximum(used.sum(axis=0), 1)))


def _at(t: Array, values: Array, when: Array) -> Array:
    return np.column_stack([np.interp(when, t, column) for column in values.T])
