"""Shape parameters searched over their whole range, one effect at a time beside all others.

For given shapes the model is linear, so the fall of the cost that an effect brings beside the
others follows from inner products of its columns: the columns of all effects are projected off
those that depend on no shape once, and each value that is tried costs one small linear system. The
search depends on the data and the set of effects alone:

1. from the model without these effects, add the one that lowers the cost most, at its best value,
   until all are in (orthogonal matching pursuit);
2. move the effect whose best value elsewhere in its range lowers the cost most, until none does.

`fixed_point` refines the result by variable projection and scans again, so that in the end neither
a small change of all shapes nor any change of one effect lowers the cost.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from lieid_casadi.arrays import Array, Indices
from lieid_casadi.effects import ArmEffect, Placement
from lieid_casadi.identification.regression.design_matrix import Design, VaryingEffect, grid_key
from lieid_casadi.identification.regression.least_squares import Rows, combine, independent_axes
from lieid_casadi.identification.regression.segment_columns import model_along
from lieid_casadi.identification.regression.variable_projection import ShapeRange

#: Values tried per shape parameter of an effect with one, two, three of them.
GRID = (33, 11, 6)
ARM_GRID = 17  # of effects that are computed along the whole segment
PHASE = 2.0  # rad between values of a wave number, over the range of the angle
FINE = 9  # values tried within the step of a wave number
PEAKS = 4  # of a scan over wave numbers, tried on the finer grid
NEAR_BEST = 0.85  # part of the best fall that such a peak has at least
BETTER = 1e-6  # part of the cost by which another value must be lower
MOVES = 20  # per effect
VANISHING = 1e-9  # part of a column's square beside others that counts as zero

#: Columns of one effect at some values of its shapes: joint → (G, c, R).
Columns = dict[int, Array]


@dataclass(frozen=True, eq=False)
class Member:
    """An effect with fitted shapes, and the values (G, s) that are tried."""

    effect: VaryingEffect
    grid: Array
    waves: bool


@dataclass(frozen=True, eq=False)
class Trial:
    """Columns of an effect at G values, and their weighted inner products.

    ``along`` (G, c, f) are those with the basis of the fixed columns, ``square`` (G, c, c) and
    ``target`` (G, c) those with themselves and the torque, both off the fixed columns.
    """

    columns: Columns
    along: Array
    square: Array
    target: Array

    def at(self, k: int) -> Trial:
        """Return the trial of value k alone."""
        part = slice(k, k + 1)
        columns = {j: values[part] for j, values in self.columns.items()}
        return Trial(columns, self.along[part], self.square[part], self.target[part])


class ShapeScan:
    """The scan over the shapes of one design; columns that do not depend on the load are kept."""

    def __init__(self, design: Design, ranges: ShapeRange) -> None:
        self.design = design
        self.members = _members(design, ranges)
        design.forget_other_grids({grid_key(m.effect, m.grid) for m in self.members})

    def found(
        self, rows: Rows, shapes: Array, links: Array | None, noise: Array, *, afresh: bool
    ) -> Array:
        """Return the shapes (s,) at which no value of any one effect lowers the cost.

        ``afresh`` starts without the effects, otherwise at the given shapes. Rows are those of
        the design at these shapes and links; ``noise`` (n,) weights them.
        """
        fixed = WeightedProjection(
            rows, np.concatenate([m.effect.columns for m in self.members]), noise
        )
        here = _Here(self, fixed, shapes, links)
        shapes, current = shapes.copy(), dict[int, Trial]()
        if not afresh:
            current = {k: fixed.present(m, rows) for k, m in enumerate(self.members)}
        while len(current) < len(self.members):
            moves = [here.best(k, current) for k in range(len(self.members)) if k not in current]
            self._move(max(moves, key=lambda move: move.fall), shapes, current)
        for _ in range(MOVES * len(self.members)):
            moves = [here.best(k, current) for k in range(len(self.members))]
            gains = [m.fall - here.fall(m.member, current) for m in moves]
            k = int(np.argmax(gains))
            if gains[k] <= BETTER * fixed.cost:
                break
            self._move(moves[k], shapes, current)
        return shapes

    def _move(self, move: _Move, shapes: Array, current: dict[int, Trial]) -> None:
        shapes[self.members[move.member].effect.shapes] = move.values
        current[move.member] = move.trial

    def columns(self, k: int, values: Array, shapes: Array, links: Array | None) -> Columns:
        """Return the columns of member k at values (G, s) of its shapes, not weighted."""
        effect = self.members[k].effect
        if effect.of_arm:
            return self._arm_columns(effect, values, shapes, links)
        (rows,) = self.design.joint_columns([effect], values, links)
        return {effect.placement.joint: _stacked(rows)}

    def grid_columns(self, k: int, shapes: Array, links: Array | None) -> Columns:
        """Return the columns of member k on its whole grid."""
        effect, grid = self.members[k].effect, self.members[k].grid
        if effect.uses_load:
            return self.columns(k, grid, shapes, links)
        return {effect.placement.joint: _stacked(self.design.grid_columns(effect, grid))}

    def _arm_columns(
        self, own: VaryingEffect, values: Array, shapes: Array, links: Array | None
    ) -> Columns:
        effect = own.placement.effect
        assert isinstance(effect, ArmEffect)
        assert links is not None  # `fixed_point` waits for them
        model = self.design.model
        every = np.zeros(10 * model.n + len(model.columns))
        every[: len(links)] = links
        coefficients = every[10 * model.n :][own.coefficients]
        parts = []
        for segment in self.design.segments:
            arm = model_along(self.design.compiled, segment, shapes, every)
            tried = [np.concatenate([coefficients, value]) for value in values]
            raw = [effect.segment_columns(arm, own.placement.joint, x) for x in tried]
            columns = np.stack(raw, axis=1)[..., own.kept]
            filtered = segment.filter(columns.reshape(len(segment), -1))
            parts.append(filtered.reshape(-1, *columns.shape[1:]))
        return {
            j: _stacked(self.design.on_joint(j, [p[:, :, j] for p in parts]))
            for j in range(model.n)
        }


@dataclass(frozen=True, eq=False)
class _Move:
    """The best values (s,) of a member's shapes, and the fall of the cost."""

    member: int
    values: Array
    trial: Trial
    fall: float


class WeightedProjection:
    """The weighted regression on the columns that depend on no fitted shape."""

    def __init__(self, rows: Rows, varying: Indices, noise: Array) -> None:
        self.weights, self._rows = 1.0 / noise, rows
        fixed = np.setdiff1d(np.arange(rows.count), varying)
        factor = combine(rows.factors, self.weights)
        z, (basis, axes, _) = factor.r[:, -1], independent_axes(factor.r[:, fixed])
        self._axes = np.zeros((rows.count, axes.shape[1]))
        self._axes[fixed], along = axes, basis.T @ z
        self._values, self.cost = self._axes @ along, float(z @ z - along @ along)
        self._residuals: dict[int, Array] = {}

    @property
    def count(self) -> int:
        """Number of vectors of the basis."""
        return int(self._axes.shape[1])

    def residual(self, j: int) -> Array:
        """Return the weighted residual (R,) of a joint."""
        if j not in self._residuals:
            self._residuals[j] = self.weights[j] * self._rows.joints[j].residual(self._values)
        return self._residuals[j]

    def along(self, j: int, columns: Array) -> Array:
        """Return the inner products (f, c) of a joint's rows of the basis with columns (R, c)."""
        own = self._rows.joints[j]
        return np.asarray(self._axes[own.columns].T @ (own.matrix.T @ columns) * self.weights[j])

    def trial(self, columns: Columns) -> Trial:
        """Return a trial of columns."""
        count, width, _ = next(iter(columns.values())).shape
        along = np.zeros((count, width, self.count))
        square, target = np.zeros((count, width, width)), np.zeros((count, width))
        for j, values in columns.items():
            flat = values.reshape(count * width, -1)
            along += self.weights[j] * self.along(j, flat.T).T.reshape(along.shape)
            target += self.weights[j] * (flat @ self.residual(j)).reshape(target.shape)
            square += self.weights[j] ** 2 * (values @ values.swapaxes(1, 2))
        return Trial(columns, along, square - along @ along.swapaxes(1, 2), target)

    def present(self, member: Member, rows: Rows) -> Trial:
        """Return the trial of a member at the shapes of the rows."""
        columns = {}
        for j, joint in enumerate(rows.joints):
            if np.isin(member.effect.columns, joint.columns).all():
                at = np.searchsorted(joint.columns, member.effect.columns)
                columns[j] = np.ascontiguousarray(joint.matrix[:, at].T)[None]
        return self.trial(columns)

    def cross(self, trial: Trial, other: Trial) -> Array:
        """Return the inner products (G, c, d) of columns with those of another effect."""
        count, width, size = trial.along.shape
        result = -trial.along.reshape(-1, size) @ other.along[0].T
        for j, values in trial.columns.items():
            if j in other.columns:
                flat = values.reshape(count * width, -1)
                result += self.weights[j] ** 2 * (flat @ other.columns[j][0].T)
        return np.asarray(result.reshape(count, width, -1))

    def falls(self, trial: Trial, others: Sequence[Trial]) -> Array:
        """Return the fall (G,) of the cost by columns beside the fixed ones and others."""
        square, target = trial.square, trial.target
        if others:
            crossed = np.concatenate([self.cross(trial, other) for other in others], axis=2)
            between = np.block(
                [[a.square[0] if a is b else self.cross(a, b)[0] for b in others] for a in others]
            )
            aim = np.concatenate([other.target[0] for other in others])
            # a column of denormal numbers has no inverse: nothing of it is used
            scale = np.sqrt(np.maximum(np.diag(between), 1e-300))
            sizes, directions = np.linalg.eigh(between / np.outer(scale, scale))
            used = sizes > VANISHING
            axes = directions[:, used] / np.sqrt(sizes[used]) / scale[:, None]
            inside = crossed @ axes
            square = square - inside @ inside.swapaxes(1, 2)
            target = target - inside @ (axes.T @ aim)
        norms = np.einsum("gcc->gc", trial.square) + np.sum(trial.along**2, axis=2)
        scale = np.sqrt(np.maximum(norms, 1e-300))
        sizes, directions = np.linalg.eigh(square / (scale[:, :, None] * scale[:, None, :]))
        part = np.einsum("gcd,gc->gd", directions, target / scale) ** 2
        used = sizes > VANISHING
        return np.asarray(np.sum(np.where(used, part / np.where(used, sizes, 1.0), 0.0), axis=1))


class _Here:
    """The trials of all members at one load and one weighting."""

    def __init__(
        self, scan: ShapeScan, fixed: WeightedProjection, shapes: Array, links: Array | None
    ) -> None:
        self._scan, self._fixed, self._shapes, self._links = scan, fixed, shapes, links
        self._grids: dict[int, Trial] = {}
        self._peaks: dict[tuple[int, int], tuple[Array, Trial]] = {}

    def best(self, k: int, current: dict[int, Trial]) -> _Move:
        """Return the best values of member k beside the other members that are in the model."""
        member, others = self._scan.members[k], [c for i, c in current.items() if i != k]
        if k not in self._grids:
            columns = self._scan.grid_columns(k, self._shapes, self._links)
            self._grids[k] = self._fixed.trial(columns)
        trial = self._grids[k]
        falls = self._fixed.falls(trial, others)
        at = int(np.argmax(falls))
        best = _Move(k, member.grid[at], trial.at(at), float(falls[at]))
        for peak in _peaks(falls) if member.waves else ():
            values, fine = self._around(k, peak)
            falls = self._fixed.falls(fine, others)
            at = int(np.argmax(falls))
            if falls[at] > best.fall:
                best = _Move(k, values[at], fine.at(at), float(falls[at]))
        return best

    def fall(self, k: int, current: dict[int, Trial]) -> float:
        """Return the fall of the cost that member k brings at its present values."""
        others = [c for i, c in current.items() if i != k]
        return float(self._fixed.falls(current[k], others)[0])

    def _around(self, k: int, peak: int) -> tuple[Array, Trial]:
        """Return finer values (G, 1) around one of the grid, and their trial."""
        if (k, peak) not in self._peaks:
            grid = self._scan.members[k].grid
            half = 0.5 * float(grid[1, 0] - grid[0, 0])
            fine = np.clip(grid[peak] + np.linspace(-half, half, FINE)[:, None], grid[0], grid[-1])
            columns = self._scan.columns(k, fine, self._shapes, self._links)
            self._peaks[k, peak] = fine, self._fixed.trial(columns)
        return self._peaks[k, peak]


def _peaks(falls: Array) -> list[int]:
    """Return the highest local maxima, those that a finer grid may make the highest of all."""
    padded = np.concatenate([[-np.inf], falls, [-np.inf]])
    peaks = np.flatnonzero((falls >= padded[:-2]) & (falls >= padded[2:]))
    peaks = peaks[falls[peaks] >= NEAR_BEST * falls.max()]
    return [int(k) for k in peaks[np.argsort(-falls[peaks], kind="stable")[:PEAKS]]]


def _stacked(rows: Array) -> Array:
    """Return columns (G, c, R) of (R, G, c)."""
    return np.ascontiguousarray(np.moveaxis(rows, 0, -1))


def _members(design: Design, ranges: ShapeRange) -> list[Member]:
    """Return the effects with fitted shapes, ordered by their labels."""
    found = []
    for effect in design.effects:
        p = effect.placement
        if all(s.data is not None for s in p.effect.shapes):
            continue
        waves = len(effect.shapes) == 1 and p.effect.shapes[0].scan is not None
        own = ShapeRange(ranges.lower[effect.shapes], ranges.upper[effect.shapes])
        found.append(Member(effect, _waves(design, p, own) if waves else _grid(p, own), waves))
    return sorted(found, key=lambda member: member.effect.placement.label)


def _grid(placement: Placement, ranges: ShapeRange) -> Array:
    """Return the values (G, s) over the ranges, by equal steps of their places."""
    count = len(ranges.lower)
    points = GRID[min(count, len(GRID)) - 1]
    if isinstance(placement.effect, ArmEffect):
        points = ARM_GRID
    places = np.linspace(0.0, 1.0, points)
    return np.array([ranges.shapes(np.array(at)) for at in product(places, repeat=count)])


def _waves(design: Design, placement: Placement, ranges: ShapeRange) -> Array:
    """Return wave numbers (G, 1) that differ by `PHASE` over the range of the joint's angle."""
    angle = np.concatenate([segment.q[:, placement.joint] for segment in design.segments])
    step = PHASE / max(float(np.ptp(angle)), 0.5)
    lower, upper = float(ranges.lower[0]), float(ranges.upper[0])
    return np.linspace(lower, upper, max(int(np.ceil((upper - lower) / step)) + 1, 2))[:, None]
