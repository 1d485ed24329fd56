"""What has changed since a fit: its model is kept, and new recordings are explained by additions.

The search is that for missing effects, with six differences: the fit's parameters may move within
their uncertainty only (rows of a prior), so that none is taken for a change; the noise is that of
the fit on held-out data, per independent sample; effects are searched for on joints whose error
beside such parameters is larger than on other motion; columns of delays belong to their
coefficients, since no fit follows; late friction is no rival of delays; smooth functions contain
what is linear in their signals.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.comparison import Comparison, compare
from lieid_casadi.diagnosis.candidates import Candidate, reason_against
from lieid_casadi.diagnosis.evidence import Slot, coefficient_deviations, solved, undetermined
from lieid_casadi.diagnosis.folds import independent_spread
from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.path import PathState, Span
from lieid_casadi.diagnosis.result import Diagnosis
from lieid_casadi.diagnosis.rows import Rows
from lieid_casadi.diagnosis.search import Round, rest_beside, search
from lieid_casadi.diagnosis.smooth_functions import CONTAINED, contains, followed_signals
from lieid_casadi.diagnosis.step import Fall, Step
from lieid_casadi.diagnosis.steps import (
    Accepted,
    absorbed_and_weak,
    beside_smooth_functions,
    difference_of,
    groups_of,
    step_of,
    unexplained_parts,
)
from lieid_casadi.errors import unique_warnings
from lieid_casadi.identification import Fit
from lieid_casadi.identification.prediction import center_temperature
from lieid_casadi.identification.uncertainty.covariance import (
    LEAST_KNOWN,
    prior_rows,
    with_weak_free,
)
from lieid_casadi.identification.uncertainty.noise_model import Noise
from lieid_casadi.json_numbers import number_or_none
from lieid_casadi.model import Model
from lieid_casadi.recording import Recording, process

BEYOND = 2.0  # standard deviations that parameters move, on average, if the fit's are too small


def diagnose_changed(
    fit: Fit,
    recordings: Sequence[Recording],
    *,
    options: DiagnosisOptions,
    report: Callable[[str, float], None],
) -> Diagnosis:
    """Return what has changed since a fit; see `lieid_casadi.diagnose`."""
    report("compare", 0.0)
    before = compare(fit, recordings)
    segments, _ = center_temperature(process(recordings, fit.processing), fit.temperature_mean)
    report("search for changes", 0.2)
    noise = held_out_noise(fit)
    spread = np.array([each.spread for each in noise])
    rows = Rows.of(_elsewhere(fit), segments, model_fixed=True)
    prior = prior_rows(with_weak_free(fit.covariance), known=LEAST_KNOWN)
    span = rows.span(independent_spread(noise), prior)
    raised = _raised(rows, span, span.residual, rows.residual, noise)
    found = search(
        rows,
        options,
        wanted=lambda c: c.reaches_all or bool(raised[c.joint]),
        prior=prior,
        noise=noise,
        beside_friction=False,  # a joint that sticks for a moment at reversals did so before
    )
    every, rejected = _changes(found, raised, noise, options)
    report("describe the changes", 0.8)
    changes = [c for c in every if c.candidate.of_arm]
    differing = [difference_of(found, c.slot, of_model=True) for c in every if c not in changes]
    of_noise, rest = rows.expected_error(spread, 0.0 * fit.covariance), _rest(found, every)
    misfit = _misfit(rows, noise, found.paths.span.of_joints(rest, rows.weights(found.spread)))
    ratio = np.nan_to_num(_moving(found, every, before) / of_noise)
    large = ratio > options.largest_error
    within = large & ~(misfit > options.largest_error)
    steps = _steps(found, changes, before, large & ~within, options)
    beside = replace(found.paths.span, residual=rest)
    parts = unexplained_parts(
        ratio,
        large,
        within,
        lambda j: followed_signals(rows, beside, j, found.spread),
        differing,
        rejected,
        [""] * len(ratio),
    )
    absorbed, weak = absorbed_and_weak(found)
    report("done", 1.0)
    return Diagnosis(
        mode="changed",
        fit=fit,
        steps=steps,
        unexplained=tuple(part for part in parts if not part.within),
        differing=tuple(differing),
        rejected=tuple(rejected.items()),
        noise_floor=before.noise_floor,
        noise_source=before.noise_source,
        baseline_effects=tuple(fit.model.effects),
        baseline=_errors(before, before.rms_moving),
        expected=rows.expected_error(spread, fit.covariance),
        tried=sum(c.of_arm for c in found.paths.columns.owners),
        absorbed=absorbed,
        weak=weak,
        warnings=unique_warnings([*fit.model.unusable_effects, *before.warnings]),
        train=fit.provenance.recordings,
        test=before.recordings,
        limits_reached=("most_steps",) if len(found.slots) >= options.most_steps else (),
        uncertain=tuple(part for part in parts if part.within),
    )


def _elsewhere(fit: Fit) -> Fit:
    """Return a fit as it predicts other recordings: without drifts, which hold for its own."""
    parameters = fit.parameters.copy()
    parameters[fit.model.base.kept[fit.drifting]] = 0.0
    return replace(fit, values=np.where(fit.drifting, 0.0, fit.values), parameters=parameters)


def held_out_noise(fit: Fit) -> tuple[Noise, ...]:
    """Return the noise of each joint's residual, scaled to the fit's held-out error.

    It is not estimated from the new recording, where a slow change would be attributed to the
    correlation of the noise.
    """
    ratio = np.nan_to_num(fit.rms_cv / np.maximum(fit.noise, 1e-300), nan=1.0)
    pairs = zip(fit.residual_noise, ratio, strict=True)
    return tuple(noise.times(max(float(r), 1.0)) for noise, r in pairs)


@dataclass(frozen=True, eq=False)
class _Change:
    """An accepted change, with its coefficients beside the others."""

    slot: Slot
    candidate: Candidate
    values: Array
    covariance: Array

    @property
    def deviations(self) -> float:
        """How far its coefficients are from zero, in standard deviations of the fit's noise."""
        known, tried = self.slot.evidence.independent, self.candidate.scanned
        return coefficient_deviations(self.values, self.covariance, known, tried)


def _raised(
    rows: Rows, span: Span, rest: Array, left: Sequence[Array], noise: Sequence[Noise]
) -> Mask:
    """Return the joints (n,) whose error is larger than the fit's on other motion.

    That is what parameters within their uncertainty leave, ``rest`` (R + k,) of weighted rows and
    prior; where they move beyond it, the error without this, ``left`` (R_j,) of each joint, N·m.
    """
    prior = slice(span.ends[-1], None)
    expected = span.of_prior - float(np.sum(span.basis[prior] ** 2))
    if rest[prior] @ rest[prior] <= BEYOND**2 * expected:
        left = span.of_joints(rest, rows.weights(independent_spread(noise)))
    return _misfit(rows, noise, left) > np.array([each.motion_ratio for each in noise])


def _changes(
    found: Round, raised: Mask, noise: Sequence[Noise], options: DiagnosisOptions
) -> tuple[list[_Change], dict[str, str]]:
    """Return the changes that pass, and the reasons against the others.

    They are examined together, one is left out, the last of the path first, and the others are
    examined again. A change without which none of its joints has a `_raised` error is not needed.
    """
    rejected: dict[str, str] = {}
    slots = list(found.slots)
    while True:
        changes = _fitted(found, slots)
        for change in reversed(changes):
            reason = _reason(found, changes, change, raised, noise, options)
            if reason is not None:
                rejected[change.candidate.label] = reason
                slots = [slot for slot in slots if slot is not change.slot]
                break
        else:
            return changes, rejected


def _reason(
    found: Round,
    changes: Sequence[_Change],
    change: _Change,
    raised: Mask,
    noise: Sequence[Noise],
    options: DiagnosisOptions,
) -> str | None:
    """Return why a change is left out, or None."""
    candidate, slot = change.candidate, change.slot
    reason = reason_against(candidate, *_at_best_shape(found, changes, change), found.rows.segments)
    if reason is not None:
        return reason
    if any(contains(c.candidate, candidate) for c in changes[: changes.index(change)]):
        return CONTAINED
    others = _fitted(found, [c.slot for c in changes if c is not change])
    rest, left = _rest(found, others), _left(found, others)
    still = _raised(found.rows, found.paths.span, rest, left, noise)
    if not still[found.paths.columns.reach[:, slot.group]].any():
        return "without it the error is as expected of the fit"
    fall = float(_falls(found, noise, changes, change)[raised].max(initial=-np.inf))
    if fall < options.worth_of_change:
        return f"where the error has risen, it lowers it by only {100 * max(fall, 0.0):.1f} %"
    if slot.evidence.deviations < options.gain_deviations:
        return slot.reason(options)
    part = len(changes) / sum(c.of_arm for c in found.paths.columns.owners)
    # parameters that move in its place count for the gain: it is no surer than the coefficients
    certainty = min(slot.evidence.gain_certainty, change.deviations)
    uncertain = undetermined(certainty, change.deviations, part, options)
    return None if uncertain is None else uncertain[0]


def _at_best_shape(
    found: Round, changes: Sequence[_Change], change: _Change
) -> tuple[Array, Array]:
    """Return the shapes and coefficients with which a change explains most beside the others.

    A path takes the best ones that are plausible; a fit would go on beyond them.
    """
    columns, others = found.paths.columns, (c.slot.group for c in changes if c is not change)
    own = columns.owner == columns.owner[change.slot.group]
    gains, values = reduce(PathState.with_group, others, found.paths.state(-1)).gains(own)
    best = int(np.argmax(np.where(own, gains, -1.0)))
    return columns.shapes(best), values[columns.of_group(best)]


def _fitted(found: Round, slots: Sequence[Slot]) -> list[_Change]:
    """Return changes with coefficients fitted together, within the fit's uncertainty."""
    if not slots:
        return []
    columns = [found.paths.outside(slot.group) for slot in slots]
    together = np.hstack(columns)
    gram = together.T @ together
    values = solved(gram, together.T @ found.paths.span.residual)
    covariance = np.asarray(np.linalg.pinv(gram, hermitian=True), dtype=float)
    places = np.split(np.arange(len(gram)), np.cumsum([c.shape[1] for c in columns])[:-1])
    return [
        _Change(slot, found.candidate(slot.group), values[own], covariance[np.ix_(own, own)])
        for slot, own in zip(slots, places, strict=True)
    ]


def _falls(found: Round, noise: Sequence[Noise], changes: Sequence[_Change], one: _Change) -> Array:
    """Return the relative fall (n,) of each joint's error that the torque of a change causes.

    Of the model within its uncertainty and with all changes, the error is compared with what it
    is without the torque of the one. So neither an error that the uncertain parameters explain
    hides a change, nor do these parameters take the place of its torque.
    """
    span, weights = found.paths.span, found.rows.weights(found.spread)
    rest = span.of_joints(_rest(found, changes), weights)
    torque = found.rows.columns.stacked(one.slot.group) @ one.values
    parts = np.split(torque, span.ends[1:-1])
    before = _misfit(found.rows, noise, [r + t for r, t in zip(rest, parts, strict=True)])
    after = _misfit(found.rows, noise, rest)
    return 1.0 - np.divide(after, before, out=np.ones(len(after)), where=before > 0.0)


def _rest(found: Round, changes: Sequence[_Change]) -> Array:
    """Return what changes and uncertain parameters leave of weighted rows and prior (R + k,)."""
    outside = found.paths.all_outside([c.slot.group for c in changes])
    return rest_beside(found.paths.span, outside)


def _left(found: Round, changes: Sequence[_Change]) -> list[Array]:
    """Return what the torques of changes leave of each joint's residual (R_j,), N·m."""
    torques = (found.rows.columns.stacked(c.slot.group) @ c.values for c in changes)
    whole = np.concatenate(found.rows.residual)
    left = whole - sum(torques, start=np.zeros(len(whole)))
    return np.split(left, found.paths.span.ends[1:-1])


def _misfit(rows: Rows, noise: Sequence[Noise], errors: Sequence[Array]) -> Array:
    """Return the RMS of each joint's errors (R_j,) over the noise's (n,), also at reversals."""
    spread = np.array([each.spread for each in noise])
    return _rms([e * w for e, w in zip(errors, rows.weights(spread), strict=True)])


def _rms(errors: Sequence[Array]) -> Array:
    """Return the RMS of each joint's errors (R_j,); NaN without rows."""
    return np.array([np.sqrt(np.mean(own**2)) if len(own) else np.nan for own in errors])


def _steps(
    found: Round,
    changes: Sequence[_Change],
    before: Comparison,
    over: Mask,
    options: DiagnosisOptions,
) -> tuple[Step, ...]:
    """Return the steps; ``before`` compares the fit, joints ``over`` (n,) stay unexplained."""
    slots = [c.slot.group for c in changes]
    accepted = [Accepted.of(found, c.slot, slots, options) for c in changes]
    groups, steps = groups_of(accepted), list[Step]()
    for k, (change, own) in enumerate(zip(changes, accepted, strict=True)):
        without = _fitted(found, [c.slot for c in (*changes[:k], *changes[k + 1 :])])
        so_far = _fitted(found, [c.slot for c in changes[: k + 1]])
        falls = [float(_moving(found, of, before)[own.joint]) for of in (without, changes)]
        steps.append(
            step_of(
                own,
                _numbers(found, change, without),
                before=falls[0],
                after=falls[1],
                unexplained=over,
                fall=Fall(None, None, number_or_none(falls[0] - falls[1])),
                torque=found.rows.torque[own.joint],
                group=groups[k],
                deviations=change.deviations,
                errors=_errors(before, _moving(found, so_far, before)),
            )
        )
    return beside_smooth_functions(steps)


def _moving(found: Round, changes: Sequence[_Change], before: Comparison) -> Array:
    """Return the errors in motion (n,) with changes, relative to those of the fit as the rows."""
    with_changes, without = (_rms(_left(found, of)) for of in (changes, ()))
    return np.asarray(before.rms_moving * with_changes / np.maximum(without, 1e-300))


def _errors(before: Comparison, moving: Array) -> dict[str, Array | None]:
    """Return the errors of a model on new recordings, as `Step.errors`, by those in motion.

    At rest, where friction is undetermined, its error counts as that of the fit.
    """
    fallen = (1.0 - before.at_rest) * (before.rms_moving**2 - moving**2)
    of_all = np.sqrt(np.maximum(before.rms**2 - np.nan_to_num(fallen), 0.0))
    return {"rms_train": None, "rms_test": of_all, "rms_test_moving": moving, "rms_cv": None}


def _numbers(
    found: Round, change: _Change, others: Sequence[_Change]
) -> dict[str, tuple[float, float, str]]:
    """Return value, standard deviation and unit of each parameter of a change by name.

    A single shape is uncertain by the columns at its neighbours on the grid, and by half the ways.
    """
    columns, group, outside = found.paths.columns, change.slot.group, found.paths.outside
    alone = Model.of_placements(found.rows.fit.model.robot, (change.candidate.placement,))
    shapes = columns.shapes(group)[: len(alone.shapes)]
    variances = np.append(np.diag(change.covariance), np.full(len(shapes), np.nan))
    first = max(group - 1, 0)
    near = first + np.flatnonzero(columns.owner[first : group + 2] == columns.owner[group])
    if len(shapes) == 1 and len(near) > 1:
        less, more = (outside(int(g)) @ change.values for g in (near[0], near[-1]))
        width = float(np.ptp([columns.shapes(int(g))[0] for g in near]))
        beside = [outside(c.slot.group) for c in others]
        together = np.column_stack([*beside, outside(group), (more - less) / width])
        every = np.diag(np.linalg.pinv(together.T @ together, hermitian=True))
        variances = every[-len(variances) :].copy()
        variances[-1] += (width / (len(near) - 1)) ** 2 / 12.0
    std = np.sqrt(np.maximum(variances, 0.0))
    parameters = zip([*alone.columns, *alone.shapes], [*change.values, *shapes], std, strict=True)
    return {p.name.rpartition(".")[2]: (float(v), float(s), p.unit) for p, v, s in parameters}
