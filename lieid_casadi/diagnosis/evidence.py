"""Nested selection: paths inside each held-out part decide which effects lower unseen errors.

The path on all rows proposes the effects. A path on the rows outside each held-out part, which
does not see that part, is then examined: what does the error of the part gain by the effect, or by
a rival that this path has in its place? An effect is added if the mean of this gain over
the parts exceeds a number of its standard errors. An effect that a path does not contain gains
nothing there, so that the figures contain the uncertainty of the choice itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc, ndtri

from lieid_casadi.arrays import Array, Indices
from lieid_casadi.diagnosis.columns import Columns
from lieid_casadi.diagnosis.folds import Folds
from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.path import LEAST_INFORMATION, Paths, Span
from lieid_casadi.diagnosis.step import Evidence

DEPENDENT = 1e-8  # of a largest eigenvalue
ROUNDING = 1e-14  # of a largest variance
SMALLEST = 1e-12  # part of an error below which it counts as zero
SMALLEST_TAIL = 1e-300  # probability of a deviation: the inverse of the distribution is finite
#: Expected part of false effects among all that are added, by gain and coefficients together.
#: Statistics: Benjamini and Hochberg, J. Royal Statistical Society B 1995.
FALSE_EFFECTS = 0.1
OTHER_JOINTS = 2  # that have an effect, from which less evidence is enough on a further joint
BEYOND = 10.0  # times the median error of the parts: a larger one counts as this
Key = int | tuple[str, int]  # a group of columns, or a kind of friction on a joint
ALIKE = 0.5  # part of an effect's torque that a group must be able to replace to count as a rival


@dataclass(frozen=True, eq=False)
class Slot:
    """One effect of the path on all rows, as the held-out parts judge it."""

    group: int
    evidence: Evidence
    #: (K,) each: weighted sum of squares of its joint in each held-out part, without it and with
    #: it, and of the prior, by which parameters of a kept model that move in its place are held
    before: Array
    after: Array
    #: groups that are in its place in paths without it
    instead: tuple[int, ...]
    #: (k,): coefficients beside the whole path
    values: Array
    #: of those on which it acts, that whose error falls most
    joint: int

    @property
    def fall(self) -> float:
        """Relative fall of the held-out error of its joint."""
        return fall_of(self.before, self.after)

    @property
    def beyond(self) -> bool:
        """Whether the others do not extend to some part, so that its error is far beyond theirs."""
        return bool(self.before.any() and _counts(self.before, self.after).min() < 1.0)

    def reason(self, options: DiagnosisOptions, *, elsewhere: int = 0) -> str | None:
        """Return why the held-out parts do not support the effect, or None."""
        if self.fall < options.worth:
            falls = f"falls by only {100 * self.fall:.1f} %" if self.fall > 0 else "does not fall"
            return f"the held-out error of joint {self.joint + 1} {falls}"
        found, least = self.evidence.deviations, evidence_needed(options.gain_deviations, elsewhere)
        text = f"the gain on held-out parts is {found:.1f} of its standard errors (limit {least:g})"
        return text if found < least else None


def fall_of(before: Array, after: Array) -> float:
    """Return the relative fall of an error from sums of squares (K,) of the held-out parts."""
    if not before.any():
        return 0.0
    counts = _counts(before, after)
    return 1.0 - float(np.sqrt((counts @ after) / (counts @ before)))


def _counts(before: Array, after: Array) -> Array:
    """Return what each part counts (K,): one to which the others do not extend would decide alone.

    One in which the joint rests has no rows.
    """
    limit = max(BEYOND**2 * float(np.median(after[before > 0.0])), 1e-300)
    return np.asarray(limit / np.maximum(after, limit))


def evidence_needed(limit: float, elsewhere: int) -> float:
    """Return the deviations that an effect needs, given the number of other joints that have it.

    Half of them are enough if it is on two other joints: drives of one arm resemble each other.
    """
    return 0.5 * limit if elsewhere >= OTHER_JOINTS else limit


def coefficient_deviations(
    values: Array, covariance: Array, independent: float, tried: float
) -> float:
    """Return how far coefficients (k,) together are from zero, in standard deviations.

    Those are the standard deviations that noise exceeds as often (Wald's test). The noise is known
    as well as ``independent`` stretches of recordings permit (F distribution), and the coefficients
    are the largest of those at ``tried`` independent shapes.
    """
    variances, axes = np.linalg.eigh(covariance)
    # beside a combination that the data do not determine
    certain = np.maximum(variances, ROUNDING * variances[-1])
    square = float(np.mean((axes.T @ values) ** 2 / certain))
    tail = float(fdtrc(len(values), max(independent, 1.0), max(square, 0.0)))
    tail = -float(np.expm1(tried * np.log1p(-min(tail, 1.0 - SMALLEST))))
    return float(-ndtri(0.5 * max(tail, SMALLEST_TAIL)))


def undetermined(
    gain: float, coefficients: float, part: float, options: DiagnosisOptions, elsewhere: int = 0
) -> tuple[str, float] | None:
    """Return why noise may be all of an effect beside all others, and its deviations; or None.

    Those are the fewer of its gain's and its coefficients', or what their geometric mean is of that
    needed, in units of a name's. Noise exceeds what is needed in as many candidates as the effects,
    which are a ``part`` of these, may have false ones among them.
    """
    needed = options.gain_deviations, float(-ndtri(0.5 * FALSE_EFFECTS * part))
    least, certain = (evidence_needed(limit, elsewhere) for limit in needed)
    text = f"its coefficients are {coefficients:.1f} standard deviations from zero"
    if coefficients < least:
        return f"{text} (limit {least:g})", min(gain, coefficients)
    both = float(np.sqrt(coefficients * max(gain, 0.0)))
    if both < certain:
        text = f"its gain is certain to {gain:.1f} standard errors and {text}"
        missing = options.name_deviations * both / certain
        return f"{text} (geometric mean, limit {certain:.1f})", min(gain, coefficients, missing)
    return None


def judge(
    paths: Paths,
    folds: Folds,
    whole: Sequence[int],
    parts: Sequence[Sequence[int]],
    friction: Mapping[str, Array],
) -> tuple[tuple[Slot, ...], Array]:
    """Return the effects of the path on all rows with their gains on the held-out parts.

    Beside them the sum of squared errors (K, n) of each held-out part and joint. That something
    changed between recordings is the stronger claim: an effect in one of them is that of the arm if
    a path without some part has this in its place.

    ``parts`` are the paths that do not use each part. ``friction`` (R, n) is the change of torque
    if the dry friction of each joint is ``late`` or ``early``, or by that at ``rest``. A delay must
    explain more than the first: a joint that sticks for less than a sample at its reversals looks
    the same there. A function or Stribeck friction must explain more than the last, where motion
    begins and ends, and a dead band more than all: friction of simulators is early (MuJoCo's
    ``solreffriction``), and a joint at rest needs no torque of its drive either.
    """
    span, columns = paths.span, paths.columns
    if span.of_prior:
        whole, *parts = shortened(paths, folds, whole, parts)
    every = [*dict.fromkeys([*whole, *(g for path in parts for g in path)])]
    outside = dict(zip(every, paths.all_outside(every), strict=True))
    n = len(span.ends) - 1
    frictions = {(k, j): span.outside(x[:, [j]]) for k, x in friction.items() for j in range(n)}
    together = np.hstack([np.zeros((len(span.residual), 0)), *(outside[g] for g in whole)])
    both = solved(together.T @ together, together.T @ span.residual)
    ends = np.cumsum([outside[g].shape[1] for g in whole])
    values = dict(zip(whole, np.split(both, ends.astype(int)), strict=False))
    torque = {g: outside[g] @ values[g] for g in whole}
    members = [_members(whole, path, outside, torque, columns.owner) for path in parts]
    if not folds.apart:  # functions of time alone are known around a part, as slow noise is
        here = {g: columns.candidate(g) for g in whole}
        slow = {g: () for g, c in here.items() if c.course and not c.effect.signals}
        slow |= {g: () for g, c in here.items() if c.effect.per_recording}
        members = [own | slow for own in members]
    gains, expected = np.zeros((2, len(whole), folds.count))
    squares = np.zeros((folds.count, n + 1))
    before, after = np.zeros((2, len(whole), folds.count, n + 1))
    for k, path in enumerate(parts):
        held = HeldOut(span, folds, k, {g: outside[g] for g in path} | frictions)
        of_path = held.errors(path)
        squares[k] = held.squares(of_path)
        for e, group in enumerate(whole):
            mine, joints = members[k][group], np.flatnonzero(columns.reach[:, group])
            alike = columns.candidate(group).effect.like_uncertain_friction
            kinds = [kind for kind in friction if kind in alike]
            beside = [(kind, int(j)) for kind in kinds for j in joints]
            complete = held.errors([*path, *beside]) if beside else of_path
            rest = [g for g in path if g not in mine]
            without = held.errors([*rest, *beside]) if mine else complete
            # a part whose path lacks the effect counts with what the effect would be
            change = without - complete if mine else torque[group][held.rows]
            less, more, size = (held.squares(x) for x in (without, complete, change))
            left, error, moved = (x[[*joints, n]].sum() for x in (less, more, size))
            gains[e, k], expected[e, k] = gains_of(left, error), gains_of(error + moved, error)
            before[e, k], after[e, k] = less, more
    found = []
    for group, *of_parts in zip(whole, gains, expected, before, after, strict=True):
        stand = [own[group] for own in members]
        found.append(_slot(paths, folds, group, values[group], stand, *of_parts))
    of_arm = list(dict.fromkeys(_of_the_arm(slot, columns) for slot in found))
    if of_arm != list(whole):
        return judge(paths, folds, of_arm, parts, friction)
    return tuple(found), squares


def _slot(
    paths: Paths, folds: Folds, group: int, values: Array, stand: list[tuple[int, ...]], *of: Array
) -> Slot:
    """Return an effect, with what stands for it in each of K parts.

    ``of`` the parts are its gains (K,), those expected, and errors (K, n + 1) without and with it.
    """
    gains, expected, before, after = of
    columns, n = paths.columns, before.shape[1] - 1
    own = [columns.owner[group] in columns.owner[list(mine)] for mine in stand]
    others = (g for mine in stand for g in mine if columns.owner[g] != columns.owner[group])
    less, more = (x[:, :n].sum(axis=0) for x in (before, after))
    left = np.where(columns.reach[:, group] & (less > 0.0), more / np.maximum(less, 1e-300), np.inf)
    joint = int(np.argmin(left))
    evidence = Evidence(
        tuple(map(float, gains)),
        tuple(map(float, expected)),
        *folds.deviations(gains, expected, joint),
        float(np.mean(own)),
        float(np.mean([bool(mine) for mine in stand])),
        int(folds.independent[joint]),
    )
    less, more = (x[:, [joint, n]].sum(axis=1) for x in (before, after))
    return Slot(group, evidence, less, more, tuple(dict.fromkeys(others)), values, joint)


def shortened(
    paths: Paths, folds: Folds, whole: Sequence[int], parts: Sequence[Sequence[int]]
) -> list[list[int]]:
    """Return the paths up to where the held-out parts have the lowest error, of each joint.

    A kept model has the noise of its fit, by which a path goes on through all that its effects
    leave of a large torque. Further effects there would spoil the error of those before. The
    logarithms of the errors count: a part to which the others do not extend does not decide.
    """
    columns, found = paths.columns, [list(path) for path in (whole, *parts)]
    helds = [
        HeldOut(paths.span, folds, k, dict(zip(path, paths.all_outside(path), strict=True)))
        for k, path in enumerate(parts)
    ]
    for j in range(len(columns.joints)):
        most = max(len(path) - len(_cut(path, j, 0, columns)) for path in parts)
        logs = np.zeros(most + 1)
        for held, path in zip(helds, parts, strict=True):
            for length in range(most + 1):
                squares = held.squares(held.errors(_cut(path, j, length, columns)))
                logs[length] += np.log(max(float(squares[[j, -1]].sum()), SMALLEST))
        found = [_cut(path, j, int(np.argmin(logs)), columns) for path in found]
    return found


def _cut(path: Sequence[int], joint: int, length: int, columns: Columns) -> list[int]:
    """Return a path with the first groups alone of those that act on one joint only."""
    own = [g for g in path if columns.reach[:, g].sum() == 1 and columns.reach[joint, g]]
    return [g for g in path if g not in own[length:]]


def _of_the_arm(slot: Slot, columns: Columns) -> int:
    """Return the group of an effect, or that of all recordings if a path has it in its place."""
    mine = columns.candidate(slot.group)
    for group in () if mine.of_arm else slot.instead:
        other = columns.candidate(group)
        if other.of_arm and other.placement.label == mine.placement.label:
            return group
    return slot.group


def gains_of(before: float | Array, after: float | Array) -> Array:
    """Return ln of RMS errors over later ones, from sums of squares; 0 without rows."""
    before, after = np.asarray(before), np.asarray(after)
    part = np.divide(after, before, out=np.ones(before.shape), where=before > 0.0)
    return np.asarray(-0.5 * np.log(np.maximum(part, SMALLEST)))


class HeldOut:
    """Errors on one held-out part of models with further columns, fitted to the rows outside it.

    A kept model predicts a part as well with parameters that have moved as with the effect in whose
    place they moved: how far they are from the prior counts, too, with an equal part in each part.
    """

    def __init__(self, span: Span, folds: Folds, part: int, columns: Mapping[Key, Array]) -> None:
        q, further = span.basis, span.of_prior
        out = np.pad(folds.out[part], (0, further))
        held = np.pad(folds.held[part], (0, further), constant_values=True)
        outside = q[out]
        sizes, directions = np.linalg.eigh(np.eye(q.shape[1]) - outside.T @ outside)
        seen = sizes > LEAST_INFORMATION
        axes = directions[:, seen] / np.sqrt(sizes[seen])
        every = np.column_stack([span.residual, *columns.values()])
        # on all rows together, residual and columns are orthogonal to the basis
        lost, self._whole = every[out], every.T @ every
        along = -axes @ (axes.T @ (outside.T @ lost))
        self._gram = self._whole - lost.T @ (lost - outside @ along)
        self.rows, self._n = held, len(span.ends)
        self._joint = np.append(span.joint_of, np.full(further, self._n - 1))[held]
        self._share = np.where(self._joint < self._n - 1, 1.0, 1.0 / folds.count)
        self._held = every[held] - q[held] @ along
        widths = [c.shape[1] for c in columns.values()]
        starts = 1 + np.concatenate([[0], np.cumsum(widths)]).astype(int)
        self._at = {
            g: np.arange(a, a + w) for g, a, w in zip(columns, starts, widths, strict=False)
        }

    def errors(self, groups: Sequence[Key]) -> Array:
        """Return the errors of the held-out rows, and of a prior, of the model with some groups."""
        error = self._held[:, 0]
        if groups:
            own = np.concatenate([self._at[g] for g in groups])
            both = np.ix_(own, own)
            values = determined(self._gram[both], self._gram[own, 0], self._whole[both])
            error = error - self._held[:, own] @ values
        return np.asarray(error)

    def squares(self, errors: Array) -> Array:
        """Return the sum of squares (n + 1,) of errors: of each joint, and of the prior's part."""
        squares = self._share * errors**2
        return np.asarray(np.bincount(self._joint, weights=squares, minlength=self._n), float)


def determined(gram: Array, products: Array, whole: Array) -> Array:
    """Return the solution of normal equations along directions that the rows determine.

    On the others they have less than `LEAST_INFORMATION` of the information of all rows
    (``whole``): a prediction along them would extrapolate, and they stay at zero, where columns
    gain nothing and lose nothing.
    """
    size = np.sqrt(np.maximum(np.diag(whole), 1e-300))
    sizes, axes = np.linalg.eigh(whole / size / size[:, None])
    kept = sizes > DEPENDENT * max(float(sizes.max(initial=0.0)), 1e-300)
    to_unit = axes[:, kept] / np.sqrt(sizes[kept]) / size[:, None]
    parts, directions = np.linalg.eigh(to_unit.T @ gram @ to_unit)
    seen = parts > LEAST_INFORMATION
    inside = to_unit @ directions[:, seen]
    return np.asarray(inside @ ((inside.T @ products) / parts[seen]))


def solved(gram: Array, products: Array) -> Array:
    """Return the solution of normal equations; dependent directions stay at zero."""
    return determined(gram, products, gram)


def _members(
    whole: Sequence[int],
    path: Sequence[int],
    outside: dict[int, Array],
    torque: dict[int, Array],
    owner: Indices,
) -> dict[int, tuple[int, ...]]:
    """Return the groups of a path that stand for each effect: itself, or else the most alike.

    A group that is itself an effect of the path on all rows stands for no other.
    """
    owners = {int(owner[g]) for g in whole}
    found = {}
    for group in whole:
        same = [g for g in path if owner[g] == owner[group]]
        if not same:
            free = [g for g in path if int(owner[g]) not in owners]
            parts = {g: part_of(torque[group], outside[g]) for g in free}
            best = max(parts, key=lambda g: parts[g], default=-1)
            same = [best] if best >= 0 and parts[best] > ALIKE else []
        found[group] = tuple(same)
    return found


def part_of(torque: Array, columns: Array) -> float:
    """Return the part of a torque's square (R,) that columns (R, k) can replace."""
    total = float(torque @ torque)
    if total == 0.0:
        return 0.0
    return float(torque @ columns @ solved(columns.T @ columns, columns.T @ torque)) / total
