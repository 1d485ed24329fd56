"""A greedy forward path over groups of columns, on all rows or on those outside a held-out part.

The model's columns are projected out of the candidates once; a set of rows that is left out is a
subtraction of inner products, so that a path costs a few products per step for any number of rows.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lieid_casadi.arrays import Array, Indices, Mask
from lieid_casadi.diagnosis.columns import Columns
from lieid_casadi.identification.regression.least_squares import RANK_TOLERANCE, independent_axes

#: Part of the information on a direction of the model that the rows of a path must contain. With
#: less the direction keeps its value of the whole fit.
LEAST_INFORMATION = 0.3
LEAST_OWN_PART = 0.03  # of a column outside the span of model and path: with less its gain is noise
RIDGE = 1e-4  # of a column's square, for groups of nearly dependent columns
EXCHANGED = 6  # length of a path up to which every addition is followed by an exchange
MARGIN = 0.01  # relative gain by which a group must exceed the one in whose place it comes
NO_PARTS: Mask = np.zeros((0, 0), dtype=bool)  # are left out


@dataclass(frozen=True, eq=False)
class Span:
    """The span of a model's columns on all rows, and the residual outside it."""

    #: (R + k, p): orthonormal; the last k rows are those of a prior, which every set of rows has
    basis: Array
    #: (R + k,)
    residual: Array
    #: (n + 1,): joint j has rows ends[j] to ends[j + 1]; R rows in all
    ends: Indices

    @classmethod
    def of(
        cls, model: Sequence[Array], residual: Sequence[Array], prior: Array | None = None
    ) -> Span:
        """Return the span of weighted columns (R_j, p) and what it leaves of residuals (R_j,).

        ``prior`` (k, p) are rows that state the uncertainty of parameters: a root of the inverse
        of their covariance.
        """
        matrix, r = np.concatenate(model), np.concatenate(residual)
        if prior is not None:
            matrix, r = np.concatenate([matrix, prior]), np.append(r, np.zeros(len(prior)))
        q = independent_axes(matrix)[0]
        r = r - q @ (q.T @ r)
        ends = np.concatenate([[0], np.cumsum([len(own) for own in residual])]).astype(np.intp)
        return cls(q, r, ends)

    def joint(self, j: int) -> slice:
        """Return the rows of joint j."""
        return slice(int(self.ends[j]), int(self.ends[j + 1]))

    def of_joints(self, values: Array, weights: Sequence[Array]) -> list[Array]:
        """Return weighted values (R,) as those of each joint (R_j,), without the weights."""
        return [values[self.joint(j)] / weight for j, weight in enumerate(weights)]

    @property
    def of_prior(self) -> int:
        """Number k of rows of a prior, with which those of the joints count as independent."""
        return len(self.residual) - int(self.ends[-1])

    @cached_property
    def joint_of(self) -> Indices:
        """Joint of each row (R,)."""
        return np.repeat(np.arange(len(self.ends) - 1), np.diff(self.ends))

    def outside(self, columns: Array) -> Array:
        """Return the part (R + k, c) of columns (R, c) outside the span.

        They are projected twice: a column that is nearly in the span loses accuracy.
        """
        columns = np.pad(columns, ((0, len(self.basis) - len(columns)), (0, 0)))
        for _ in range(2):
            columns = columns - self.basis @ (self.basis.T @ columns)
        return columns


@dataclass(frozen=True, eq=False)
class Products:
    """Inner products on a set of rows of basis Q (p), residual r, and columns Z outside the span.

    ``inner`` has the products within groups, as `Columns.pairs`.
    """

    qq: Array
    qr: Array
    qz: Array
    zr: Array
    inner: Array

    def __sub__(self, other: Products) -> Products:
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Products(*(a - b for a, b in pairs))


class Paths:
    """All that forward paths on different rows share; a path on all rows is number −1.

    ``left_out`` (K, R) are the rows that each of K paths does not use.
    """

    def __init__(self, span: Span, columns: Columns, left_out: Mask = NO_PARTS) -> None:
        self.span, self.columns, self.left_out = span, columns, left_out
        count = columns.count
        self._along = np.zeros((span.basis.shape[1], count))
        for j, own in enumerate(columns.joints):
            self._along[:, own.columns] += span.basis[span.joint(j)].T @ own.matrix
        self._matrices = [
            [own.matrix[out[span.joint(j)]] for j, own in enumerate(columns.joints)]
            for out in left_out
        ]
        raw = self._raw(-1)
        self.norms = raw.inner[columns.diagonal]  # squares of the columns themselves
        self.whole = self._outside(raw, np.eye(span.basis.shape[1]), np.zeros(len(self._along)))
        self.parts: list[Products] = []
        self._raw_qz: list[Array] = []  # basis and columns themselves on the rows of each part
        for k, out in enumerate(left_out):
            q, r = span.basis[: out.size][out], span.residual[: out.size][out]
            of_part = self._raw(k)
            self._raw_qz.append(of_part.qz)
            self.parts.append(self._outside(of_part, q.T @ q, q.T @ r))
        self._starts: dict[int, PathState] = {}
        self._cross: dict[tuple[int, int], Array] = {}
        self._own: dict[int, Array] = {}

    def outside(self, group: int) -> Array:
        """Return a group's columns (R + k, c) on all rows, outside the span."""
        return self.all_outside([group])[0]

    def all_outside(self, groups: Sequence[int]) -> list[Array]:
        """Return the columns of groups; all that are new are projected together."""
        new = [g for g in dict.fromkeys(groups) if g not in self._own]
        if new:
            columns = [self.columns.stacked(g) for g in new]
            ends = np.cumsum([c.shape[1] for c in columns])[:-1]
            outside = np.split(self.span.outside(np.hstack(columns)), ends, axis=1)
            self._own |= zip(new, outside, strict=True)
        return [self._own[g] for g in groups]

    def grams(self, a: Array, b: Array) -> Array:
        """Return the products within groups of columns of a (p, m) with those of b."""
        first, second = self.columns.pairs
        products = (x[first] * y[second] for x, y in zip(a, b, strict=True))
        return sum(products, start=np.zeros(len(first)))

    def _rows(self, part: int, j: int) -> tuple[slice | Mask, Array]:
        """Return the rows of joint j that a path leaves out, and the columns there; −1 for all."""
        if part < 0:
            return slice(None), self.columns.joints[j].matrix
        return self.left_out[part][self.span.joint(j)], self._matrices[part][j]

    def _raw(self, part: int) -> Products:
        """Return the products of the columns themselves on the rows that a path leaves out."""
        span, columns = self.span, self.columns
        qz, zr = np.zeros((span.basis.shape[1], columns.count)), np.zeros(columns.count)
        inner = np.zeros(len(columns.pairs[0]))
        for j, own in enumerate(columns.joints):
            use, matrix = self._rows(part, j)
            qz[:, own.columns] += span.basis[span.joint(j)][use].T @ matrix
            zr[own.columns] += matrix.T @ span.residual[span.joint(j)][use]
            for gram, (_, of_size) in zip(columns.within(inner), columns.by_size, strict=True):
                here = np.flatnonzero((columns.places[j][of_size] >= 0).all(axis=1))
                if len(here):
                    values = np.moveaxis(matrix[:, columns.places[j][of_size[here]]], 0, 1)
                    gram[here] += np.swapaxes(values, 1, 2) @ values
        return Products(np.zeros((0, 0)), np.zeros(0), qz, zr, inner)

    def _outside(self, raw: Products, qq: Array, qr: Array) -> Products:
        """Return the products of the columns outside the span from those of the columns."""
        along, qz = self._along, raw.qz - qq @ self._along
        inner = raw.inner - self.grams(along, raw.qz) - self.grams(qz, along)
        return Products(qq, qr, qz, raw.zr - along.T @ qr, inner)

    def cross(self, group: int, part: int) -> Array:
        """Return the products (k, m) of a group's columns with all, beside the model of a path."""
        if (group, part) not in self._cross:
            own = self.columns.of_group(group)
            found = self._cross_of(own, part)
            if part >= 0:
                model = self.state(part).model
                found = self.cross(group, -1) - found - model[:, own].T @ model
            self._cross[group, part] = found
        return self._cross[group, part]

    def _cross_of(self, own: Indices, part: int) -> Array:
        """Return products of a group with all, on all rows, or on those that a path leaves out."""
        along, raw = self._along, np.zeros((len(own), self.columns.count))
        for j, of_joint in enumerate(self.columns.joints):
            at = self.columns.places[j][own]
            if (at >= 0).all():  # a group acts with all of its columns, or not at all
                _, matrix = self._rows(part, j)
                raw[:, of_joint.columns] += matrix[:, at].T @ matrix
        if part < 0:
            return np.asarray(raw - along[:, own].T @ along)
        outside, qz = self.parts[part].qz[:, own], self._raw_qz[part]
        return np.asarray(raw - outside.T @ along - along[:, own].T @ qz)

    def state(self, part: int) -> PathState:
        """Return the state of a path at its start; −1 is the path on all rows."""
        if part in self._starts:
            return self._starts[part]
        none = np.zeros((0, self.columns.count))
        own = self.whole if part < 0 else self.whole - self.parts[part]
        share = 1.0 - (self.left_out[part].mean() if part >= 0 and self.left_out.size else 0.0)
        sizes, directions = np.linalg.eigh(own.qq)
        seen = sizes > LEAST_INFORMATION
        axes = directions[:, seen] / np.sqrt(sizes[seen])
        along, squares = axes.T @ own.qz, np.maximum(self.norms * share, 1e-300)
        products = own.zr - along.T @ (axes.T @ own.qr)
        inner = own.inner - self.grams(along, along)
        found = PathState(self, part, (), squares, along, none, np.zeros(0), products, inner)
        return self._starts.setdefault(part, found)


@dataclass(frozen=True, eq=False)
class PathState:
    """A path: coordinates of all columns along model and path, and what is outside both."""

    paths: Paths
    part: int
    groups: tuple[int, ...]
    #: (m,): squares of the columns themselves, in the share of all rows that the path uses
    squares: Array
    #: (a, m): coordinates along the model's directions
    model: Array
    #: (b, m) and (b,): of the columns and of the residual along the directions of the path
    along: Array
    residual: Array
    #: (m,): of the columns with the residual, outside
    products: Array
    inner: Array

    def gains(self, wanted: Mask | None = None, *, free: bool = False) -> tuple[Array, Array]:
        """Return the fall of the sum of squares (G,) of wanted groups, and coefficients (m,).

        Groups of which no column is outside the span get no gain. Beside a kept model, which no fit
        follows, coefficients stay in the cells of their grid points unless they are ``free``.
        """
        columns, (low, high) = self.paths.columns, self.paths.columns.cells
        values, gram = np.zeros(columns.count), self.inner.copy()
        outside = gram[columns.diagonal] > LEAST_OWN_PART**2 * self.squares
        used = np.logical_or.reduceat(outside, columns.start)
        gram[columns.diagonal] += RIDGE * self.squares
        for (groups, own), each in zip(columns.by_size, columns.within(gram), strict=True):
            if wanted is None or wanted[groups].any():
                values[own] = _solved(each, self.products[own])
        gains = np.add.reduceat(values * self.products, columns.start)
        if self.paths.span.of_prior and not free:
            beyond, (first, second) = values - np.clip(values, low, high), columns.pairs
            group = np.repeat(np.arange(len(columns.size)), columns.size)[first]
            gains -= np.bincount(group, beyond[first] * gram * beyond[second])
        return np.where(used if wanted is None else wanted & used, gains, 0.0), values

    def with_group(self, group: int) -> PathState:
        """Return the state with a further group."""
        own = self.paths.columns.of_group(group)
        crossed = self.paths.cross(group, self.part) - self.along[:, own].T @ self.along
        sizes, axes = np.linalg.eigh(crossed[:, own])
        seen = sizes > RANK_TOLERANCE * max(float(sizes.max(initial=0.0)), 1e-300)
        roots = axes[:, seen] / np.sqrt(sizes[seen])
        new, residual = roots.T @ crossed, roots.T @ self.products[own]
        return replace(
            self,
            groups=(*self.groups, group),
            along=np.concatenate([self.along, new]),
            residual=np.append(self.residual, residual),
            products=self.products - new.T @ residual,
            inner=self.inner - self.paths.grams(new, new),
        )

    def without(self, group: int) -> PathState:
        """Return the state without one of its groups: the directions are rotated, it comes last."""
        columns = self.paths.columns
        rest = tuple(g for g in self.groups if g != group)
        own = [columns.of_group(g) for g in rest]
        inside = self.along[:, np.concatenate(own)] if own else np.zeros((len(self.along), 0))
        u, sizes, _ = np.linalg.svd(inside, full_matrices=True)
        rank = int(np.sum(sizes > RANK_TOLERANCE * sizes.max(initial=0.0)))
        kept, dropped = u[:, :rank].T, u[:, rank:].T
        lost, of_residual = dropped @ self.along, dropped @ self.residual
        return replace(
            self,
            groups=rest,
            along=kept @ self.along,
            residual=kept @ self.residual,
            products=self.products + lost.T @ of_residual,
            inner=self.inner + self.paths.grams(lost, lost),
        )


def _solved(grams: Array, products: Array) -> Array:
    """Return solutions (g, k) of g systems; of one or two unknowns all are solved at once."""
    if products.shape[1] > 2:
        return np.asarray(np.linalg.solve(grams, products[..., None])[..., 0])
    if products.shape[1] == 1:
        return products / grams[:, 0]
    (a, b), (_, c), (x, y) = *np.moveaxis(grams, 0, -1), products.T
    second = (y - b / a * x) / (c - b / a * b)
    return np.stack([(x - b * second) / a, second], axis=1)


@dataclass(frozen=True, eq=False)
class Rules:
    """What a path may contain."""

    #: (G,): what each group must gain at least
    penalty: Array
    #: (G,): groups that are candidates
    usable: Mask
    #: (G,): smooth functions, which come after all others, except on some joints
    smooth: Mask
    #: of a group and its coefficients: whether it may be in a path
    allowed: Callable[[int, Array], bool]
    #: length of a path
    most: int


def forward(
    paths: Paths, part: int, rules: Rules, *, smooth_first: Collection[int] = ()
) -> tuple[int, ...]:
    """Return the groups of a greedy path with exchange, in the order of their selection.

    While the path is short, each of its groups gives way to a better one: the first one is often a
    compromise of several causes. Effects of the library come before smooth functions, except on the
    joints ``smooth_first``, where they compete from the start.
    """
    early = ~rules.smooth | paths.columns.reach[list(smooth_first)].any(axis=0)
    state = _grown(paths.state(part), replace(rules, usable=rules.usable & early))
    return _grown(state, replace(rules, usable=rules.usable & rules.smooth)).groups


def _grown(state: PathState, rules: Rules) -> PathState:
    """Return the state with the groups added that gain more than their penalty."""
    refused = np.zeros(len(rules.usable), dtype=bool)
    seen = set[frozenset[int]]()  # nearly dependent groups would replace each other for ever
    while len(state.groups) < rules.most and frozenset(state.groups) not in seen:
        seen.add(frozenset(state.groups))
        best = _best(state, state.gains(rules.usable), rules, refused)
        if best is None:
            break
        state = state.with_group(best)
        if 1 < len(state.groups) <= EXCHANGED:
            state = _exchanged(state, rules, refused)
    return state


def _best(
    state: PathState, found: tuple[Array, Array], rules: Rules, refused: Mask, least: float = 0.0
) -> int | None:
    """Return the group with the largest gain beyond its penalty and ``least``, None without one.

    ``found`` are the gains of usable groups and the coefficients, see `PathState.gains`.
    """
    columns, (gains, values) = state.paths.columns, found
    taken = np.isin(columns.owner, columns.owner[list(state.groups)])
    late = [g for g in state.groups if columns.delays[g]]  # two that nearly cancel are another form
    taken |= columns.delays & columns.reach[columns.reach[:, late].any(axis=1)].any(axis=0)
    score = np.where(rules.usable & ~refused & ~taken, gains - rules.penalty, 0.0)
    while len(score) and score[best := int(np.argmax(score))] > least:
        if rules.allowed(best, values[columns.of_group(best)]):
            return best
        refused[best], score[best] = True, 0.0
    return None


def _exchanged(state: PathState, rules: Rules, refused: Mask) -> PathState:
    """Return the state with each group exchanged for the best one in its place, if it is better."""
    complete, numbers = state, np.arange(len(rules.usable))
    for group in state.groups:
        if state is complete and group == state.groups[-1]:
            break  # the last one was the best beside the others
        if state.paths.span.of_prior and not rules.usable[group]:
            continue  # between two points of its grid a large change is nearer to a function
        rest = state.without(group)
        found = rest.gains(rules.usable | (numbers == group))
        own = float(found[0][group])
        if not own and rules.usable[group]:  # the others nearly contain it: what is lost counts
            own = float(state.residual @ state.residual - rest.residual @ rest.residual)
        own -= float(rules.penalty[group])
        better = _best(rest, found, rules, refused, max(own, 0.0) * (1.0 + MARGIN))
        if better is not None and not rules.smooth[group]:
            state = rest.with_group(better)
        elif own <= 0.0:
            state = rest
    return state
