"""Which effects a model lacks: rounds of search and fit, until nothing is added."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.comparison import compare
from lieid_casadi.comparison.compare import compare_segments, compared_segments
from lieid_casadi.compiled import compile
from lieid_casadi.diagnosis.candidates import Candidate, is_delay
from lieid_casadi.diagnosis.evidence import OTHER_JOINTS, Slot, undetermined
from lieid_casadi.diagnosis.final_model import FinalModel
from lieid_casadi.diagnosis.gates import reason_against
from lieid_casadi.diagnosis.motion import UnseenMotion
from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.result import Diagnosis
from lieid_casadi.diagnosis.rows import Rows
from lieid_casadi.diagnosis.search import SMOOTH, Round, search
from lieid_casadi.diagnosis.smooth_functions import followed_signals, own_signals
from lieid_casadi.diagnosis.step import Difference, MotionGain
from lieid_casadi.diagnosis.steps import (
    Accepted,
    absorbed_and_weak,
    difference_of,
    errors_of,
    fitted_values,
    late_friction,
    other_forms,
    over_floor,
    rival_forms,
    steps_of,
    unexplained_parts,
)
from lieid_casadi.effects.torque_saturation import TorqueSaturation
from lieid_casadi.errors import LieidError, NoSolution, unique_warnings
from lieid_casadi.identification import Fit
from lieid_casadi.identification.fit_warnings import OF_LIMIT, OF_NUMBERS
from lieid_casadi.identification.identify import Estimated, Method, identify_segments
from lieid_casadi.identification.prediction import center_temperature
from lieid_casadi.identification.recording_checks import Source
from lieid_casadi.identification.regression.design_matrix import FilteredColumns
from lieid_casadi.model import Model
from lieid_casadi.recording import Recording, process

Report = Callable[[str, float], None]
#: Torque of an effect in that of its joint: a spring may carry several times what the drive does;
#: more cancels that of other effects, and does so only at the speeds of the training data.
LARGEST_TORQUE = 10.0
ROUNDS = 2  # of search and fit; the second one adds what the first fit hid


@dataclass(frozen=True)
class Proposal:
    """An effect that is about to be added; ``before`` and ``after`` are held-out errors, N·m."""

    label: str
    joint: int
    before: float
    after: float


class MissingEffects:
    """The search for the effects that a model lacks; ``first`` is its fit before any is added."""

    def __init__(
        self,
        first: Fit,
        train: Sequence[Recording],
        tests: Sequence[Recording],
        method: Method,
        options: DiagnosisOptions,
        ask: Callable[[Proposal], bool] | None,
        report: Report,
    ) -> None:
        self.first, self.train, self.tests = first, train, tests
        self.method, self.options, self.ask, self.report = method, options, ask, report
        segments, _ = center_temperature(process(train, first.processing), first.temperature_mean)
        self.segments = segments
        self.known = tuple(FilteredColumns() for _ in segments)
        self.rejected: dict[str, str] = {}
        self.undecided: dict[str, float] = {}  # of those, gains or coefficients in standard errors
        self.refused: set[str] = set()  # by the user, as implausible, or the motion is no better
        self.differing: list[Difference] = []
        self.apart: list[list[Array]] = []  # columns of what differs between the recordings
        self.unseen: UnseenMotion | None = None
        self.gains: dict[str, MotionGain] = {}  # of the final fit's effects
        self.fits: dict[frozenset[str], Estimated] = {}  # by the effects that are added
        self.candidates: dict[str, Candidate] = {}  # of the library, on joints, by label

    def diagnosis(self, seed: int) -> Diagnosis:
        """Return the diagnosis."""
        options, first = self.options, self.first
        rows = Rows.of(first, self.segments, known=self.known)
        self.candidates = {c.label: c for c in rows.candidates}
        fit, accepted, last = self._searched(rows)
        self.report("measure the effects", 0.9)
        tests = compared_segments(fit, self.tests) if self.tests else None
        final = FinalModel.of(fit, self.segments, tests)
        after = compare(fit, self.tests) if self.tests else None
        before = compare_segments(first, self.tests, tests, with_noise=False) if tests else None
        fitted = compare(fit, self.train)
        torque = np.array([np.sqrt(np.mean(t**2)) if len(t) else np.nan for t in rows.torque])
        last_rows = Rows.of(
            fit, self.segments, known=self.known, before=rows, with_candidates=False
        )
        baseline = errors_of(first, before)
        steps = steps_of(
            final,
            accepted,
            last_rows,
            torque,
            baseline,
            after,
            name_deviations=options.name_deviations,
        )
        steps = tuple(replace(step, motion=self.gains.get(step.label)) for step in steps)
        added = {step.label for step in steps}
        rejected = {label: why for label, why in self.rejected.items() if label not in added}
        spread = last_rows.spread()
        span = last_rows.span(spread)
        ratio, where = over_floor(fitted, after)
        parts = unexplained_parts(
            ratio,
            options.largest_error,
            lambda j: followed_signals(last_rows, span, j, spread),
            self.differing,
            rejected,
            where,
        )
        shown = after or fitted
        absorbed, weak = absorbed_and_weak(last, beside=last.rows.fit.model.placements)
        self.report("done", 1.0)
        return Diagnosis(
            mode="missing",
            fit=fit,
            steps=steps,
            unexplained=parts,
            differing=tuple(self.differing),
            rejected=tuple(rejected.items()),
            undecided=tuple((k, d) for k, d in self.undecided.items() if k in rejected),
            noise_floor=shown.noise_floor,
            noise_source=shown.noise_source,
            baseline_effects=tuple(first.model.effects),
            baseline=baseline,
            expected=None,
            tried=sum(c.of_arm for c in last.paths.columns.owners),
            absorbed=absorbed,
            weak=weak,
            warnings=unique_warnings(
                [
                    *first.model.unusable_effects,
                    *(w for w in first.warnings if not isinstance(w, OF_NUMBERS)),
                    *fit.warnings,
                    *(after.warnings if after else ()),
                    *late_friction(last, options.worth),
                ]
            ),
            train=first.provenance.recordings,
            test=tuple(Source(r.name, r.source_hash) for r in self.tests),
            motion=self._motion_gain([], fit),
            limits_reached=("most_steps",) if len(last.slots) >= options.most_steps else (),
            seed=seed,
        )

    def _searched(self, rows: Rows) -> tuple[Fit, list[Accepted], Round]:
        """Return the fit with all effects that are added, these effects, and the last round.

        Limits of drives come first: where a drive delivers less than its law states, all of the
        torque that the law states in addition looks like effects of the arm.
        """
        accepted, rounds = list[Accepted](), 0
        if any(_is_limit(c) for c in rows.candidates):
            found = search(rows, self.options, wanted=_is_limit, with_smooth=False)
            self.unseen = UnseenMotion.of(rows, found.folds)
            fit, accepted = self._limits(self._accepted(found, accepted))
            if accepted:
                rows = self._beside(fit, rows)
        while True:
            self.report(_stage(accepted), 0.1 + 0.7 * rounds / (rounds + ROUNDS))
            found = search(rows, self.options, wanted=self._is_wanted)
            new = self._accepted(found, accepted)
            apart = self._set_apart(found)
            rounds += 1
            self.unseen = UnseenMotion.of(rows, found.folds)
            fit, accepted = self._moving(*self._plausible([*accepted, *new]))
            if rounds >= ROUNDS or not (new or apart):
                break
            rows = self._beside(fit, rows)
        fit, accepted = self._with_the_same_elsewhere(fit, accepted, rows)
        if self.unseen is None and late_friction(found, self.options.worth):
            rows = self._beside(fit, rows)
            fit, accepted = self._with_more(fit, accepted, rows, is_delay, late=True)
        return *self._final(fit, accepted), found

    def _with_the_same_elsewhere(
        self, fit: Fit, accepted: list[Accepted], rows: Rows
    ) -> tuple[Fit, list[Accepted]]:
        """Return the fit with effects that several joints have on further joints, if needed.

        Drives of one arm resemble each other. Among all candidates several others may have shared
        such an effect, so that none of them was worth it. What it does at reversals is known from
        the other joints, so that the rows near them count in full.
        """
        joints: dict[str, set[int]] = {}
        for each in accepted:
            joints.setdefault(each.candidate.name, set()).add(each.joint)
        common = {name for name, on in joints.items() if len(on) >= OTHER_JOINTS and name != SMOOTH}
        if not common:
            return fit, accepted
        rows = self._beside(fit, rows).with_equal_weights()
        return self._with_more(
            fit, accepted, rows, lambda c: c.name in common and not c.reaches_all
        )

    def _with_more(
        self,
        fit: Fit,
        accepted: list[Accepted],
        rows: Rows,
        kind: Callable[[Candidate], bool],
        *,
        late: bool = False,
    ) -> tuple[Fit, list[Accepted]]:
        """Return the fit with what a search for effects of some kind adds.

        With ``late`` they may explain that dry friction reverses late, which nothing else explains.
        Delays lower the error whether the torque is late or the joint sticks for a moment, so that
        their names are not certain.
        """
        found = search(
            rows,
            self.options,
            wanted=lambda c: self._is_wanted(c) and kind(c),
            beside_friction=not late,
            with_smooth=False,
        )
        new = self._accepted(found, accepted)
        if late:
            new = [replace(a, doubt="late_friction") for a in new]
        return self._plausible([*accepted, *new]) if new else (fit, accepted)

    def _agreed(self, label: str, joint: int, errors: tuple[float, float]) -> bool:
        """Return whether the user adds an effect that changes a held-out error so, N·m."""
        return self.ask is None or self.ask(Proposal(label, joint, *errors))

    def _is_wanted(self, candidate: Candidate) -> bool:
        return candidate.label not in self.refused

    def _beside(self, fit: Fit, rows: Rows) -> Rows:
        """Return the rows of a later fit, with what differs between the recordings set apart."""
        rows = Rows.of(fit, self.segments, known=self.known, before=rows)
        for columns in self.apart:
            rows = rows.with_apart(columns)
        return rows

    def _limits(self, found: list[Accepted]) -> tuple[Fit, list[Accepted]]:
        """Return the fit with the limits that explain most of their joint's error, and these.

        Others compete with all effects, unless the error of the fit is higher with them: below a
        limit that acts nearly always no torque is left to be explained. A limit by which the arm
        moves no better is another effect, such as backlash.
        """
        while True:
            fit, found = self._plausible(found)
            part = fit.rms_cv / self.first.rms_cv
            kept = [a for a in found if part[a.joint] < OF_LIMIT]
            if len(kept) == len(found):
                return self._moving(fit, kept)
            for limit in (a for a in found if part[a.joint] >= 1.0):
                label = limit.placement.label
                self.rejected[label] = "in a fit with it the held-out error is higher"
                self.refused.add(label)
            found = kept

    def _final(self, fit: Fit, accepted: list[Accepted]) -> tuple[Fit, list[Accepted]]:
        """Return the fit with the effects that it needs; those that one replaced may return."""
        fit, accepted = self._with_other_forms(fit, accepted)
        while True:
            fit = self._complete(accepted)
            needed = self._needed(fit, accepted)
            if len(needed) == len(accepted):
                return fit, accepted
            returning = [r for a in accepted if a not in needed for r in a.replaced]
            fit, accepted = self._plausible([*needed, *returning])

    def _with_other_forms(self, fit: Fit, accepted: list[Accepted]) -> tuple[Fit, list[Accepted]]:
        """Return the fit with another form of friction, or of a delay, in place of effects.

        It is better if the cross-validated error is lower by what an effect must be worth; with
        fewer parameters, if it is not higher by as much.
        """
        for j in range(fit.model.n):
            for found, replaced in other_forms(accepted, j, self.candidates):
                others = [*(a for a in accepted if a not in replaced), found]
                fewer = found.candidate.parameters < sum(a.candidate.parameters for a in replaced)
                most = fit.rms_cv[j] * (1.0 - self.options.worth) ** (-1 if fewer else 1)
                try:
                    other = self._fitted(others)
                except NoSolution:
                    continue
                doubtful = any(self._reason_against(other, each) for each in others)
                if doubtful or other.rms_cv[j] > most:
                    continue
                other = self._complete(others)
                if self._undetermined(found, others, other) is not None:
                    continue
                errors = float(fit.rms_cv[j]), float(other.rms_cv[j])
                if self._agreed(found.placement.label, j, errors):
                    fit, accepted = other, others
                    break
        return fit, accepted

    def _needed(self, fit: Fit, accepted: Sequence[Accepted]) -> list[Accepted]:
        """Return the effects whose coefficients are determined and whose stated fall is enough.

        The others leave one at a time, since either of two that resemble each other may be needed.
        What differs between the recordings is part of every error; beside it an effect must lower
        the error at all.
        """
        for found in reversed(accepted):
            undetermined = self._undetermined(found, accepted, fit)
            if undetermined is not None:
                label = found.placement.label
                self.rejected[label], self.undecided[label] = undetermined
                return [a for a in accepted if a is not found]
        model, left = FinalModel.of(fit, self.segments, None), list(accepted)
        torques = [model.part_of_torque(a.placement, a.joint) for a in left]
        if left and max(torques) > LARGEST_TORQUE:
            found = left.pop(int(np.argmax(torques)))
            self.rejected[found.placement.label] = (
                f"its torque is {max(torques):.0f} times that of its joint: others cancel it"
            )
            return left
        while left:
            gone = [a.placement for a in accepted if a not in left]
            falls = [model.fall(a.placement, a.joint, gone) for a in left]
            worst = int(np.argmin(falls))
            if falls[worst] >= (0.0 if self.apart else self.options.worth):
                break
            self.rejected[left.pop(worst).placement.label] = (
                "in the final model it lowers the cross-validated error by only "
                f"{100 * max(falls[worst], 0.0):.1f} %"
            )
        return left if len(left) < len(accepted) else self._moving_better(fit, left)

    def _undetermined(
        self, found: Accepted, accepted: Sequence[Accepted], fit: Fit
    ) -> tuple[str, float] | None:
        """Return why noise may be all of an effect in a fit, and its deviations; or None."""
        return undetermined(
            found.evidence.gain_certainty,
            found.coefficient_deviations(fit),
            len(accepted) / len(self.candidates),
            self.options,
            _elsewhere(found.candidate, [a.candidate for a in accepted]),
        )

    def _moving(self, fit: Fit, accepted: list[Accepted]) -> tuple[Fit, list[Accepted]]:
        """Return the fit with effects by which an arm under commands moves better.

        The others are refused: a limit or a dead band may stand in the place of backlash.
        """
        while True:
            kept = self._moving_better(fit, accepted)
            if len(kept) == len(accepted):
                return fit, accepted
            self.refused |= {a.placement.label for a in accepted if a not in kept}
            fit, accepted = self._plausible(kept)

    def _moving_better(self, fit: Fit, accepted: list[Accepted]) -> list[Accepted]:
        """Return the effects without one by which an arm under commands moves no better."""
        self.gains = {}
        for found in reversed(accepted if self.unseen is not None else []):
            label, others = found.placement.label, [a for a in accepted if a is not found]
            gain = self._motion_gain(others, fit, found.joint)
            if gain is None:
                continue
            if not gain.fall > self.options.worth:
                self.rejected[label] = (
                    "the simulated motion on held-out data is no better with it (its error falls "
                    f"by {100 * gain.fall:.1f} ± {100 * gain.std:.1f} %)"
                )
                return others
            self.gains[label] = gain
        return accepted

    def _motion_gain(
        self, others: Sequence[Accepted], fit: Fit, joint: int | None = None
    ) -> MotionGain | None:
        """Compare a fit on held-out data with that of fewer effects; None if it cannot be done.

        That is of arms without commands, and with masses that are not positive, which method
        ``feasible`` excludes.
        """
        try:
            if self.unseen is None:
                return None
            return self.unseen.gain(self._fitted(others), fit, joint)
        except LieidError:
            return None

    def _accepted(self, found: Round, accepted: Sequence[Accepted]) -> list[Accepted]:
        """Return the effects of a round that pass; the reasons against the others are kept."""
        new = list[Slot]()
        candidates = {slot: found.candidate(slot.group) for slot in found.slots}
        sure = [c for slot, c in candidates.items() if slot.reason(self.options) is None]
        sure += [a.candidate for a in accepted]
        have = {a.placement.label for a in accepted}
        functions = [a.candidate for a in accepted if a.candidate.name == SMOOTH]
        for slot, candidate in candidates.items():
            if not candidate.of_arm:
                continue
            label = candidate.label
            reason = slot.reason(self.options, elsewhere=_elsewhere(candidate, sure))
            self.undecided.pop(label, None)
            if reason is not None and slot.fall >= self.options.worth and slot.deviations > 0.0:
                self.undecided[label] = slot.deviations
            errors = found.held_out_errors(slot)
            if any(_contains(function, candidate) for function in functions):
                reason = "a smooth function of its signals was found before it"
            if reason is None and label not in have and not self._agreed(label, slot.joint, errors):
                reason = "rejected by the user"
                self.refused.add(label)
            if reason is None:
                new.append(slot)
                functions += [candidate] if candidate.name == SMOOTH else []
            else:
                self.rejected[label] = reason
        groups = [slot.group for slot in new]
        return [Accepted.of(found, slot, groups, self.options) for slot in new]

    def _set_apart(self, found: Round) -> bool:
        """Keep what differs between recordings or changes, and set it apart; whether any does."""
        before = len(self.apart)
        own = {p.label for p in self.first.model.placements}
        for slot in found.slots:
            candidate = found.candidate(slot.group)
            if candidate.of_arm or slot.reason(self.options) is not None:
                continue
            of_model = candidate.placement.label in own
            self.differing.append(difference_of(found, slot, of_model=of_model))
            self.apart.append(found.rows.columns.dense(slot.group))
        return len(self.apart) > before

    def _plausible(self, added: list[Accepted]) -> tuple[Fit, list[Accepted]]:
        """Return the fit with effects of plausible values, and these effects."""
        while True:
            try:
                fit = self._fitted(added)
            except NoSolution:
                added = self._first_half(added)
                continue
            kept = self._with_plausible_values(fit, added)
            if kept == added:
                return fit, kept
            added = kept

    def _first_half(self, added: Sequence[Accepted]) -> list[Accepted]:
        """Return the effects that the path added first; the others are refused.

        Of a model that is far from its recording, a path adds so many effects that a physically
        consistent fit of them all may have no solution.
        """
        kept = list(added[: len(added) // 2])
        for found in added[len(kept) :]:
            label = found.placement.label
            self.rejected[label] = "no physically consistent fit with it was found"
            self.refused.add(label)
        return kept

    def _with_plausible_values(self, fit: Fit, added: Sequence[Accepted]) -> list[Accepted]:
        """Return the effects whose values are plausible, and what stands for a refused one.

        That are those that it replaced, or its nearest rival.
        """
        kept = list[Accepted]()
        for found in added:
            reason = self._reason_against(fit, found)
            if reason is None:
                kept.append(found)
                continue
            self.rejected[found.placement.label] = reason
            self.refused.add(found.placement.label)
            have = {a.placement.label for a in (*added, *kept)} | self.refused
            forms = (
                form
                for form in rival_forms(found, self.candidates)
                if form.placement.label not in have
                and self._agreed(form.placement.label, form.joint, form.errors)
            )
            kept += found.replaced or islice(forms, 1)
        return kept

    def _reason_against(self, fit: Fit, found: Accepted) -> str | None:
        """Return why the fitted values of an effect are implausible, or None."""
        values, shapes, _ = fitted_values(fit, found.placement)
        return reason_against(found.candidate, shapes, values, self.segments)

    def _fitted(self, added: Sequence[Accepted]) -> Fit:
        """Return the values of the first model with further effects, as `identify` fits it."""
        return self._estimated(added).fit if added else self.first

    def _complete(self, added: Sequence[Accepted]) -> Fit:
        """Return the same fit with its uncertainty."""
        if not added:
            return self.first
        key, found = frozenset(a.placement.label for a in added), self._estimated(added)
        fit = found.complete()
        self.fits[key] = Estimated(fit, lambda: fit)
        return fit

    def _estimated(self, added: Sequence[Accepted]) -> Estimated:
        key = frozenset(a.placement.label for a in added)
        if key not in self.fits:
            own = self.first.model
            placements = [*own.placements, *(a.placement for a in added)]
            effects = Model.of_placements(own.robot, placements).effects
            self.fits[key] = identify_segments(
                compile(Model(own.robot, effects=effects, library=own.library)),
                self.segments,
                method=self.method,
                known=self.known,
                temperature_mean=self.first.temperature_mean,
                provenance=self.first.provenance,
            )
        return self.fits[key]


def _elsewhere(candidate: Candidate, others: Sequence[Candidate]) -> int:
    """Return the number of other joints that have the same effect."""
    return len({c.joint for c in others if c.name == candidate.name} - {candidate.joint})


def _contains(function: Candidate, other: Candidate) -> bool:
    """Return whether an effect is a piece of the form of a function of its joint's one signal."""
    signals = own_signals(other.effect) if "time" not in other.effect.signals else ()
    return function.joints == other.joints and signals == (function.effect.option,)


def _is_limit(candidate: Candidate) -> bool:
    return candidate.name == TorqueSaturation.name


def _stage(accepted: Sequence[Accepted]) -> str:
    labels = ", ".join(a.placement.label for a in accepted)
    return f"search beside {labels}" if labels else "search"
