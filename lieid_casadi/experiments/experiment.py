"""``experiment``: the closed loop of recording, diagnosis and design of the next motion."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.comparison import compare
from lieid_casadi.diagnosis import Diagnosis, diagnose
from lieid_casadi.errors import ExcitationError, LieidError, NoSolution, PremiseError, RecordError
from lieid_casadi.excitation import default_limits
from lieid_casadi.excitation.checks import MARGIN
from lieid_casadi.excitation.limits import Limit, motion_range
from lieid_casadi.excitation.trajectory import MotionSamples
from lieid_casadi.experiments.folder import ExperimentFolder, identity_of
from lieid_casadi.experiments.motion import MotionDesign, PlannedMotion, probe_motion
from lieid_casadi.experiments.purpose import Purpose, open_groups, purposes, remaining
from lieid_casadi.experiments.record import (
    DEVIATION,
    DIFFERS,
    check_premises,
    deviation,
    repeatability,
)
from lieid_casadi.experiments.result import Experiment, Round, Stopped
from lieid_casadi.identification import Fit
from lieid_casadi.identification.identify import default_effects
from lieid_casadi.model import Model
from lieid_casadi.recording import Recording
from lieid_casadi.recording.recording import listed
from lieid_casadi.robot import Robot

Record = Callable[[PlannedMotion], Recording]
LEAST_SECONDS = 5.0  # of a motion beside the probe
SHORTEST_PROBE = 1.0  # s


def experiment(
    source: Robot | Model | Fit,
    recordings: Recording | Iterable[Recording] = (),
    *,
    record: Record,
    folder: str | Path | None = None,
    most: int = 5,
    confirm: Callable[[PlannedMotion], bool] | None = None,
    load: Callable[[Path], Recording] = Recording.load,
    despite_check: bool = False,
    start_pose: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    margin: float = MARGIN,
    limits: Sequence[Limit] | None = None,
    longest: float = 20.0,
    probe: float = 3.0,
    rate: float = 1000.0,
    seed: int = 0,
    progress: Callable[[str, float], None] = lambda stage, fraction: None,
) -> Experiment:
    """Record and diagnose until every effect of the arm is named.

    Each round diagnoses all recordings so far (`diagnose`) and designs the motion that answers
    what is still open: an optimal excitation as long as no recording shows every joint in fast
    motion; then the motion that separates effects which fit equally well (`discriminate`); then
    motions for errors that no effect describes, and for effects of uncertain size. Every motion
    begins with the same short probe, whose torque shows whether the arm has changed.

    **The robot moves.** Limits are checked as by `excite`; what was not checked is in
    ``unchecked`` of each motion, and ``confirm`` lets a person decide.

    Parameters
    ----------
    source : Robot, Model or Fit
        A robot stands for its model with Coulomb and viscous friction and offset (and armature
        where torque comes from currents); a fit for its model, and for the first motion's limits.
    recordings : Recording or iterable of Recording
        From which to start.
    record : callable
        Called with each `PlannedMotion`: moves the robot along ``motion.samples`` and returns the
        recording. A `LieidError` ends the experiment with ``record_failed``.
    folder : str or Path, optional
        Where every round is kept. With the folder of an earlier call the experiment is resumed.
    most : int
        Recordings at most, beside the given ones.
    confirm : callable, optional
        Called with each motion before it is recorded; False ends the experiment.
    load : callable
        Reads the recordings of the folder when an experiment is resumed.
    despite_check : bool
        Use recordings that certainly do not belong to the robot (see `check`).
    start_pose : (n,), optional
        Pose at the start and the end of every motion, rad. Default: as of `excite`.
    acceleration : float or (n,), optional
        Limits in place of the robot's, rad/s².
    margin : float
        Part of the velocity limits, and of the torque limits by default, that is used.
    limits : sequence of Limit, optional
        Besides those of the joints. Default: those of `default_limits`.
    longest : float
        Length of a motion with its probe, s.
    probe : float
        Length of the probe motion, s; 0 for none.
    rate : float
        Of the trajectories, Hz.
    seed : int
        Of the searches for motions.
    progress : callable
        Called with what is done and the fraction that is done.

    Returns
    -------
    Experiment

    Raises
    ------
    ExcitationError
        Limits that are missing or contradict each other; lengths too short.
    NoSolution
        There is no first motion within the limits.
    PremiseError
        A recording that certainly does not belong to the robot. Everything before it is kept.
    OutputError
        The folder holds something else, or cannot be written.
    """
    if 0.0 < probe < SHORTEST_PROBE or probe < 0.0 or longest - probe < LEAST_SECONDS or most < 0:
        raise ExcitationError(
            f"probe {probe:g} s, longest {longest:g} s, most {most}; expected a probe of 0 or at "
            f"least {SHORTEST_PROBE:g} s, {LEAST_SECONDS:g} s more for a motion, and most ≥ 0"
        )
    given = listed(recordings)
    model = _model(source, given)
    fit = source if isinstance(source, Fit) else None
    kept = None
    if folder is not None:
        kept = ExperimentFolder.of(folder, identity_of(model.robot, given, probe, seed))
    joints = motion_range(model.robot, acceleration, margin=margin)
    bounds = default_limits(model.robot, margin=margin) if limits is None else tuple(limits)

    def new_probe() -> MotionSamples:
        return probe_motion(
            model, joints, bounds, fit=fit, seconds=probe, start_pose=start_pose, rate=rate,
            seed=seed,
        )  # fmt: skip

    small = new_probe() if kept is None else kept.probe(new_probe)
    design = MotionDesign(
        model, fit, joints, bounds, acceleration, margin, longest, rate, seed, small
    )
    session = _Session(source, given, design, kept, record, load, despite_check, progress)
    session.resume()
    while True:
        diagnosis = session.diagnose()
        motion = session.plan(diagnosis, most)
        end: _Ended | None
        if isinstance(motion, _Ended):
            end = motion
        elif confirm is not None and not confirm(motion):
            end = _Ended("record_failed", "The motion was not confirmed; nothing moved.")
        else:
            end = session.recorded(motion, diagnosis)
        if end is not None:
            return session.ended(diagnosis, end)


@dataclass(frozen=True)
class _Ended:
    """Why an experiment ended."""

    stopped: Stopped
    reason: str


class _Session:
    """The rounds so far, in memory and in the folder."""

    def __init__(
        self,
        source: Robot | Model | Fit,
        given: Sequence[Recording],
        design: MotionDesign,
        kept: ExperimentFolder | None,
        record: Record,
        load: Callable[[Path], Recording],
        despite_check: bool,
        progress: Callable[[str, float], None],
    ) -> None:
        self.source, self.given, self.design, self.kept = source, given, design, kept
        self.record, self.load, self.despite_check = record, load, despite_check
        self.progress = progress
        self.rounds, self.unnecessary = list[Round](), list[Purpose]()
        self.recorded_ones = list[tuple[Recording, float]]()  # with the start of the motion, s
        if given:
            seconds = sum(recording.duration for recording in given)
            self.rounds.append(Round(0, None, "", seconds, None, None))

    @property
    def recordings(self) -> list[Recording]:
        """All recordings."""
        return [*self.given, *(recording for recording, _ in self.recorded_ones)]

    def resume(self) -> None:
        """Read what an earlier call kept."""
        if self.kept is None:
            return
        self.rounds = self.kept.rounds() or self.rounds
        for each in self.rounds:
            if each.purpose is not None:
                recording = self.kept.recording(each.number, self.load)
                self.recorded_ones.append((recording, each.starts))

    def diagnose(self) -> Diagnosis | None:
        """Diagnose all recordings, and complete the last round with the result."""
        if not self.recordings:
            return None
        found = diagnose(
            _model(self.source, self.recordings), self.recordings,
            progress=lambda stage, done: self.progress(f"diagnose: {stage}", done),
        )  # fmt: skip
        _, errors = found.shown
        self.rounds[-1] = replace(
            self.rounds[-1],
            verdict=found.verdict,
            open=tuple(open_groups(found)),
            named=tuple(step.label for step in found.steps if step.status == "named"),
            sentences=tuple(found.sentences),
            error=tuple(map(float, errors[-1])),
            first_error=tuple(map(float, errors[0])),
            noise_floor=tuple(map(float, found.noise_floor)),
        )
        if self.kept is not None and self.rounds[-1].number:
            self.kept.keep_diagnosis(self.rounds[-1].number, found)
        self._keep(found)
        return found

    def plan(self, diagnosis: Diagnosis | None, most: int) -> PlannedMotion | _Ended:
        """Return the next motion, or why there is none."""
        design = self.design
        asked = [each.purpose for each in self.rounds if each.purpose is not None]
        needs = purposes(diagnosis, [*asked, *self.unnecessary])
        left = most - len(asked)
        if needs and left < 1:
            return _Ended("most", f"{most} recordings were made, as many as were allowed.")
        reasons = list[str]()
        fit = None if diagnosis is None else diagnosis.fit
        for need in needs:
            try:
                motion = design.next(
                    need, len(asked) + 1, fit, self.recordings,
                    most=left, progress=self.progress,
                )  # fmt: skip
            except NoSolution as failure:
                if diagnosis is None:
                    raise
                reasons.append(str(failure))
                continue
            if motion is None:
                self.unnecessary.append(need)
                continue
            if self.kept is not None:
                motion = replace(motion, folder=self.kept.round(motion.number))
                self.kept.keep_motion(motion)
            return motion
        assert diagnosis is not None
        open_ones = remaining(diagnosis)
        if not open_ones and not reasons:
            return _Ended("all_named", "Every effect is named, and nothing is unexplained.")
        return _Ended("not_separable", " ".join(dict.fromkeys([*open_ones, *reasons])))

    def recorded(self, motion: PlannedMotion, diagnosis: Diagnosis | None) -> _Ended | None:
        """Record a motion; return why that failed."""
        self.progress(f"record {motion.number}", 0.0)
        try:
            recording = self.record(motion)
            warnings = self._doubts(recording)
            starts, warned, unseen = self._compared(motion, recording, diagnosis)
        except PremiseError:
            raise
        except LieidError as failure:
            return _Ended("record_failed", f"Recording {motion.number} failed: {failure}.")
        if self.kept is not None:
            self.kept.keep_recording(motion, recording)
        self.recorded_ones.append((recording, starts))
        here = f"round-{motion.number}/"
        self.rounds.append(
            Round(
                motion.number, motion.purpose, motion.promise, motion.duration,
                f"{here}trajectory.csv", f"{here}recording.csv", starts=starts, unseen=unseen,
                warnings=(*warnings, *warned), checked=motion.checked, unchecked=motion.unchecked,
            )
        )  # fmt: skip
        self._keep(diagnosis)
        return None

    def ended(self, diagnosis: Diagnosis | None, end: _Ended) -> Experiment:
        """Return the result, and keep it."""
        result = self._result(diagnosis, end)
        if self.kept is not None:
            self.kept.keep(result.to_dict())
        return result

    def _doubts(self, recording: Recording) -> list[str]:
        n = self.design.model.n
        if recording.n != n:
            raise RecordError(f"a recording of {recording.n} joints; expected {n}")
        if self.despite_check:
            return []
        return check_premises(self.design.model, recording)

    def _compared(
        self, motion: PlannedMotion, recording: Recording, diagnosis: Diagnosis | None
    ) -> tuple[float, list[str], tuple[float, ...]]:
        """Return the start of a motion in its recording (s), doubts, and errors of the last fit."""
        starts, far = deviation(motion.samples, recording)
        warnings = [
            f"The recorded motion of joint {j + 1} differs from the trajectory by {far[j]:.2g} rad."
            for j in np.flatnonzero(far > DEVIATION)
        ]
        if diagnosis is None:
            return starts, warnings, ()
        fit, new = diagnosis.fit, (recording, starts)
        if self.recorded_ones and motion.probe > 0.0:
            changed = repeatability(self.design.probe, fit, self.recorded_ones[0], new)
            warnings += [
                f"The torque of joint {j + 1} along the probe motion differs from the first "
                f"recording by {changed[j]:.2g} N·m (noise: {fit.noise[j]:.2g} N·m): warm-up, "
                "another load, or a fault."
                for j in np.flatnonzero(changed > DIFFERS * fit.noise)
            ]
        return starts, warnings, tuple(map(float, compare(fit, recording).rms_moving))

    def _keep(self, diagnosis: Diagnosis | None) -> None:
        if self.kept is not None:
            content = self._result(diagnosis, _Ended("most", "")).to_dict()
            self.kept.keep(content | {"stopped": None, "reason": ""})

    def _result(self, diagnosis: Diagnosis | None, end: _Ended) -> Experiment:
        path = None if self.kept is None else self.kept.path
        name = self.design.model.robot.name
        return Experiment(name, tuple(self.rounds), diagnosis, end.stopped, end.reason, path)


def _model(source: Robot | Model | Fit, recordings: Sequence[Recording]) -> Model:
    """Return the model without the effects that are to be found."""
    if isinstance(source, Robot):
        return Model(source, default_effects(source, recordings).names)
    return source.model if isinstance(source, Fit) else source
