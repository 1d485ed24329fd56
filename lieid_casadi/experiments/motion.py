"""The next motion: designed for a purpose within limits, after a probe that never changes."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import compile
from lieid_casadi.discrimination import discriminate
from lieid_casadi.discrimination.discriminate import separating_seconds
from lieid_casadi.discrimination.motion_search import feasible_motions
from lieid_casadi.discrimination.rival_effects import fitted_numbers
from lieid_casadi.errors import EffectError, LieidError, NoSolution
from lieid_casadi.excitation import excite, friction_sweep
from lieid_casadi.excitation.checks import verify
from lieid_casadi.excitation.limits import Limit, MotionRange, motion_range, on_arm
from lieid_casadi.excitation.sample_functions import FittedArm
from lieid_casadi.excitation.trajectory import MotionSamples, csv_text
from lieid_casadi.experiments.purpose import Group, Purpose
from lieid_casadi.identification import Fit, identify
from lieid_casadi.identification.identify import JOINT_SIDE
from lieid_casadi.model import Model
from lieid_casadi.recording import Processed, Recording, process

Progress = Callable[[str, float], None]
T = TypeVar("T")

PROBE_SIZE = 0.5  # of the largest motion within the limits
HARMONICS = 5
EXCITATION_STARTS = 2
STARTS, EVALUATIONS = 60, 400  # of the search for a separating motion
PARTS = (1, 2, 3)  # of the time of a motion that are compared: a long one and short ones
LEAST_SECONDS = 5.0  # of a motion beside the probe
WORTH = 0.4  # of an excitation: ln of the factor by which it lowers standard deviations
LEAST_INFORMATION = 1e-9  # relative to that of an excitation
SWEEP_SPEEDS = (0.03, 0.15, 0.6)  # of the velocity limit
CREEP_SPEEDS = (0.005, 0.02, 0.1)  # the same, near standstill
SWEEP_RATE = 100.0  # Hz, at which slow runs are judged
SWEEP_SECONDS = (1.0, 0.7)  # at each speed and direction, that are tried


@dataclass(frozen=True, eq=False)
class PlannedMotion:
    """A motion that is to be run, at rest at the same pose at both ends."""

    number: int  #: of its recording, from 1
    purpose: Purpose
    samples: MotionSamples  #: times t (N,), s; q, dq, ddq (N, n), rad, rad/s, rad/s²
    probe: float  #: length of the probe motion at the start, the same in every recording, s
    promise: str  #: what the design predicts
    checked: tuple[str, ...]  #: limits that the whole motion was verified to keep
    unchecked: tuple[str, ...]  #: limits that it was not
    folder: Path  #: with ``trajectory.csv``, and where ``recording.csv`` belongs

    @property
    def duration(self) -> float:
        """Length of the motion, s."""
        return float(self.samples.t[-1])

    @property
    def sentences(self) -> tuple[str, ...]:
        """What it is for, where it is, and what was checked: before the user confirms it."""
        return (
            f"Recording {self.number}: {self.purpose.why} {self.promise}",
            f"The robot moves for {self.duration:.3g} s along {self.folder}/trajectory.csv.",
            f"Checked: {'; '.join(self.checked)}.",
            f"Not checked: {'; '.join(self.unchecked)}.",
        )

    def csv(self) -> str:
        """Return ``trajectory.csv``: t, q, dq, ddq, after comments with what was checked."""
        return csv_text(self.samples, self.checked, self.unchecked)


@dataclass(frozen=True, eq=False)
class MotionDesign:
    """How the motions of an experiment are designed.

    The probe is at rest at the start pose at both ends, and of no length if there is none.
    """

    model: Model  # without the effects that were found
    fit: Fit | None  # from which the experiment started
    limits: tuple[Limit, ...]
    acceleration: ArrayLike | None
    margin: float  # part of the velocity limits that is used
    longest: float  # length of a whole motion, s
    rate: float  # of the trajectory files, Hz
    seed: int
    probe: MotionSamples = field(default_factory=lambda: MotionSamples(*[np.zeros(1)] * 4))

    @property
    def range(self) -> MotionRange:
        """Limits of the joints."""
        return motion_range(self.model.robot, self.acceleration, margin=self.margin)

    @property
    def seconds(self) -> float:
        """Time of a motion beside the probe, s."""
        return self.longest - float(self.probe.t[-1])

    @property
    def _shared(self) -> dict[str, Any]:
        return {
            "limits": self.limits, "start_pose": self.probe.q[0], "margin": self.margin,
            "acceleration": self.acceleration, "rate": self.rate,
        }  # fmt: skip

    def probe_motion(self, seconds: float, start_pose: ArrayLike | None) -> MotionSamples:
        """Return a small random motion of all joints from the start pose and back."""
        arm = None if self.fit is None else FittedArm.of(self.fit)
        feasible = feasible_motions(
            self.model.robot, arm, self.range, self.limits,
            duration=seconds or 1.0, harmonics=2, start_pose=start_pose,
        )  # fmt: skip
        drawn = feasible.drawn(np.random.default_rng([self.seed, 31]))
        z, _ = feasible.verified(PROBE_SIZE * drawn)
        times = np.linspace(0.0, seconds, round(seconds * self.rate) + 1)
        return feasible.parametrization.trajectory(z).at(times)

    def next(
        self,
        purpose: Purpose,
        folder: Path,
        found: Fit | None,
        recordings: Sequence[Recording],
        *,
        number: int,
        most: int,
        progress: Progress,
    ) -> PlannedMotion | None:
        """Return the motion of recording ``number`` for a purpose; ``most`` can still be recorded.

        None stands for an excitation that would show hardly more than the recordings do. A
        `NoSolution` states that no motion within the limits does what it is for.
        """
        fit = found or self.fit
        if purpose.kind == "rivals":
            assert fit is not None
            main, promise = self._separating(purpose.groups, fit, recordings, most, progress)
        elif purpose.kind == "range" and (
            sweep := self._sweep(joints_of(purpose.signals), SWEEP_SPEEDS, recordings)
        ):
            main, promise, fit = sweep
        else:
            drawn = 0 if purpose.kind == "temperature" else number  # the same motion each time
            main, promise, worth = self._informative(
                found, recordings, purpose.seconds, drawn, progress
            )
            if purpose.kind == "excitation" and worth < WORTH:
                return None
            slow = None
            if purpose.kind == "evidence":
                assert found is not None
                slow = self._slow_runs(purpose.groups, found, recordings, beside=main)
            main, promise, fit = slow or (main, promise, self.fit)
        whole, arm = joined(self.probe, main), None if fit is None else FittedArm.of(fit)
        robot = self.model.robot
        verified = verify(robot, whole, self.range, on_arm(self.limits, robot, arm), arm)
        return PlannedMotion(
            number, purpose, whole, float(self.probe.t[-1]), promise,
            verified.checked, verified.unchecked, folder,
        )  # fmt: skip

    def _informative(
        self,
        found: Fit | None,
        recordings: Sequence[Recording],
        needed: float,
        number: int,
        progress: Progress,
    ) -> tuple[MotionSamples, str, float]:
        """Return the excitation that is expected to show most per second, and its `precision_gain`.

        The gain is that over the recordings, second by second. A long motion and short ones are
        compared, those of at least ``needed`` seconds if there are any; without a recording it is
        the long one. Recordings of little motion cannot bound the torque of larger motion:
        ``found`` is not used for the limits.
        """
        if found is None:
            return *self._exciting(self.fit, number, progress), np.inf
        before = information(found, [s for r in recordings for s in process(r, found.processing)])
        known, probe = sum(r.duration for r in recordings) * before, float(self.probe.t[-1])
        best, most = None, -np.inf
        designs = self._of_each_length(
            partial(self._exciting, self.fit, number, progress), least=needed
        )
        for main, text in designs:
            rate, seconds = information(found, [main]), float(main.t[-1])
            per_second = precision_gain(known, known + seconds * rate) / (probe + seconds)
            if per_second > most:
                best, most = (main, text, precision_gain(before, rate)), per_second
        assert best is not None
        return best

    def _of_each_length(self, design: Callable[..., T], *, least: float = 0.0) -> list[T]:
        """Return the designs of a long motion and short ones, as far as there are any."""
        found, reasons = list[T](), list[str]()
        for seconds in (self.seconds / parts for parts in PARTS):
            if seconds >= min(max(LEAST_SECONDS, least), self.seconds):
                try:
                    found.append(design(duration=seconds))
                except NoSolution as failure:
                    reasons.append(str(failure))
        if not found:
            raise NoSolution(" ".join(dict.fromkeys(reasons)))
        return found

    def _exciting(
        self, fit: Fit | None, number: int, progress: Progress, *, duration: float | None = None
    ) -> tuple[MotionSamples, str]:
        """Return an excitation of all parameters."""
        design = excite(
            self.model if fit is None else fit,
            duration=duration or self.seconds, harmonics=HARMONICS, starts=EXCITATION_STARTS,
            seed=self.seed + 10 * number, progress=progress, **self._shared,
        )  # fmt: skip
        return design.motion(), f"Condition number {design.condition_number:.3g}."

    def _sweep(
        self, joints: set[int], speeds: Sequence[float], recordings: Sequence[Recording]
    ) -> tuple[MotionSamples, str, Fit] | None:
        """Return runs of a single joint, from rest, at parts of its speed limit.

        The fit is that of the limits: shapes cannot be extrapolated.
        """
        if len(joints) != 1:
            return None
        (joint,) = joints
        fit = identify(self.model, recordings)
        limit = self.range.velocity[joint]
        for seconds in SWEEP_SECONDS:
            try:
                sweep = friction_sweep(
                    fit, joint, speeds=np.array(speeds) * limit, seconds=seconds, **self._shared
                )
            except NoSolution:
                continue  # shorter runs need less space
            if sweep.motion.t[-1] <= self.seconds:
                slowest, count = sweep.parts[0].speed, len(sweep.parts) // 2
                text = f"{count} speeds of joint {joint + 1} from {slowest:.2g} rad/s, both ways."
                return sweep.motion, text, fit
        return None

    def _separating(
        self,
        groups: Sequence[Group],
        fit: Fit,
        recordings: Sequence[Recording],
        most: int,
        progress: Progress,
    ) -> tuple[MotionSamples, str]:
        """Return the motion that separates the rivals of all groups, or of as many as it can.

        One long period and several short ones are compared by the time that they need.
        """
        sizes = {
            label: values
            for group in groups
            for label, values in rival_sizes(fit, group, recordings).items()
        }
        pairs = [((group[0], rival),) for group in groups for rival in group[1:]]
        tried = dict.fromkeys([tuple(groups), *((group,) for group in groups), *pairs])
        reasons = list[str]()
        for chosen in tried:
            known = {label: sizes[label] for group in chosen for label in group if label in sizes}
            try:
                separating = partial(
                    discriminate, fit, chosen, sizes=known, seed=self.seed, starts=STARTS,
                    evaluations=EVALUATIONS, progress=progress, **self._shared,
                )  # fmt: skip
                designs = self._of_each_length(separating)
            except (NoSolution, EffectError) as failure:
                reasons.append(str(failure))
                continue
            best = min(designs, key=lambda design: (design.seconds, design.exact_seconds))
            names = "; ".join(" from ".join(group) for group in chosen)
            if best.exact_seconds <= most * self.seconds:
                periods = min(best.periods, round(self.seconds / best.trajectory.duration))
                promise = f"{best.exact_seconds:.3g} s of this motion separate {names}."
                return best.motion(periods=periods), promise
            reasons.append(
                f"{names}: the best motion found within the limits would have to run for "
                f"{best.exact_seconds:.3g} s; {most} recordings of {self.seconds:.3g} s are left."
            )
        raise NoSolution(" ".join(dict.fromkeys(reasons)))

    def _slow_runs(
        self,
        groups: Sequence[Group],
        found: Fit,
        recordings: Sequence[Recording],
        *,
        beside: MotionSamples,
    ) -> tuple[MotionSamples, str, Fit] | None:
        """Return slow runs of the joint on which effects are open, if they show more than a motion.

        They may for effects that act near standstill: excitations pass these speeds in a few
        samples.
        """
        joints = joints_of([label for group in groups for label in group])
        sweep = self._sweep(joints, CREEP_SPEEDS, recordings)
        if sweep is None:
            return None
        fitted = {placement.label for placement in found.model.placements}
        new = [label for group in groups for label in group if label not in fitted]
        sizes = rival_sizes(found, ("", *new), recordings)

        def needed(motion: MotionSamples) -> float:
            every = max(round(self.rate / SWEEP_RATE), 1)
            kinds = [getattr(motion, name)[::every] for name in ("t", "q", "dq", "ddq")]
            try:
                return separating_seconds(
                    found, groups, MotionSamples(*kinds), sizes=sizes, velocity=self.range.velocity
                )
            except (EffectError, NoSolution):
                return np.inf

        return sweep if needed(sweep[0]) < needed(beside) else None


def joints_of(names: Sequence[str]) -> set[int]:
    """Return the joints, from 0, of labels or signals such as ``stribeck:2`` and ``dq2``."""
    return {int(x) - 1 for name in names for x in re.findall(r"\d+$", name)}


def joined(first: MotionSamples, second: MotionSamples) -> MotionSamples:
    """Return two motions in a row; the first ends where the second begins, at rest."""
    kinds = [
        np.concatenate([getattr(first, name)[:-1], getattr(second, name)])
        for name in ("q", "dq", "ddq")
    ]
    return MotionSamples(np.concatenate([first.t[:-1], first.t[-1] + second.t]), *kinds)


def information(fit: Fit, parts: Sequence[MotionSamples | Processed]) -> Array:
    """Return the information (p, p) per second on base parameters, relative to the noise.

    The parameters are those of rigid body, friction and offset.
    """
    compiled = compile(Model(fit.model.robot, JOINT_SIDE))
    columns = [compiled.base_regressor(p.q, p.dq, p.ddq) for p in parts]
    y = np.concatenate(columns) / fit.noise[:, None]
    rows = y.reshape(-1, y.shape[2])
    return np.asarray(rows.T @ rows / len(y))


def precision_gain(before: Array, after: Array) -> float:
    """Return ln of the factor by which standard deviations fall, as a mean over the parameters."""
    scale = np.sqrt(np.outer(np.diag(after), np.diag(after)))
    least = LEAST_INFORMATION * np.eye(len(after))
    logs = [np.linalg.slogdet(each / scale + least)[1] for each in (after, before)]
    return float(logs[0] - logs[1]) / (2.0 * len(after))


def rival_sizes(fit: Fit, group: Group, recordings: Sequence[Recording]) -> dict[str, list[float]]:
    """Return coefficients and shape parameters of rivals, each fitted in the first one's place."""
    others = [p.label for p in fit.model.placements if p.label not in group]
    sizes = {}
    for label in group[1:]:
        model = Model(fit.model.robot, [*others, label])
        try:
            refit = identify(model, recordings, processing=fit.processing)
        except LieidError:
            continue  # it gets the size of the effect in the model
        placement = next(p for p in model.placements if p.label == label)
        numbers = np.concatenate(fitted_numbers(refit, [placement]))
        if numbers[: len(placement.effect.coefficients)].any():
            sizes[label] = numbers.tolist()
    return sizes
