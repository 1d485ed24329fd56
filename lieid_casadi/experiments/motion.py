"""The next motion: designed for a purpose within limits, after a probe that never changes."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import compile
from lieid_casadi.discrimination import Discrimination, discriminate
from lieid_casadi.discrimination.discriminate import shown_of
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
PARTS = (1, 2, 4)  # of the time of a motion that are compared: a long one and short ones
LEAST_SECONDS = 4.0  # of a motion beside the probe
WORTH = 0.4  # of an excitation: ln of the factor by which it lowers standard deviations
LEAST_INFORMATION = 1e-9  # relative to that of an excitation
SWEEP_SPEEDS = (0.03, 0.15, 0.6)  # of the velocity limit
JUDGED_RATE = 100.0  # Hz, at which motions for evidence are compared
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
            sweep := self._sweep(joints_of(purpose.signals), recordings)
        ):
            main, promise, fit = sweep
        elif purpose.kind == "evidence":
            assert found is not None
            main, promise, fit = self._deciding(purpose, found, recordings, number, progress)
        elif purpose.kind == "excitation" and found is not None:
            main, promise, worth = self._informative(found, recordings, number, progress)
            fit = self.fit
            if worth < WORTH:
                return None
        else:
            drawn = 0 if purpose.kind == "temperature" else number  # the same motion each time
            main, promise = self._exciting(self.fit, drawn, progress)
            fit = self.fit
        whole, arm = joined(self.probe, main), None if fit is None else FittedArm.of(fit)
        robot = self.model.robot
        verified = verify(robot, whole, self.range, on_arm(self.limits, robot, arm), arm)
        return PlannedMotion(
            number, purpose, whole, float(self.probe.t[-1]), promise,
            verified.checked, verified.unchecked, folder,
        )  # fmt: skip

    def _informative(
        self, found: Fit, recordings: Sequence[Recording], number: int, progress: Progress
    ) -> tuple[MotionSamples, str, float]:
        """Return the excitation that is expected to show most per second, and its `precision_gain`.

        The gain is that over the recordings, second by second. A long motion and short ones are
        compared. Recordings of little motion cannot bound the torque of larger motion: ``found`` is
        not used for the limits.
        """
        before = information(found, [s for r in recordings for s in process(r, found.processing)])
        known, probe = sum(r.duration for r in recordings) * before, float(self.probe.t[-1])
        best, most = None, -np.inf
        for main, text in self._of_each_length(partial(self._exciting, self.fit, number, progress)):
            rate, seconds = information(found, [main]), float(main.t[-1])
            per_second = precision_gain(known, known + seconds * rate) / (probe + seconds)
            if per_second > most:
                best, most = (main, text, precision_gain(before, rate)), per_second
        assert best is not None
        return best

    def _of_each_length(self, design: Callable[..., T]) -> list[T]:
        """Return the designs of a long motion and short ones, as far as there are any."""
        found, reasons = list[T](), list[str]()
        for parts in PARTS:
            samples = np.floor(self.seconds / parts * self.rate + 1e-6)
            seconds = float(samples) / self.rate
            if seconds >= min(LEAST_SECONDS, self.seconds):
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
        self, joints: set[int], recordings: Sequence[Recording]
    ) -> tuple[MotionSamples, str, Fit] | None:
        """Return runs of a joint at parts of its speed limit, beyond which shapes are not known."""
        if len(joints) != 1:
            return None
        (joint,) = joints
        fit = identify(self.model, recordings)
        speeds = np.array(SWEEP_SPEEDS) * self.range.velocity[joint]
        for seconds in SWEEP_SECONDS:
            try:
                sweep = friction_sweep(fit, joint, speeds=speeds, seconds=seconds, **self._shared)
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
        """Return the motion that separates most rivals, with long or short periods."""
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
                designs = self._separations(chosen, known, fit, progress)
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

    def _separations(
        self,
        groups: Sequence[Group],
        sizes: Mapping[str, Sequence[float]],
        fit: Fit,
        progress: Progress,
    ) -> list[Discrimination]:
        """Return motions of each length that separate the effects of all groups."""
        separating = partial(
            discriminate, fit, groups, sizes=sizes, seed=self.seed, starts=STARTS,
            evaluations=EVALUATIONS, progress=progress, **self._shared,
        )  # fmt: skip
        return self._of_each_length(separating)

    def _deciding(
        self,
        purpose: Purpose,
        found: Fit,
        recordings: Sequence[Recording],
        number: int,
        progress: Progress,
    ) -> tuple[MotionSamples, str, Fit | None]:
        """Return the shortest motion that should show enough of effects, or what shows most.

        Motions that separate all effects from their absence, else one of them, are repeated until
        they should suffice; without any it is an excitation.
        """
        growth = dict(zip(purpose.groups, purpose.growth, strict=True))
        fitted = {placement.label for placement in found.model.placements}
        for chosen in dict.fromkeys([purpose.groups, *((group,) for group in growth)]):
            labels = [label for (label,) in chosen]
            new = [label for label in labels if label not in fitted]
            sizes = rival_sizes(found, ("", *new), recordings)
            try:
                designs = self._separations(chosen, sizes, found, progress)
            except (NoSolution, EffectError):
                continue
            shown = partial(self._shown, found, {x: designs[0].sizes[x] for x in labels})
            known = sum(shown(part) for r in recordings for part in process(r, found.processing))
            needed = np.maximum(known * np.array([growth[group] for group in chosen]), 1e-9)
            options = [self._repeated(design, shown, needed) for design in designs]
            main, share = max(options, key=lambda each: (min(each[1], 1.0), -each[0].t[-1]))
            enough = "suffice" if share >= 1.0 else f"show {share:.0%} of what is needed"
            names = ", ".join(labels)
            return main, f"This motion should {enough} to be certain of {names}.", found
        return *self._exciting(self.fit, number, progress), self.fit

    def _repeated(
        self, design: Discrimination, shown: Callable[[MotionSamples], Array], needed: Array
    ) -> tuple[MotionSamples, float]:
        """Return a motion repeated until it suffices or the time is over, and its share of that."""
        share = float(np.min(shown(design.motion()) / needed))
        most = round(self.seconds / design.trajectory.duration)
        periods = int(np.clip(np.ceil(1.0 / max(share, 1e-9)), 1, most))
        return design.motion(periods=periods), periods * share

    def _shown(
        self, found: Fit, sizes: Mapping[str, Sequence[float]], motion: MotionSamples | Processed
    ) -> Array:
        """Return what a motion shows of each effect of stated size."""
        every = max(round(len(motion.t) / (motion.t[-1] - motion.t[0]) / JUDGED_RATE), 1)
        t, *kinds = [getattr(motion, name)[::every] for name in ("t", "q", "dq", "ddq")]
        part, velocity = MotionSamples(t - t[0], *kinds), self.range.velocity
        return np.array(
            [shown_of(found, label, part, size=x, velocity=velocity) for label, x in sizes.items()]
        )


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
