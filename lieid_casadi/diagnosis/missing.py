"""Which effects a model lacks: rounds of search and fit, until nothing is added."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.comparison import compare
from lieid_casadi.comparison.compare import compare_segments, compared_segments
from lieid_casadi.diagnosis.candidates import Candidate, is_delay
from lieid_casadi.diagnosis.events import leave_out_events
from lieid_casadi.diagnosis.evidence import OTHER_JOINTS, Slot
from lieid_casadi.diagnosis.final_model import FinalModel
from lieid_casadi.diagnosis.gates import (
    Proposal,
    Rejection,
    Search,
    State,
    elsewhere,
    moving,
    passed,
    plausible,
    with_other_forms,
)
from lieid_casadi.diagnosis.motion import UnseenMotion
from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.result import Diagnosis
from lieid_casadi.diagnosis.rows import Rows
from lieid_casadi.diagnosis.search import SMOOTH, Round, search
from lieid_casadi.diagnosis.smooth_functions import CONTAINED, contains, followed_signals
from lieid_casadi.diagnosis.steps import (
    Accepted,
    absorbed_and_weak,
    difference_of,
    errors_of,
    late_friction,
    over_floor,
    steps_of,
    unexplained_parts,
)
from lieid_casadi.effects.torque_saturation import TorqueSaturation
from lieid_casadi.errors import unique_warnings
from lieid_casadi.identification import Fit
from lieid_casadi.identification.fit_warnings import OF_LIMIT, OF_NUMBERS
from lieid_casadi.identification.identify import Method
from lieid_casadi.identification.recording_checks import Source
from lieid_casadi.identification.regression.design_matrix import FilteredColumns
from lieid_casadi.recording import Recording

Report = Callable[[str, float], None]
LIMIT = TorqueSaturation.name
ROUNDS = 2  # of search and fit; the second one adds what the first fit hid
HIGHER = Rejection("in a fit with it the held-out error is higher")


def diagnose_missing(
    first: Fit,
    train: Sequence[Recording],
    tests: Sequence[Recording],
    *,
    method: Method,
    options: DiagnosisOptions,
    ask: Callable[[Proposal], bool] | None,
    report: Report,
) -> Diagnosis:
    """Return the effects that a model lacks, of which ``first`` is the fit before any is added."""
    segments = compared_segments(first, train)
    known = tuple(FilteredColumns() for _ in segments)
    rows = Rows.of(first, segments, known=known)
    candidates = {c.label: c for c in rows.candidates}
    start = State(Search(first, segments, known, candidates, method, options, ask), first)
    state, last = _searched(start, rows, report)
    report("measure the effects", 0.9)
    found = _described(state, rows, last, train, tests)
    report("done", 1.0)
    return found


def _searched(state: State, rows: Rows, report: Report) -> tuple[State, Round]:
    """Return the state with all effects that are added, and the last round.

    Limits of drives come first: where a drive delivers less than its law states, all of the torque
    that the law states in addition looks like effects of the arm. What is implausible beside the
    effects of one round may not be beside those of the next one.
    """
    options, rounds, implausible = state.search.options, 0, list[Accepted]()
    if any(c.name == LIMIT for c in rows.candidates):
        found = search(rows, options, wanted=lambda c: c.name == LIMIT, with_smooth=False)
        state = replace(state, unseen=UnseenMotion.of(rows, found.folds))
        state = _with_limits(*_offered(state, found))
        if state.accepted:
            rows = _beside(state, rows)
    while True:
        labels = ", ".join(a.placement.label for a in state.accepted)
        stage = f"search beside {labels}" if labels else "search"
        report(stage, 0.1 + 0.7 * rounds / (rounds + ROUNDS))
        found = search(rows, options, wanted=state.wants)
        state, new = _offered(state, found)
        before, state = state.apart, _with_set_apart(state, found)
        rounds += 1
        state = replace(state, unseen=UnseenMotion.of(rows, found.folds))
        further = moving(plausible(state, [*state.accepted, *new, *(implausible if new else ())]))
        implausible = [a for a in new if a.placement.label in further.refused]
        kept = all(each in further.accepted for each in state.accepted)
        if kept and np.nansum(np.log(further.fit.rms_cv / state.fit.rms_cv)) > 0.0:
            further = state.rejecting({a.placement.label: HIGHER for a in new}, refused=True)
        state = further
        if rounds >= ROUNDS or not (new or len(state.apart) > len(before)):
            break
        rows = _beside(state, rows)
    state = _with_the_same_elsewhere(state, rows)
    if state.unseen is None and late_friction(found, options.worth):
        state = _with_more(state, _beside(state, rows), is_delay, late=True)
    return passed(with_other_forms(state)), found


def _beside(state: State, rows: Rows) -> Rows:
    """Return the rows of a later fit, with what differs between the recordings set apart."""
    rows = Rows.of(state.fit, state.search.segments, known=state.search.known, before=rows)
    for columns in state.apart:
        rows = rows.with_apart(columns)
    return rows


def _with_limits(state: State, found: list[Accepted]) -> State:
    """Return the state with the limits that explain most of their joint's error.

    Others compete with all effects, unless the error of the fit is higher with them: below a limit
    that acts nearly always no torque is left to be explained. A limit by which the arm moves no
    better is another effect, such as backlash.
    """
    while True:
        state = plausible(state, found)
        part = state.fit.rms_cv / state.search.first.rms_cv
        found = [a for a in state.accepted if part[a.joint] < OF_LIMIT]
        if len(found) == len(state.accepted):
            return moving(state)
        higher = [a.placement.label for a in state.accepted if part[a.joint] >= 1.0]
        state = state.rejecting(dict.fromkeys(higher, HIGHER), refused=True)


def _with_the_same_elsewhere(state: State, rows: Rows) -> State:
    """Return the state with effects that several joints have on further joints, if needed.

    Drives of one arm resemble each other. Among all candidates several others may have shared such
    an effect, so that none of them was worth it. What it does at reversals is known from the other
    joints, so that the rows near them count in full.
    """
    joints: dict[str, set[int]] = {}
    for each in state.accepted:
        joints.setdefault(each.candidate.name, set()).add(each.joint)
    common = {name for name, on in joints.items() if len(on) >= OTHER_JOINTS and name != SMOOTH}
    if not common:
        return state
    rows = _beside(state, rows).with_equal_weights()
    return _with_more(state, rows, lambda c: c.name in common and not c.reaches_all)


def _with_more(
    state: State, rows: Rows, kind: Callable[[Candidate], bool], *, late: bool = False
) -> State:
    """Return the state with what a search for effects of some kind adds.

    With ``late`` they may explain that dry friction reverses late, which nothing else explains.
    Delays lower the error whether the torque is late or the joint sticks for a moment, so that
    their names are not certain.
    """
    found = search(
        rows,
        state.search.options,
        wanted=lambda c: state.wants(c) and kind(c),
        beside_friction=not late,
        with_smooth=False,
    )
    state, new = _offered(state, found)
    new = [replace(a, doubt="late_friction") if late else a for a in new]
    return plausible(state, [*state.accepted, *new]) if new else state


def _offered(state: State, found: Round) -> tuple[State, list[Accepted]]:
    """Return the effects of a round that may be added, and the state with what rejects others."""
    new, options = list[Slot](), state.search.options
    candidates = {slot: found.candidate(slot.group) for slot in found.slots}
    have = {a.placement.label for a in state.accepted}
    earlier = [a.candidate for a in state.accepted]
    sure = [*earlier, *(c for slot, c in candidates.items() if slot.reason(options) is None)]
    rejected, refused = dict(state.rejected), set(state.refused)
    for slot, candidate in candidates.items():
        if not candidate.of_arm:
            continue
        label, joint, errors = candidate.label, slot.joint, found.held_out_errors(slot)
        reason = slot.reason(options, elsewhere=elsewhere(candidate, sure))
        deviations = slot.evidence.deviations
        weak = reason is not None and slot.fall >= options.worth and deviations > 0.0
        if any(contains(other, candidate) for other in earlier):
            reason = CONTAINED
        elif reason is None and label not in have and not state.search.agreed(label, joint, errors):
            reason = "rejected by the user"
            refused.add(label)
        if reason is None:
            new.append(slot)
            earlier.append(candidate)
            rejected.pop(label, None)
        else:
            rejected[label] = Rejection(reason, deviations if weak else None)
    groups = [slot.group for slot in new]
    accepted = [Accepted.of(found, slot, groups, options) for slot in new]
    return replace(state, rejected=rejected, refused=frozenset(refused)), accepted


def _with_set_apart(state: State, found: Round) -> State:
    """Return the state with what differs between recordings or changes, which is set apart."""
    own = {p.label for p in state.search.first.model.placements}
    for slot in found.slots:
        candidate = found.candidate(slot.group)
        if candidate.of_arm or slot.reason(state.search.options) is not None:
            continue
        new = difference_of(found, slot, of_model=candidate.placement.label in own)
        columns = found.rows.columns.dense(slot.group)
        state = replace(state, differing=(*state.differing, new), apart=(*state.apart, columns))
    return state


def _described(
    state: State,
    rows: Rows,
    last: Round,
    train: Sequence[Recording],
    every_test: Sequence[Recording],
) -> Diagnosis:
    """Return the diagnosis, whose numbers are those of the state's fit; ``rows`` are the first.

    What the effects explain in a test is neither contact nor a fault, so that it is in its errors.
    """
    search, first, fit = state.search, state.search.first, state.fit
    recorded_tests, events = leave_out_events(fit, every_test) if every_test else ([], ())
    tests = compared_segments(fit, recorded_tests) if recorded_tests else None
    final = FinalModel.of(fit, search.segments)
    after = compare(fit, recorded_tests) if recorded_tests else None

    def errors(of: Fit) -> dict[str, Array | None]:
        if tests is None:
            return errors_of(of, None)
        return errors_of(of, compare_segments(of, recorded_tests, tests, with_noise=False))

    fitted = compare(fit, train)
    last_rows = Rows.of(
        fit, search.segments, known=search.known, before=rows, with_candidates=False
    )
    baseline, options = errors(first), search.options
    trained, unseen = over_floor(fitted), over_floor(after or fitted)
    ratio, names = np.maximum(trained, unseen), ("training recordings", "test")
    where = [names[int(u > t)] if after else "" for t, u in zip(trained, unseen, strict=True)]
    steps = steps_of(final, state.accepted, last_rows, baseline, after, errors, ratio, options)
    gains = {a.placement.label: state.gain_of(a) for a in state.accepted}
    rejected = {label: r for label, r in state.rejected.items() if label not in gains}
    reasons = {label: r.reason for label, r in rejected.items()}
    spread = last_rows.spread()
    span = last_rows.span(spread)
    large, within = ratio > options.largest_error, np.zeros(len(ratio), dtype=bool)
    if after is not None and tests is not None and large.any():
        of_test = Rows.of(fit, tests, with_candidates=False)
        expected = of_test.expected_error(spread, fit.covariance)
        within = np.maximum(trained, after.rms_moving / expected) <= options.largest_error
    parts = unexplained_parts(
        ratio,
        large,
        within,
        lambda j: followed_signals(last_rows, span, j, spread),
        state.differing,
        reasons,
        where,
        {a.joint for a in state.accepted if a.candidate.effect.per_recording},
    )
    shown, late = after or fitted, {last.candidate(slot.group).label for slot in last.slots}
    limits = ("most_steps", len(last.slots) >= options.most_steps), ("rounds", gains.keys() & late)
    absorbed, weak = absorbed_and_weak(last, beside=last.rows.fit.model.placements)
    return Diagnosis(
        mode="missing",
        fit=fit,
        steps=tuple(replace(step, motion=gains[step.label]) for step in steps),
        unexplained=parts,
        differing=state.differing,
        rejected=tuple(reasons.items()),
        undecided=tuple(
            (label, r.deviations) for label, r in rejected.items() if r.deviations is not None
        ),
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
        test=tuple(Source(r.name, r.source_hash) for r in recorded_tests),
        # a joint that rests in the test alone is identified
        events=tuple(event for event in events if event.kind != "standstill"),
        motion=state.motion_gain([]),
        limits_reached=tuple(name for name, reached in limits if reached),
    )
