"""From what a search accepted to the steps of a diagnosis, with the numbers of the final fit."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.comparison import Comparison
from lieid_casadi.diagnosis.candidates import Candidate, follows_velocity, is_delay, is_form
from lieid_casadi.diagnosis.evidence import Slot, coefficient_deviations
from lieid_casadi.diagnosis.final_model import FinalModel
from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.rivals import rivals_of
from lieid_casadi.diagnosis.rows import Rows
from lieid_casadi.diagnosis.search import SMOOTH, Round, in_span
from lieid_casadi.diagnosis.smooth_functions import formula_of, named_column, own_signals
from lieid_casadi.diagnosis.step import (
    Difference,
    Doubt,
    Evidence,
    Fall,
    Rival,
    Status,
    Step,
    Unexplained,
)
from lieid_casadi.effects import ArmEffect, Placement
from lieid_casadi.errors import LateFrictionWarning
from lieid_casadi.identification import Fit
from lieid_casadi.identification.regression.least_squares import WEAK
from lieid_casadi.json_numbers import number_or_none

ABSORBED = 1e-6  # part of a column outside the model's span, below which the model imitates it


@dataclass(frozen=True, eq=False)
class Accepted:
    """An effect that the search adds, with what the held-out parts say of it.

    ``errors``: held-out RMS errors of its joint without it and with it, N·m.
    ``doubt``: why its name is not certain, rivals aside.
    ``replaced``: the effects in whose place it is.
    """

    candidate: Candidate
    joint: int
    evidence: Evidence
    rivals: tuple[Rival, ...]
    doubt: Doubt
    errors: tuple[float, float]
    replaced: tuple[Accepted, ...] = ()

    @classmethod
    def of(
        cls, found: Round, slot: Slot, groups: Sequence[int], options: DiagnosisOptions
    ) -> Accepted:
        """Return an effect of a round beside groups that are accepted with it."""
        candidate = found.candidate(slot.group)
        others = [g for g in groups if g != slot.group]
        near = rivals_of(found, slot, others, options.rival_deviations)
        rivals = tuple(rival for g, rival in near if found.candidate(g).of_arm)
        return cls(
            candidate,
            slot.joint,
            slot.evidence,
            rivals,
            _doubt(candidate, slot, options, sudden=len(rivals) < len(near)),
            found.held_out_errors(slot),
        )

    @property
    def status(self) -> Status:
        """What may be said of its name."""
        if self.candidate.name == SMOOTH:
            return "shape"
        return "one_of" if self.rivals or self.doubt else "named"

    def replaced_by(self, other: Candidate, all_replaced: Sequence[Accepted]) -> Accepted:
        """Return the same with another effect, in the place of several."""
        rivals = tuple(rival for rival in self.rivals if rival.effect != other.name)
        return replace(self, candidate=other, rivals=rivals, replaced=tuple(all_replaced))

    @property
    def placement(self) -> Placement:
        """Where it acts."""
        return self.candidate.placement

    def coefficient_deviations(self, fit: Fit) -> float:
        """Return how far its coefficients in a fit are from zero, or NaN without any."""
        own = [k for k, p in enumerate(fit.model.base_columns) if p.belongs_to(self.placement)]
        covariance = fit.covariance[np.ix_(own, own)]
        if not own or not np.isfinite(covariance).all():
            return float("nan")
        known, tried = self.evidence.independent, self.candidate.scanned
        return coefficient_deviations(fit.values[own], covariance, known, tried)


def _doubt(candidate: Candidate, slot: Slot, options: DiagnosisOptions, *, sudden: bool) -> Doubt:
    """Return why a name is not certain, if so; ``sudden``: a change at one instant would do."""
    # without a part of the data something else was in its place, or nothing
    if slot.evidence.selected < 1.0:
        return "selected"
    if slot.evidence.gain_certainty < options.name_deviations:
        return "gain"
    if sudden:
        return "instant"
    # signals of drives are late; friction at reversals of another form looks early on one joint
    if is_delay(candidate) and candidate.joints and slot.values[0] < 0.0:
        return "lead"
    return ""


def fitted_values(
    fit: Fit, placement: Placement
) -> tuple[Array, Array, dict[str, tuple[float, float, str]]]:
    """Return coefficients and shapes of an effect in a fit, and value, std and unit by name."""
    effect = placement.effect
    numbers = np.concatenate([fit.values, fit.shapes])
    found = {
        p.name.rpartition(".")[2]: (float(value), float(std), p.unit)
        for p, value, std in zip(fit.fitted, numbers, fit.std, strict=True)
        if p.belongs_to(placement)
    }
    values = [found[c.name][0] if c.name in found else np.nan for c in effect.coefficients]
    shapes = [found[s.name][0] if s.name in found else np.nan for s in effect.shapes]
    return np.array(values), np.array(shapes), found


def steps_of(
    final: FinalModel,
    accepted: Sequence[Accepted],
    rows: Rows,
    first: dict[str, Array | None],
    tested: Comparison | None,
    errors: Callable[[Fit], dict[str, Array | None]],
    ratio: Array,
    options: DiagnosisOptions,
) -> tuple[Step, ...]:
    """Return the steps of a final model: every number is that of its fit.

    ``accepted`` is in the order of the path, ``rows`` are those of the final fit, ``first`` has the
    errors of the first model (see `errors_of`), ``tested`` compares the final fit with the test,
    ``errors`` gives those of another, and ``ratio`` (n,) is its error over the noise floor. Without
    its only effect the final model is the first one.
    """
    fit = final.fit
    columns = [final.columns_of([a.placement]) for a in accepted]
    groups, none = groups_of(accepted), np.array([], dtype=np.intp)
    complete, steps = errors_of(fit, tested), list[Step]()
    trained = any(map(fit.provenance.contains, tested.recordings if tested else ()))
    for k, found in enumerate(accepted):
        deviations = found.coefficient_deviations(fit)
        if found.status == "named" and deviations < options.name_deviations:
            found = replace(found, doubt="coefficients")
        others = (a.candidate for a in found.replaced)
        replaced = tuple(Rival(c.label, c.name, c.joints, "data") for c in others)
        later = columns[k + 1 :]
        so_far = errors(final.without(np.concatenate(later))) if later else complete
        without, j = first if len(accepted) == 1 else errors(final.without(columns[k])), found.joint
        train = final.rms_moving(columns[k]) - final.rms_moving(none)
        both = [(without[name], complete[name]) for name in ("rms_cv", "rms_test_moving")]
        falls = (None if b is None or a is None else number_or_none(b[j] - a[j]) for b, a in both)
        fall = Fall(float(train[j]), *falls)
        if found.candidate.effect.per_recording or trained:  # the test has another drift
            fall = replace(fall, test=None)
        after, before = (float(fit.rms_cv[j]) + more for more in (0.0, fall.cv or 0.0))
        step = step_of(
            found,
            fitted_values(fit, found.placement)[2],
            before=before,
            after=after,
            unexplained=ratio > options.largest_error,
            fall=fall,
            torque=rows.torque[j],
            group=groups[k],
            deviations=deviations,
            errors=so_far,
        )
        formula = ""
        if found.status == "shape":
            formula = formula_of(rows, found.placement, columns[k], fit.values[columns[k]])
        steps.append(replace(step, formula=formula, rival_pairs=(replaced,) if replaced else ()))
    return beside_smooth_functions(steps)


def step_of(
    found: Accepted,
    numbers: Mapping[str, tuple[float, float, str]],
    *,
    before: float,
    after: float,
    unexplained: Mask,
    fall: Fall,
    torque: Array,
    group: int,
    deviations: float,
    errors: dict[str, Array | None],
) -> Step:
    """Return the step of an effect with value, standard deviation and unit of its parameters.

    ``torque`` (R,) is the measured one of its joint, N·m, and ``deviations`` those of its
    coefficients from zero. If its joint stays ``unexplained`` (n,), and it explains less than is
    left, its name is not certain.
    """
    if unexplained[found.joint] and found.status == "named" and before**2 < 2.0 * after**2:
        found = replace(found, doubt="rest")
    explained, size = np.sqrt(max(before**2 - after**2, 0.0)), float(torque @ torque)
    effect = found.placement.effect
    signals = effect.option.split(".") if effect.name == SMOOTH else []
    return Step(
        label=found.placement.label,
        effect=effect.name,
        joints=found.candidate.joints,
        joint=found.joint,
        status=found.status,
        parameters={name: value for name, (value, _, _) in numbers.items()},
        std={name: std for name, (_, std, _) in numbers.items()},
        units={name: unit for name, (_, _, unit) in numbers.items()},
        before=before,
        after=after,
        fall=fall,
        share=float(explained / np.sqrt(size / len(torque))) if size > 0.0 else float("nan"),
        evidence=replace(found.evidence, coefficient_deviations=deviations),
        doubt=found.doubt,
        rivals=found.rivals,
        group=group,
        depends_on=tuple(named_column(signal, found.joint) for signal in signals),
        errors=errors,
    )


def errors_of(fit: Fit, compared: Comparison | None) -> dict[str, Array | None]:
    """Return the errors of a fit by name; see `Step.errors`."""
    return {
        "rms_train": fit.rms_train,
        "rms_test": None if compared is None else compared.rms,
        "rms_test_moving": None if compared is None else compared.rms_moving,
        "rms_cv": fit.rms_cv,
    }


def beside_smooth_functions(steps: Sequence[Step]) -> tuple[Step, ...]:
    """Return steps, in the order of the path, with the status of those beside smooth functions.

    Beside a smooth function of its joint that was found before it, or lowers the error more than
    it does, the form of an effect's torque is not known. Another later, smaller one corrects it.
    """
    found = list[Step]()
    for k, step in enumerate(steps):
        doubts = [
            other for i, other in enumerate(steps)
            if other.status == "shape" and other.joint == step.joint
            and (i < k or other.before - other.after >= step.before - step.after)
        ]  # fmt: skip
        if step.status == "named" and doubts:
            rivals = (Rival(doubts[-1].label, SMOOTH, doubts[-1].joints, "data"),)
            step = replace(step, status="one_of", rivals=rivals)
        found.append(step)
    return tuple(found)


def groups_of(accepted: Sequence[Accepted]) -> list[int]:
    """Return the group of each effect, from 1: the same effect on single joints is one group."""
    names = [
        a.candidate.name
        if len(a.candidate.joints) == 1 and a.candidate.name != SMOOTH
        else a.placement.label
        for a in accepted
    ]
    order = list(dict.fromkeys(names))
    return [order.index(name) + 1 for name in names]


def difference_of(found: Round, slot: Slot, *, of_model: bool) -> Difference:
    """Return an effect that acts in one recording only, or changes in the course of one.

    Its standard deviations are those of a least-squares fit of the whole path.
    """
    candidate, values, j = found.candidate(slot.group), slot.values, slot.joint
    others = (s.group for s in found.slots if s is not slot)
    together = np.hstack(found.paths.all_outside([slot.group, *others]))
    variances = np.diag(np.linalg.pinv(together.T @ together, hermitian=True))[: len(values)]
    kept, independent = found.paths.span.of_prior, max(int(found.folds.independent[j]), 1)
    lasting = 1.0 if kept else found.rows.runs[j].count / independent  # rows
    std = np.sqrt(lasting * np.maximum(variances, 0.0))
    since = period = None
    signals: tuple[str, ...] = ()
    if candidate.course is not None:
        at = float(candidate.course.at[found.paths.columns.point[slot.group]])
        if candidate.course.kind == "later" and candidate.recording is not None:
            at += float(found.rows.starts[candidate.recording])
        since, period = (at if candidate.course.kind == k else None for k in ("later", "wave"))
        own = own_signals(candidate.effect)
        signals = ("t", *(named_column(s, candidate.joint) for s in own))
        if period is not None:
            values, std = (np.hypot(*np.split(x, 2)) for x in (values, std / np.sqrt(2.0)))
    names, part = [c.name for c in candidate.effect.coefficients], candidate.recording
    return Difference(
        candidate.placement.label,
        candidate.name,
        candidate.joints,
        "each recording" if part is None else found.rows.recording_names[part],
        dict(zip(names, map(float, values), strict=True)),
        dict(zip(names, map(float, std), strict=True)),
        {c.name: c.unit for c in candidate.effect.coefficients},
        of_model,
        since,
        period,
        1.0 - float(slot.after.sum() / slot.before.sum()),
        signals,
    )


def over_floor(compared: Comparison) -> Array:
    """Return each joint's error in motion over the noise floor (n,), 0 where one is not known."""
    ratio, floor = np.zeros_like(compared.rms_moving), compared.noise_floor
    np.divide(compared.rms_moving, floor, out=ratio, where=floor > 0.0)
    return np.nan_to_num(ratio)


def unexplained_parts(
    ratio: Array,
    large: Mask,
    within: Mask,
    follows: Callable[[int], tuple[str, ...]],
    differing: Sequence[Difference],
    rejected: Mapping[str, str],
    where: Sequence[str],
    drifting: Collection[int] = (),
) -> tuple[Unexplained, ...]:
    """Return the joints whose error in motion is ``large``, or changes with time.

    ``ratio`` (n,) is the error relative to the noise, ``within`` (n,) whether the uncertainty of
    the parameters explains it, ``follows`` gives the signals that the residual of a joint follows,
    ``differing`` are changes of effects of the model, ``rejected`` has candidates that were not
    added, and why, ``where`` the recordings by joint, and ``drifting`` the joints with a drift.
    """
    changing = {each.joints[0]: each for each in differing if each.depends_on}
    first = [int(j) for j in np.argsort(-ratio) if large[j]]
    found = []
    for j in dict.fromkeys([*changing, *first]):
        here = {k for k in rejected if k.partition(":")[2].partition("<")[0] == f"{j + 1}"}
        own = tuple((k, why) for k, why in rejected.items() if k in here)
        fraction = float(1.0 - ratio[j] ** -2) if large[j] else changing[j].fraction
        signals = changing[j].depends_on if j in changing else follows(j)
        differs = any(each.joints == (j,) for each in differing) or j in drifting
        kinds = bool(large[j]), differs, bool(within[j])
        found.append(Unexplained(j, fraction, float(ratio[j]), signals, own, where[j], *kinds))
    return tuple(found)


def absorbed_and_weak(
    found: Round, beside: Sequence[Placement] = ()
) -> tuple[tuple[str, ...], tuple[tuple[str, float], ...]]:
    """Return the candidates that the model spans, and those that it nearly spans.

    The model's own effects ``beside`` are none of them, although it spans them.
    """
    columns, whole = found.paths.columns, found.paths.whole
    own_labels = {placement.label for placement in beside}
    remaining = np.zeros(len(columns.owners))
    for (groups, own), gram in zip(columns.by_size, columns.within(whole.inner), strict=True):
        norms = found.paths.norms[own]
        left = np.sqrt(np.clip(np.einsum("gkk->gk", gram), 0.0, None) / np.maximum(norms, 1e-300))
        np.maximum.at(remaining, columns.owner[groups], left.max(axis=1))
    parts = {
        c.label: float(part)
        for c, part in zip(columns.owners, remaining, strict=True)
        if c.of_arm and c.label not in own_labels
    }
    return (
        tuple(k for k, part in parts.items() if part < ABSORBED),
        tuple((k, part) for k, part in parts.items() if ABSORBED <= part < WEAK),
    )


def late_friction(found: Round, worth: float) -> list[LateFrictionWarning]:
    """Return one warning if dry friction reverses late beside the model, else none.

    It is stated where it lowers the error of a joint by ``worth``, relative to it.
    """
    span, rest, late = found.paths.span, found.paths.span.residual, []
    changes = in_span(span, found.rows.shifted_friction(), found.rows.weights(found.spread))
    for j, outside in enumerate(span.outside(changes).T):
        size, total = float(outside @ outside), float(rest[span.joint(j)] @ rest[span.joint(j)])
        if size <= 0.0 or total <= 0.0:
            continue
        delay = float(outside @ rest) / size
        fall = 1.0 - np.sqrt(max(1.0 - delay**2 * size / total, 0.0))
        if delay > 0.0 and fall > worth:
            late.append(f"joint {j + 1} ({1e3 * delay:.2g} ms)")
    text = (
        f"dry friction reverses later than the velocity: {', '.join(late)}. A joint may stick for "
        "a moment at reversals, or its torque signal may be delayed; only fast changes of torque "
        "away from reversals distinguish the two"
    )
    return [LateFrictionWarning(text)] if late else []


def other_forms(
    accepted: Sequence[Accepted], joint: int, candidates: Mapping[str, Candidate]
) -> list[tuple[Accepted, list[Accepted]]]:
    """Return effects that may be better than some on a joint, and those in whose place they are.

    These are the variants of friction over speed for all of it, where a variant of what is computed
    along the arm takes the place of its kind only, and for all delays of a joint, or of the arm,
    each of their rivals: hysteresis, filters and delays are alike between the points of grids.
    """
    own, found = [a for a in accepted if a.joint == joint], []
    speed = [a for a in own if follows_velocity(a.candidate.effect)]
    for form in (c for c in candidates.values() if is_form(c.effect) and c.joint == joint):
        same = [a for a in own if a.candidate.name == form.name]
        alike = same if isinstance(form.effect, ArmEffect) else speed
        if alike:
            found.append(([*same, *alike][0].replaced_by(form, alike), alike))
    delays = [a for a in accepted if is_delay(a.candidate)]
    for delay in (a for a in delays if a.joint == joint):
        same = [a for a in delays if a.candidate.joints == delay.candidate.joints]
        others = {a.placement.label for a in accepted if a not in same}
        rivals = (r for r in rival_forms(delay, candidates) if r.placement.label not in others)
        found += [(replace(other, replaced=(delay,)), same) for other in rivals]
    return found


def rival_forms(found: Accepted, candidates: Mapping[str, Candidate]) -> list[Accepted]:
    """Return the rivals of an effect in its place, nearest first; it is a rival of theirs."""
    mine, forms = found.candidate, []
    itself = Rival(mine.label, mine.name, mine.joints, "data")
    for rival in found.rivals:
        if rival.joints == mine.joints and rival.label in candidates:
            form = found.replaced_by(candidates[rival.label], ())
            forms.append(replace(form, rivals=(itself, *form.rivals)))
    return forms
