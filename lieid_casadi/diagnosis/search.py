"""One round of the search: paths on all rows and inside each held-out part, and their verdicts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from itertools import accumulate

import numpy as np

from lieid_casadi.arrays import Array, Indices
from lieid_casadi.diagnosis.candidates import Candidate, Course, CourseKind, is_form, reason_against
from lieid_casadi.diagnosis.columns import Columns
from lieid_casadi.diagnosis.evidence import Slot, fall_of, gains_of, judge, solved
from lieid_casadi.diagnosis.folds import Folds, folds_of, independent_spread, redundancy
from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.path import Paths, PathState, Rules, Span, forward
from lieid_casadi.diagnosis.rows import Rows
from lieid_casadi.diagnosis.smooth_functions import cost_of, functions_alike, smooth_candidates
from lieid_casadi.effects.coulomb import Coulomb
from lieid_casadi.effects.offset import Offset
from lieid_casadi.effects.smooth import Smooth
from lieid_casadi.identification.uncertainty.noise_model import Noise, noise_of

SMOOTH = Smooth.name
REFINEMENT = (1 / 3, 2 / 3)  # positions between two grid points
MOST_REFINEMENTS = 6  # passes, each with a third of the steps of the one before
PROMISING = 0.5  # of its penalty that a group must gain to be in the paths outside held-out parts
EARLY = 0.01  # s: MuJoCo opposes the velocity that a joint has so much later, by default
#: What dry friction may do beside the model, by the names that effects have for it.
UNCERTAIN_FRICTION: dict[str, Callable[[Rows], Sequence[Array]]] = {
    "late": lambda rows: rows.shifted_friction(),
    "early": lambda rows: rows.shifted_friction(EARLY),
    "rest": lambda rows: rows.friction_at_rest,
}
#: Effects of the model that may change in the course of a recording, at one of some instants or as
#: waves with one of some periods. What viscous friction does so resembles dry friction.
COURSES: tuple[tuple[tuple[str, ...], CourseKind, int], ...] = (
    ((Coulomb.name, Offset.name), "later", 20),
    ((Offset.name,), "wave", 9),
)
FINER = 19  # instants or periods between the neighbours of one
LEAST_CHANGE = 5.0  # size of a change with time in standard deviations, for a path
#: Certainty of a change, in that of a name. Held-out parts are between others, so that slow noise
#: of short recordings is predicted, too: waves in noise that is correlated over 1 s reach 5.8
#: standard errors in 82 arms without changes, changes at an instant 2.3.
CERTAINTY = {"later": 1.0, "wave": 2.0}
LEAST_RIVAL = 0.5  # of the gain of a group of the path: rivals from here are refined, too


@dataclass(frozen=True, eq=False)
class Round:
    """What a round of the search found."""

    #: with the grids that were refined
    rows: Rows
    #: (n,): standard deviation by which rows are weighted, N·m: of the residual beside the path,
    #: or the given noise's per independent sample
    spread: Array
    folds: Folds
    paths: Paths
    #: the effects of the path on all rows, in its order
    slots: tuple[Slot, ...]
    #: (G,): what each group costs in a path
    penalty: Array

    def candidate(self, group: int) -> Candidate:
        """Return the candidate of a group."""
        return self.paths.columns.candidate(group)

    def held_out_errors(self, slot: Slot) -> tuple[float, float]:
        """Return the held-out RMS error of an effect's joint without it and with it, N·m."""
        j = slot.joint
        scale = self.spread[j] / np.sqrt(max(self.rows.runs[j].count, 1))
        before, after = (scale * np.sqrt(squares.sum()) for squares in (slot.before, slot.after))
        return float(before), float(after)


def search(
    rows: Rows,
    options: DiagnosisOptions,
    *,
    wanted: Callable[[Candidate], bool],
    prior: Array | None = None,
    noise: Sequence[Noise] | None = None,
    beside_friction: bool = True,
    with_smooth: bool = True,
) -> Round:
    """Return the effects of a path on all rows, judged on held-out parts.

    ``wanted`` chooses the candidates, ``prior`` (k, p) are rows that state the uncertainty of a
    model that is kept, ``noise`` that of each joint (by default that of the residual beside the
    path). Without ``beside_friction`` a delay may explain what late friction does; ``with_smooth``
    adds smooth functions, and changes in the course of a recording, to the candidates.
    """
    # smooth functions are chosen anew for every residual
    rows = rows.with_candidates([c for c in rows.candidates if c.name != SMOOTH and wanted(c)])
    scale = rows.spread()
    if noise is not None:  # in the unit of the prior: per independent sample
        scale = independent_spread(noise)
    rests = list[list[Array]]()
    for k in range(MOST_REFINEMENTS):  # on the first grid, then on finer ones around what it chose
        paths = Paths(rows.span(scale, prior), rows.columns.weighted(rows.weights(scale)))
        rules = _rules(paths.columns, rows, options)
        whole = forward(paths, -1, rules)
        rests = [residual_beside(paths, groups, rows, scale) for groups in (whole, ())]
        if noise is None:
            scale = rows.spread(rests[0])
        rows = rows.with_candidates(_refined(paths, whole, rows))
        if k and not _coarse(paths, whole, float(rules.penalty.min(initial=np.inf))):
            break
    if with_smooth:
        span = rows.span(scale, prior)
        smooth = smooth_candidates(rows, span, rests, scale, whole=prior is not None)
        known = {c.label: c for c in smooth if wanted(c)}
        rows = rows.with_candidates([*rows.columns.owners, *known.values()])
    rows = _with_changes(rows, wanted, in_course=with_smooth)
    paths = Paths(rows.span(scale, prior), rows.columns.weighted(rows.weights(scale)))
    coarse, leaving = True, set[int]()
    while True:
        own_noise = noise
        if own_noise is None:
            first = forward(paths, -1, _rules(paths.columns, rows, options, leaving=leaving))
            rest = residual_beside(paths, first, rows, scale)
            own_noise = [noise_of(r, run) for r, run in zip(rest, rows.runs, strict=True)]
        dependence = _dependence(paths.columns, own_noise, independent=noise is not None)
        rules = _rules(paths.columns, rows, options, dependence, leaving)
        ways = [forward(paths, -1, rules, smooth_first=j) for j in ((), range(len(rows.runs)))]
        finer = _finer_courses(rows, dict.fromkeys(sum(ways, ()))) if coarse else []
        if finer:
            rows, coarse = replace(rows, columns=rows.columns.joined(finer)), False
            paths = Paths(rows.span(scale, prior), rows.columns.weighted(rows.weights(scale)))
            continue
        folds, slots = _judged(
            paths, ways, rules, dependence, rows, scale, options, beside_friction
        )
        if not (more := _leaving(paths.columns, slots, options)):
            return Round(rows, scale, folds, paths, slots, rules.penalty)
        leaving |= more


def _judged(
    paths: Paths,
    chosen: Sequence[tuple[int, ...]],
    rules: Rules,
    dependence: Array,
    rows: Rows,
    spread: Array,
    options: DiagnosisOptions,
    beside_friction: bool,
) -> tuple[Folds, tuple[Slot, ...]]:
    """Return the held-out parts, and the effects of the path on all rows as these judge it.

    Of the two paths ``chosen``, smooth functions come first in the second one. They do on the
    joints where both are alike, where the error of held-out parts is lower so, or where only so
    anything lowers it: many effects of the library together resemble a torque that none describes.
    Where fewer effects are supported so, any lower error is enough.
    """
    whole, other = chosen
    folds = folds_of(rows, residual_beside(paths, whole, rows, spread), options.folds)
    kept = _promising(paths, chosen, rules)
    few = Paths(paths.span, paths.columns.of_groups(kept), folds.out)
    of_few = _rules(few.columns, rows, options, dependence[kept])
    kinds = {kind for c in rows.columns.owners for kind in c.effect.like_uncertain_friction}
    friction = {
        kind: in_span(paths.span, UNCERTAIN_FRICTION[kind](rows), rows.weights(spread))
        for kind in sorted(kinds if beside_friction else ())
    }
    judged = partial(judge, paths, folds, friction=friction)

    def outside(smooth_first: Collection[int]) -> list[list[int]]:
        found = (forward(few, k, of_few, smooth_first=smooth_first) for k in range(folds.count))
        return [kept[list(path)].tolist() for path in found]

    first = {paths.columns.candidate(g).joint for g in other if rules.smooth[g]}
    alike = first - {paths.columns.candidate(g).joint for g in {*whole} ^ {*other}}
    if alike == first:
        return folds, judged(whole, outside(first))[0]
    so, after = judged(other, outside(first))
    slots, before = judged(whole, outside(alike))
    plain, smooth = _supported(slots, options), _supported(so, options)
    needed = {paths.columns.candidate(g).joint for g in {*whole} & {*other} if rules.smooth[g]}
    fall = gains_of if paths.span.of_prior else fall_of  # the first as in `shortened`
    lower = [np.sum(fall(b, a)) > 0.0 for b, a in zip(before.T, after.T, strict=True)]
    better = alike | {j for j in first if smooth[j] and not plain[j]}
    better |= {j for j in first if lower[j] and 0 < smooth[j] < plain[j] + (j in needed)}
    better |= {j for j in first if _lowers(before[:, j], after[:, j], folds, j, options)}
    if better == first:
        return folds, so
    if better != alike:
        slots, _ = judged(forward(paths, -1, rules, smooth_first=better), outside(better))
    return folds, slots


def _supported(slots: Sequence[Slot], options: DiagnosisOptions) -> Counter[int]:
    """Return the number of effects on each joint that the held-out parts support."""
    return Counter(slot.joint for slot in slots if slot.reason(options) is None)


def _lowers(before: Array, after: Array, folds: Folds, j: int, options: DiagnosisOptions) -> bool:
    """Return whether the squared errors (K,) of held-out parts fall by more than their scatter."""
    gains = gains_of(before, after)
    certain, _ = folds.deviations(gains, np.ones(len(gains)), j)
    return fall_of(before, after) >= options.worth and certain > options.gain_deviations


def _promising(paths: Paths, chosen: Sequence[Sequence[int]], rules: Rules) -> Indices:
    """Return the groups that come near to their penalty beside some part of a path, and its own.

    The others would not be chosen on nine tenths of the rows either. What changes in the course of
    a recording must be in one of the paths itself.
    """
    largest = np.zeros(len(rules.usable))
    for path in chosen:
        states = list(accumulate(path, PathState.with_group, initial=paths.state(-1)))
        states += [states[-1].without(group) for group in path]
        largest = np.max([largest, *(state.gains(rules.usable)[0] for state in states)], axis=0)
    owner, own = paths.columns.owner, [g for path in chosen for g in path]
    stays = np.array([c.course is None for c in paths.columns.owners], dtype=bool)
    stays[owner[own]] = True
    near = rules.usable & stays[owner] & (largest > PROMISING * rules.penalty)
    near[own] = True
    return np.flatnonzero(near)


def in_span(span: Span, changes: Sequence[Array], weights: Sequence[Array]) -> Array:
    """Return weighted changes of each joint's torque as columns (R, n)."""
    found = np.zeros((len(span.joint_of), len(weights)))
    for j, (own, weight) in enumerate(zip(changes, weights, strict=True)):
        found[span.joint(j), j] = own * weight
    return found


def _with_changes(rows: Rows, wanted: Callable[[Candidate], bool], *, in_course: bool) -> Rows:
    """Return the rows with copies of effects in one recording only, or in its course (`COURSES`).

    They show what is no effect of the arm.
    """
    every = (Candidate(p, np.zeros((1, 0))) for p in rows.fit.model.placements)
    fixed = [c for c in every if not (c.by_estimate or c.effect.shapes)]
    own = [c for c in fixed if rows.runs[c.joint].count and wanted(c)]
    columns, number = rows.columns, len(rows.recording_names)
    recordings = [rows.part(k) for k in range(number if number > 1 else 0)]
    apart = [bool(c.effect.shapes) or c.effect.per_recording for c in columns.owners]
    plain = np.flatnonzero(~np.array(apart, dtype=bool)[columns.owner] & (columns.point == 0))
    changes = [
        columns.of_groups(plain).only_in(recordings),
        rows.with_candidates(own).columns.only_in(recordings),
    ]
    for names, kind, count in COURSES if in_course else ():
        changing = rows.with_candidates([c for c in own if c.name in names]).columns
        changes.append(changing.only_in(rows.course_parts(kind, count)))
    return replace(rows, columns=columns.joined(changes))


def _finer_courses(rows: Rows, groups: Iterable[int]) -> list[Columns]:
    """Return the columns of changes in paths, at instants or with periods around their own.

    A large change that is stated a moment early or late leaves an error that others imitate.
    """
    finer = list[Columns]()
    for group in groups:
        found, k = rows.columns.candidate(group), int(rows.columns.point[group])
        if found.course is not None:
            near = found.course.at[max(k - 1, 0) : k + 2]
            at = np.linspace(near[0], near[-1], FINER)
            part = rows.part(found.recording, Course(found.course.kind, at))
            alone = Candidate(found.placement, np.zeros((1, 0)))
            finer.append(rows.with_candidates([alone]).columns.only_in([part]))
    return finer


def _leaving(columns: Columns, slots: Sequence[Slot], options: DiagnosisOptions) -> set[int]:
    """Return the candidates whose place in a path others should take.

    Those are changes in the course of a recording that are not certain, and with them all that are
    not in the path: they compete with effects where there is no such change. So do delays with what
    makes dry friction late, beside which they are judged: where one is not supported, all leave but
    those that are, and their rivals.
    """
    owners = columns.owners
    found = {int(columns.owner[slot.group]): slot for slot in slots}
    sure = {kind: part * options.name_deviations for kind, part in CERTAINTY.items()}
    how = {k: c.course.kind for k, c in enumerate(owners) if c.course is not None}
    weak = {k for k, s in found.items() if k in how and s.evidence.gain_certainty < sure[how[k]]}
    leaving = how.keys() - (found.keys() - weak) if weak else set[int]()
    late = {int(k) for k in columns.owner[columns.delays]}
    kept = {owners[k].joints for k in late & found.keys() if found[k].reason(options) is None}
    if any(owners[k].joints not in kept for k in late & found.keys()):
        leaving |= {k for k in late if owners[k].joints not in kept}
    vain = {s.joint for k, s in found.items() if owners[k].name == SMOOTH and s.beyond}
    vain -= {slot.joint for slot in slots if slot.fall >= options.worth}
    return leaving | {k for k, c in enumerate(owners) if c.name == SMOOTH and c.joint in vain}


def _dependence(columns: Columns, noise: Sequence[Noise], *, independent: bool) -> Array:
    """Return how much more each group gains from correlated noise than from white noise (G,).

    A column of slow changes gains more from slow noise than one of fast changes. Less is left if
    rows are weighted by the noise of ``independent`` samples.
    """
    power, coloured = np.zeros((2, columns.count))
    for own, each in zip(columns.joints, noise, strict=True):
        if not len(own.matrix):
            continue
        white, own_noise = each.variances(own.matrix)
        power[own.columns] += white
        coloured[own.columns] += own_noise / (redundancy(each) if independent else 1.0)
    ratio = np.divide(coloured, power, out=np.ones(columns.count), where=power > 0.0)
    return np.maximum(np.add.reduceat(ratio, columns.start) / columns.size, 1.0)


def _rules(
    columns: Columns,
    rows: Rows,
    options: DiagnosisOptions,
    dependence: Array | None = None,
    leaving: Collection[int] = (),
) -> Rules:
    """Return what the paths over some columns may contain: no candidates that are ``leaving``."""

    def allowed(group: int, values: Array) -> bool:
        candidate = columns.candidate(group)
        return reason_against(candidate, columns.shapes(group), values, rows.segments) is None

    count = np.array([max(run.count, 2) for run in rows.runs], dtype=float) @ columns.reach
    barred = [k in leaving or is_form(c.effect) for k, c in enumerate(columns.owners)]
    more = np.ones(len(columns.size)) if dependence is None else dependence
    independent = np.maximum(count / more, 2.0)
    alike = np.array([_alternatives(rows, c) for c in columns.owners], dtype=float)[columns.owner]
    whole = np.array([isinstance(c.effect, Smooth) and c.effect.whole for c in columns.owners])
    whole = np.asarray(whole, dtype=bool)[columns.owner]
    cost = cost_of(columns.parameters, independent, whole=whole) + 2.0 * np.log(alike)
    changing = np.array([c.course is not None for c in columns.owners], dtype=bool)[columns.owner]
    cost[changing] = np.maximum(cost[changing], LEAST_CHANGE**2)
    return Rules(
        options.penalty * more * cost,
        ~np.array(barred, dtype=bool)[columns.owner],
        np.array([c.name == SMOOTH for c in columns.owners], dtype=bool)[columns.owner],
        allowed,
        options.most_steps,
    )


def _alternatives(rows: Rows, candidate: Candidate) -> int:
    """Return how many candidates of its kind are on its joint: of other signals or joints."""
    if candidate.name == SMOOTH:
        return functions_alike(rows, candidate)
    return len(rows.runs) - 1 if candidate.effect.couples else 1


def residual_beside(paths: Paths, groups: Sequence[int], rows: Rows, spread: Array) -> list[Array]:
    """Return the residual of each joint beside the groups of a path, N·m."""
    rest = rest_beside(paths.span, paths.all_outside(groups))
    return paths.span.of_joints(rest, rows.weights(spread))


def rest_beside(span: Span, outside: Sequence[Array]) -> Array:
    """Return what further columns (R + k, c) outside a span leave of its residual (R + k,)."""
    more = np.hstack([np.zeros((len(span.residual), 0)), *outside])
    return span.residual - more @ solved(more.T @ more, more.T @ span.residual)


def _coarse(paths: Paths, whole: Sequence[int], least: float) -> bool:
    """Return whether a shape of a path can leave more than ``least`` on a grid once refined.

    Half a step away from it, that is the part of its torque that its coefficients do not follow, in
    squares of the noise. Others would imitate it.
    """
    owner = paths.columns.owner
    for group in (g for g in whole if paths.columns.candidate(g).effect.shapes):
        own = paths.outside(group)
        values = solved(own.T @ own, own.T @ paths.span.residual)
        for near in (group - 1, group + 1):
            if 0 <= near < len(owner) and owner[near] == owner[group]:
                torque = replace(paths.span, residual=paths.outside(near) @ values)
                rest = rest_beside(torque, [own]) / (2.0 * (len(REFINEMENT) + 1))
                if rest @ rest > least:
                    return True
    return False


def _refined(paths: Paths, whole: Sequence[int], rows: Rows) -> list[Candidate]:
    """Return the candidates with finer grids around the path's groups and their rivals.

    Rivals are compared at their own best values: between two grid points a delay resembles a
    filter. Columns that depend on their coefficients are evaluated at the estimate without others
    of this kind, beside which a delay may have any value.
    """
    columns, more = paths.columns, dict[int, list[Array]]()
    points = dict[int, set[int]]()
    complete = reduce(PathState.with_group, whole, paths.state(-1))
    delays = [g for g in whole if columns.candidate(g).by_estimate]
    for group in whole:
        rest = complete
        for each in delays if group in delays else [group]:
            rest = rest.without(each)
        gains, values = rest.gains()
        seen = set[int]()
        for g in map(int, np.argsort(-gains)):
            owner = int(columns.owner[g])
            if gains[g] < LEAST_RIVAL * gains[group] or gains[g] <= 0.0:
                break
            if owner in seen:
                continue
            seen.add(owner)
            if columns.owners[owner].effect.shapes:
                points.setdefault(owner, set()).add(int(columns.point[g]))
            elif columns.owners[owner].by_estimate:
                more.setdefault(owner, []).append(values[columns.of_group(g)])
    refined = list(columns.owners)
    for k, own in points.items():
        refined[k] = refined[k].refined(sorted(own), REFINEMENT)
    for k, estimates in more.items():
        grid = np.unique(np.vstack([refined[k].grid, *estimates]), axis=0)
        refined[k] = replace(refined[k], grid=grid)
    return refined
