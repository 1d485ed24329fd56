"""``experiment``: the closed loop of recording, diagnosis and design of the next motion."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.atomic_file import atomic_binary
from lieid_casadi.comparison import compare
from lieid_casadi.diagnosis import diagnose
from lieid_casadi.errors import ExcitationError, LieidError, NoSolution, PremiseError, RecordError
from lieid_casadi.excitation import default_limits
from lieid_casadi.excitation.checks import MARGIN
from lieid_casadi.excitation.limits import Limit
from lieid_casadi.experiments.folder import STATE, ExperimentFolder, identity_of
from lieid_casadi.experiments.motion import LEAST_SECONDS, MotionDesign, PlannedMotion, Progress
from lieid_casadi.experiments.purpose import Purpose, open_groups, purposes, remaining
from lieid_casadi.experiments.record import Recorded, check_premises, doubts
from lieid_casadi.experiments.result import Experiment, Round
from lieid_casadi.identification import Fit
from lieid_casadi.identification.identify import default_effects
from lieid_casadi.model import Model
from lieid_casadi.recording import Recording
from lieid_casadi.recording.recording import listed
from lieid_casadi.robot import Robot

Record = Callable[[PlannedMotion], Recording]
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
    motions for errors that no effect describes, and for effects whose gain on held-out parts is
    not certain. Every motion begins with the same short probe, whose torque shows whether the arm
    has changed.

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
        Where every round is kept; a temporary one by default. With the folder of an earlier call
        the experiment is resumed.
    most : int
        Recordings at most, beside the given ones.
    confirm : callable, optional
        Called with each motion before it is recorded; False ends the experiment.
    load : callable
        Reads the recordings of the folder when an experiment is resumed.
    despite_check : bool
        Use recordings that certainly do not belong to the robot (see `check`).
    start_pose, acceleration, margin, limits
        As of `excite`, for every motion.
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
    design = MotionDesign(
        model, source if isinstance(source, Fit) else None,
        default_limits(model.robot, margin=margin) if limits is None else tuple(limits),
        acceleration, margin, longest, rate, seed,
    )  # fmt: skip
    design = replace(design, probe=design.probe_motion(probe, start_pose))
    path = tempfile.mkdtemp(prefix="lieid-experiment-") if folder is None else folder
    kept = ExperimentFolder.of(path, identity_of(model.robot, given, design.probe))
    loop = _Loop(source, given, design, kept, progress)
    loop.resume(load)
    while loop.result.stopped is None:
        loop.diagnose()
        motion = loop.plan(most)
        if motion is not None and confirm is not None and not confirm(motion):
            loop.keep(stopped="record_failed", reason="The motion was not confirmed; none was run.")
        elif motion is not None:
            loop.record(motion, record, despite_check=despite_check)
    return loop.result


class _Loop:
    """The experiment so far, in memory and in its folder."""

    def __init__(
        self,
        source: Robot | Model | Fit,
        given: Sequence[Recording],
        design: MotionDesign,
        folder: ExperimentFolder,
        progress: Progress,
    ) -> None:
        self.source, self.given, self.design, self.folder = source, given, design, folder
        self.progress = progress
        self.recorded = list[Recorded]()
        self.unnecessary = list[Purpose]()
        seconds = sum(recording.duration for recording in given)
        first = (Round(0, None, "", seconds, None, None),) if given else ()
        rounds = folder.rounds() or first
        self.result = Experiment(
            design.model.robot.name, rounds, folder=folder.path, longest=design.longest
        )

    def resume(self, load: Callable[[Path], Recording]) -> None:
        """Read the recordings of an earlier call."""
        for each in self.result.rounds:
            if each.recording is not None:
                self.recorded.append((load(self.folder.path / each.recording), each.starts))

    def keep(self, **changes: Any) -> None:
        """Change the result, and write it."""
        self.result = replace(self.result, **changes)
        self.folder.write(STATE, self.result.to_dict())

    @property
    def recordings(self) -> list[Recording]:
        """The recordings that are diagnosed: given ones and those that were made."""
        return [*self.given, *(recording for recording, _ in self.recorded)]

    @property
    def fit(self) -> Fit | None:
        """Fit of the last diagnosis."""
        return None if self.result.diagnosis is None else self.result.diagnosis.fit

    def diagnose(self) -> None:
        """Diagnose all recordings, and complete the last round with the result."""
        if not self.recordings:
            return
        found = diagnose(
            _model(self.source, self.recordings), self.recordings,
            progress=lambda stage, done: self.progress(f"diagnose: {stage}", done),
        )  # fmt: skip
        _, errors = found.shown
        *before, last = self.result.rounds
        last = replace(
            last,
            verdict=found.verdict,
            open=tuple(open_groups(found)),
            named=tuple(step.label for step in found.steps if step.status == "named"),
            sentences=tuple(found.sentences),
            error=_finite(errors[-1]),
            first_error=_finite(errors[0]),
            noise_floor=_finite(found.noise_floor),
        )
        if last.number:
            self.folder.write(f"round-{last.number}/diagnosis.json", found.to_dict())
            found.fit.save(self.folder.round(last.number) / "fit.json")
        self.keep(rounds=(*before, last), diagnosis=found)

    def plan(self, most: int) -> PlannedMotion | None:
        """Return the next motion; None if the experiment ends here."""
        diagnosis, reasons = self.result.diagnosis, list[str]()
        asked = [each.purpose for each in self.result.rounds if each.purpose is not None]
        left, number = most - len(asked), len(asked) + 1
        needs = purposes(
            diagnosis, [*asked, *self.unnecessary],
            recorded=sum(r.duration for r in self.recordings), left=left * self.design.seconds,
        )  # fmt: skip
        if needs and left < 1:
            made = f"{most} recording was" if most == 1 else f"{most} recordings were"
            reason = f"{made} made, as many as were allowed."
            self.keep(stopped="most", reason=reason)
            return None
        for need in needs:
            try:
                motion = self.design.next(
                    need, self.folder.round(number), self.fit, self.recordings,
                    most=left, number=number, progress=self.progress,
                )  # fmt: skip
            except NoSolution as failure:
                if diagnosis is None:
                    raise
                reasons.append(str(failure))
                continue
            if motion is not None:
                with atomic_binary(motion.folder / "trajectory.csv") as file:
                    file.write(motion.csv().encode())
                return motion
            self.unnecessary.append(need)
        assert diagnosis is not None
        reasons = [*remaining(diagnosis), *reasons]
        if reasons:
            self.keep(stopped="not_separable", reason=" ".join(dict.fromkeys(reasons)))
        else:
            reason = "Every effect is named, and nothing is unexplained."
            self.keep(stopped="all_named", reason=reason)
        return None

    def record(self, motion: PlannedMotion, record: Record, *, despite_check: bool) -> None:
        """Record a motion."""
        self.progress(f"record {motion.number}", 0.0)
        fit, model = self.fit, self.design.model
        first = self.recorded[0] if self.recorded else None
        try:
            recording = record(motion)
            if recording.n != model.n:
                raise RecordError(f"a recording of {recording.n} joints; expected {model.n}")
            warnings = [] if despite_check else check_premises(model, recording)
            starts, more = doubts(motion, recording, fit, first)
            unseen = () if fit is None else _finite(compare(fit, recording).rms_moving)
        except PremiseError:
            raise
        except LieidError as failure:
            reason = f"Recording {motion.number} failed: {failure}."
            self.keep(stopped="record_failed", reason=reason)
            return
        file = motion.folder / "recording.csv"
        if not file.exists():  # a command has written it
            recording.save(file)
        self.recorded.append((recording, starts))
        done = Round(
            motion.number, motion.purpose, motion.promise, motion.duration,
            f"{motion.folder.name}/trajectory.csv", f"{motion.folder.name}/{file.name}",
            starts=starts, unseen=unseen, warnings=(*warnings, *more),
            checked=motion.checked, unchecked=motion.unchecked,
        )  # fmt: skip
        self.keep(rounds=(*self.result.rounds, done))


def _finite(values: Array) -> tuple[float, ...]:
    """Return errors in motion; that of a joint at rest is 0."""
    return tuple(np.nan_to_num(values).tolist())


def _model(source: Robot | Model | Fit, recordings: Sequence[Recording]) -> Model:
    """Return the model without the effects that are to be found."""
    if isinstance(source, Robot):
        return Model(source, default_effects(source, recordings).names)
    return source.model if isinstance(source, Fit) else source
