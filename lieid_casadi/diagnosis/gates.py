"""Which effects stay in a fit with others: an immutable state, and the gates that it passes.

A gate returns the effects of a state that have to leave, and why. The first gate at which any has
to leave counts; then the others are fitted again, with those that an effect had replaced, until all
gates are passed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import compile
from lieid_casadi.diagnosis.candidates import Candidate, is_delay, reason_against
from lieid_casadi.diagnosis.evidence import undetermined
from lieid_casadi.diagnosis.final_model import FinalModel
from lieid_casadi.diagnosis.motion import UnseenMotion
from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.step import Difference, MotionGain
from lieid_casadi.diagnosis.steps import Accepted, fitted_values, other_forms, rival_forms
from lieid_casadi.errors import LieidError, NoSolution
from lieid_casadi.identification import Fit
from lieid_casadi.identification.identify import Estimated, Method, identify_segments
from lieid_casadi.identification.regression.design_matrix import FilteredColumns
from lieid_casadi.model import Model
from lieid_casadi.recording import Processed

#: Torque of an effect in that of its joint: a spring may carry several times what the drive does;
#: more cancels that of other effects, and does so only at the speeds of the training data.
LARGEST_TORQUE = 10.0


@dataclass(frozen=True)
class Proposal:
    """An effect that is about to be added; ``before`` and ``after`` are held-out errors, N·m."""

    label: str
    joint: int
    before: float
    after: float


@dataclass(frozen=True)
class Rejection:
    """Why an effect is not in the model; in standard errors, what more data may change."""

    reason: str
    deviations: float | None = None


@dataclass(frozen=True, eq=False)
class Search:
    """What all states of a search share: the first fit, candidates by label, all fits."""

    first: Fit
    segments: tuple[Processed, ...]
    known: tuple[FilteredColumns, ...]
    candidates: Mapping[str, Candidate]
    method: Method
    options: DiagnosisOptions
    ask: Callable[[Proposal], bool] | None
    fits: dict[frozenset[str], Estimated] = field(default_factory=dict)

    def agreed(self, label: str, joint: int, errors: tuple[float, float]) -> bool:
        """Return whether the user adds an effect that changes a held-out error so, N·m."""
        return self.ask is None or self.ask(Proposal(label, joint, *errors))

    def fitted(self, added: Sequence[Accepted]) -> Fit:
        """Return the values of the first model with further effects, as `identify` fits it."""
        return self._estimated(added).fit if added else self.first

    def complete(self, added: Sequence[Accepted]) -> Fit:
        """Return the same fit with its uncertainty."""
        return self._estimated(added).complete() if added else self.first

    def reason_against(self, fit: Fit, found: Accepted) -> str | None:
        """Return why the values of an effect in a fit are implausible, or None."""
        values, shapes, _ = fitted_values(fit, found.placement)
        return reason_against(found.candidate, shapes, values, self.segments)

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


@dataclass(frozen=True, eq=False)
class State:
    """A fit with the effects that were added, and what was decided on the way, by label."""

    search: Search
    fit: Fit
    accepted: tuple[Accepted, ...] = ()
    rejected: Mapping[str, Rejection] = field(default_factory=dict)
    #: not tried again: by the user, as implausible, or the motion is no better
    refused: frozenset[str] = frozenset()
    #: what differs between recordings or in the course of one, and its columns, set apart
    differing: tuple[Difference, ...] = ()
    apart: tuple[Sequence[Array], ...] = ()
    #: of arms under commands
    unseen: UnseenMotion | None = None

    def wants(self, candidate: Candidate) -> bool:
        """Return whether a candidate may be tried; of delays of one torque the model has one."""
        late = (a.candidate for a in self.accepted if is_delay(a.candidate))
        every = candidate.reaches_all
        same = any(every or c.reaches_all or c.joints == candidate.joints for c in late)
        return candidate.label not in self.refused and not (is_delay(candidate) and same)

    def rejecting(self, rejected: Mapping[str, Rejection], *, refused: bool = False) -> State:
        """Return the state with effects rejected, which may be refused."""
        both = self.refused | frozenset(rejected if refused else ())
        return replace(self, rejected={**self.rejected, **rejected}, refused=both)

    @cached_property
    def model(self) -> FinalModel:
        """The fit's errors without single effects."""
        return FinalModel.of(self.fit, self.search.segments)

    def motion_gain(
        self, others: Sequence[Accepted], joint: int | None = None
    ) -> MotionGain | None:
        """Compare the fit on held-out data with that of fewer effects; None if it cannot be done.

        That is of arms without commands, and with masses that are not positive, which method
        ``feasible`` excludes.
        """
        try:
            if self.unseen is None:
                return None
            return self.unseen.gain(self.search.fitted(others), self.fit, joint)
        except LieidError:
            return None

    def gain_of(self, found: Accepted) -> MotionGain | None:
        """Return what the motion of its joint gains by an effect."""
        return self.motion_gain([a for a in self.accepted if a is not found], found.joint)


def elsewhere(candidate: Candidate, others: Sequence[Candidate]) -> int:
    """Return the number of other joints that have the same effect; a coupling is of two joints."""
    same = {c.joint for c in others if c.name == candidate.name and not c.effect.couples}
    return len(same - {candidate.joint})


#: Of a state, the effects that have to leave, by label.
Gate = Callable[[State], Mapping[str, Rejection]]


def undetermined_effect(state: State) -> Mapping[str, Rejection]:
    """The last effect of which noise may be all, beside the others."""
    for found in reversed(state.accepted):
        if (doubt := doubt_of(state, found)) is not None:
            return {found.placement.label: doubt}
    return {}


def doubt_of(state: State, found: Accepted) -> Rejection | None:
    """Return why noise may be all of an effect, or None."""
    doubt = undetermined(
        found.evidence.gain_certainty,
        found.coefficient_deviations(state.fit),
        len(state.accepted) / len(state.search.candidates),
        state.search.options,
        elsewhere(found.candidate, [a.candidate for a in state.accepted]),
    )
    return None if doubt is None else Rejection(*doubt)


def cancelled_torque(state: State) -> Mapping[str, Rejection]:
    """The effect with the largest torque, if others must cancel it."""
    torques = [state.model.part_of_torque(a.placement, a.joint) for a in state.accepted]
    if max(torques, default=0.0) <= LARGEST_TORQUE:
        return {}
    reason = f"its torque is {max(torques):.0f} times that of its joint: others cancel it"
    return {state.accepted[int(np.argmax(torques))].placement.label: Rejection(reason)}


def small_falls(state: State) -> Mapping[str, Rejection]:
    """Effects that lower the cross-validated error too little, one after another.

    Either of two that resemble each other may be needed. What differs between the recordings is
    part of every error; beside it an effect must lower the error at all.
    """
    left, leaving = list(state.accepted), dict[str, Rejection]()
    while left:
        gone = [a.placement for a in state.accepted if a not in left]
        falls = [state.model.fall(a.placement, a.joint, gone) for a in left]
        worst = int(np.argmin(falls))
        if falls[worst] >= (0.0 if state.apart else state.search.options.worth):
            break
        percent = f"{100 * max(falls[worst], 0.0):.1f} %"
        leaving[left.pop(worst).placement.label] = Rejection(
            f"in the final model it lowers the cross-validated error by only {percent}"
        )
    return leaving


def no_better_motion(state: State) -> Mapping[str, Rejection]:
    """The last effect by which an arm under commands moves no better."""
    for found in reversed(state.accepted):
        gain = state.gain_of(found)
        if gain is not None and not gain.fall > state.search.options.worth:
            reason = (
                "the simulated motion on held-out data is no better with it (its error falls "
                f"by {100 * gain.fall:.1f} ± {100 * gain.std:.1f} %)"
            )
            return {found.placement.label: Rejection(reason)}
    return {}


#: In this order.
GATES: tuple[Gate, ...] = (undetermined_effect, cancelled_torque, small_falls, no_better_motion)


def passed(state: State) -> State:
    """Return the state with the effects that pass all gates; those that one replaced may return."""
    while True:
        state = replace(state, fit=state.search.complete(state.accepted))
        leaving = next(filter(None, (gate(state) for gate in GATES)), None)
        if leaving is None:
            return state
        state = _without(state, leaving)


def moving(state: State) -> State:
    """Return the state with effects by which an arm under commands moves better.

    The others are refused: a limit or a dead band may stand in the place of backlash.
    """
    while leaving := no_better_motion(state):
        state = _without(state, leaving, refused=True)
    return state


def _without(state: State, leaving: Mapping[str, Rejection], *, refused: bool = False) -> State:
    """Return the state fitted again without some effects, and with those that they replaced."""
    kept = [a for a in state.accepted if a.placement.label not in leaving]
    returning = [r for a in state.accepted if a not in kept for r in a.replaced]
    return plausible(state.rejecting(leaving, refused=refused), [*kept, *returning])


def plausible(state: State, added: Sequence[Accepted]) -> State:
    """Return the state with effects of plausible values in place of its own."""
    while True:
        added = list({a.placement.label: a for a in added}.values())  # one may come back twice
        try:
            fit = state.search.fitted(added)
        except NoSolution:
            state, added = _first_half(state, added)
            continue
        state, kept = _with_plausible_values(state, fit, added)
        if kept == added:
            return replace(state, fit=fit, accepted=tuple(kept))
        added = kept


def _first_half(state: State, added: Sequence[Accepted]) -> tuple[State, list[Accepted]]:
    """Return the effects that the path added first; the others are refused.

    Of a model that is far from its recording, a path adds so many effects that a physically
    consistent fit of them all may have no solution.
    """
    kept, others = list(added[: len(added) // 2]), added[len(added) // 2 :]
    reason = Rejection("no physically consistent fit with it was found")
    return state.rejecting({a.placement.label: reason for a in others}, refused=True), kept


def _with_plausible_values(
    state: State, fit: Fit, added: Sequence[Accepted]
) -> tuple[State, list[Accepted]]:
    """Return the plausible effects of a fit, and what a refused one replaced, or its rival."""
    kept, search = list[Accepted](), state.search
    for found in added:
        reason = search.reason_against(fit, found)
        if reason is None:
            kept.append(found)
            continue
        have = {a.placement.label for a in (*added, *kept)} | state.refused
        forms = (
            form
            for form in rival_forms(found, search.candidates)
            if form.placement.label not in have
            and search.agreed(form.placement.label, form.joint, form.errors)
        )
        if found.placement.label not in state.refused:  # once: what stands for it is in already
            kept += found.replaced or islice(forms, 1)
        state = state.rejecting({found.placement.label: Rejection(reason)}, refused=True)
    return state, kept


def with_other_forms(state: State) -> State:
    """Return the state with another form of friction, or of a delay, in place of effects.

    It is better if the cross-validated errors, multiplied over the joints, are lower: with more
    parameters by what an effect must be worth, with fewer they may be higher by as much. Effects
    that are no longer plausible beside it leave.
    """
    search = state.search
    for j in range(state.fit.model.n):
        before, least = state, float(np.nanprod(state.fit.rms_cv))
        for found, replaced in other_forms(before.accepted, j, search.candidates):
            others = [*(a for a in before.accepted if a not in replaced), found]
            more = found.candidate.parameters - sum(a.candidate.parameters for a in replaced)
            other = plausible(before, others)
            error = float(np.nanprod(other.fit.rms_cv))
            error *= (1.0 - search.options.worth) ** -np.sign(more)
            if found not in other.accepted or error >= least:
                continue
            other = replace(other, fit=search.complete(other.accepted))
            errors = float(before.fit.rms_cv[j]), float(other.fit.rms_cv[j])
            if doubt_of(other, found) is None and search.agreed(found.placement.label, j, errors):
                state, least = other, error
    return state
