"""Error of a fit along one segment, without what the motion of each joint explains."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from lieid_casadi.effects.torque_delay import delayed_change
from lieid_casadi.identification import Fit
from lieid_casadi.identification.prediction import torque_along
from lieid_casadi.identification.uncertainty.noise_model import (
    common_effect_columns,
    dry_level,
    friction_torque_std,
)
from lieid_casadi.recording import Processed

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
DEVIATIONS = 2.5  # of a uniform distribution over the level of dry friction: beyond its ends
STILL_TIME, STILL_RANGE = 1.0, 0.02  # s, rad: a joint that stays in this range may be held
SLOW = 0.05  # of the top speed: near a reversal friction may have either sign
STICTION = 1.5  # of the level of dry friction at low speed: friction at rest may exceed it
RESTING = 4.0  # s: an arm that rests for longer is compared with its median torque
HELD = 1.5  # of the level of dry friction: change of the friction of an arm that rests
BISQUARE = 4.685  # tuning constant of Tukey's bisquare: 95 % efficiency for Gaussian errors
LATEST = 0.1  # s: the longest delay of a torque signal that a diagnosis names
ROUNDS = 12  # of the reweighted regression
FEWEST_MOVING = 50  # samples in motion for a scale of their own


@dataclass(frozen=True, eq=False)
class ResidualSignals:
    """Error of a fit along one segment at M instants.

    Attributes
    ----------
    segment : Processed
    time : (M,)
        s, on the recording's clock.
    error : (M, n)
        Measured − predicted torque, N·m.
    transient : (M, n)
        Error without what functions of the joint's own motion explain, N·m.
    slack : (M, n)
        Torque that dry friction may add or not, N·m.
    held : (M, n)
        Level of dry friction where a joint is held, else 0: it balances part of a force, N·m.
    still : (M, n) bool
        Whether a joint stays in a small range.
    state : (M, n, 3)
        Velocity, acceleration and load of each joint relative to their largest values.
    place, direction : (M, n)
        Position of each joint relative to its range, and sign of its velocity.
    """

    segment: Processed
    time: Array
    error: Array
    transient: Array
    slack: Array
    held: Array
    still: Mask
    state: Array
    place: Array
    direction: Array

    @classmethod
    def of(cls, fit: Fit, segment: Processed) -> ResidualSignals:
        """Return the signals of a segment with torque, temperatures relative to the fit's."""
        assert segment.tau is not None
        compiled, links = fit.compiled, fit.link_parameters
        torque = torque_along(compiled, segment, fit.parameters, fit.shapes)
        error = segment.filter(segment.tau - torque)
        motion = segment.q, segment.dq, segment.ddq
        q, dq, ddq = (segment.filter(x) for x in motion)
        load = segment.filter(compiled.inverse_dynamics(*motion, links))
        still, top = _still(q, segment), np.maximum(np.abs(dq).max(axis=0), 1e-9)
        uncertain = friction_torque_std(compiled, segment, fit.shapes, fit.parameters)
        level = segment.filter(
            dry_level(compiled, segment, slice(None), fit.shapes, fit.parameters)
        )
        # The sign of a joint that is held is unknown: the prediction errs by up to both levels.
        slack = np.maximum(
            DEVIATIONS * uncertain, np.where(np.abs(dq) < SLOW * top, 2.0, 0.0) * level
        )
        slack[still] = 2.0 * STICTION * level[still]
        rests = _rests(still, segment)
        for rest in rests:
            slack[rest] = HELD * level[rest]
        common = common_effect_columns(compiled, segment, links)
        own = np.stack([np.ones_like(q), np.tanh(10.0 * dq / top), dq / top, load, q], axis=-1)
        columns = np.concatenate([common, own, _late_torque(segment, torque)], axis=-1)
        transient = np.column_stack(
            [_without_columns(error[:, j], columns[:, j], ~still[:, j]) for j in range(fit.model.n)]
        )
        if rests:
            held = replace(segment, dq=np.zeros_like(segment.q), ddq=np.zeros_like(segment.q))
            static = torque_along(compiled, held, fit.parameters, fit.shapes)
            at_rest = segment.filter(segment.tau - static)
            for rest in rests:
                transient[rest] = at_rest[rest] - np.median(at_rest[rest], axis=0)
        motions = np.where(still, 0.0, dq), np.where(still, 0.0, ddq), load
        relative = [x / np.maximum(np.abs(x).max(axis=0), 1e-9) for x in motions]
        state = np.stack(relative, axis=-1)
        return cls(
            segment,
            segment.filtered_time,
            error,
            transient,
            np.abs(slack),
            np.where(still, level, 0.0),
            still,
            state,
            q / np.maximum(np.ptp(q, axis=0), 1e-9),
            np.sign(dq),
        )

    @property
    def excess(self) -> Array:
        """Transient error beyond what dry friction may add (M, n), N·m.

        In motion it is at most the error: the columns that explain the errors of a joint that
        sticks at its reversals produce torque shortly after them, too, where the fit has no error.
        """
        found = np.abs(self.transient)
        found = np.where(self.still, found, np.minimum(found, np.abs(self.error)))
        return np.maximum(found - self.slack, 0.0)


def robust_scale(values: Array) -> float:
    """Return the standard deviation of the main part of values (k,), from their median size."""
    return float(1.4826 * np.median(np.abs(values))) if len(values) else 0.0


def _still(q: Array, segment: Processed) -> Mask:
    """Return where each joint stays in a small range for a while (M, n)."""
    time = segment.filtered_time
    step = float(time[1] - time[0]) if len(time) > 1 else 1.0
    width = max(int(STILL_TIME / step), 1)
    ranges = maximum_filter1d(q, width, axis=0) - minimum_filter1d(q, width, axis=0)
    return np.asarray(ranges < STILL_RANGE)


def _rests(still: Mask, segment: Processed) -> list[slice]:
    """Return the stretches in which the whole arm rests for a while."""
    time = segment.filtered_time
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.all(axis=1).astype(int), [0]])))
    runs = [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return [slice(a, b) for a, b in runs if time[b - 1] - time[a] > RESTING]


def _late_torque(segment: Processed, torque: Array) -> Array:
    """Return filtered columns (M, n, k) of torque that is recorded late or through a filter.

    A late change of dry friction at every reversal is a short error, but no contact.

    Parameters
    ----------
    segment : Processed
    torque : (K, n)
        Of the model, N·m.
    """
    count = max(round(2.0 * segment.cutoff * LATEST), 1)
    delays = LATEST * np.arange(1, count + 1) / count
    changes = [segment.filter(delayed_change(segment.t, torque, d)) for d in delays]
    return np.stack(changes, axis=-1)


def _without_columns(error: Array, columns: Array, moving: Mask) -> Array:
    """Return an error (M,) without what columns (M, k) explain, resistant to outliers.

    Where a joint is held, its error is taken relative to its median there.
    """
    found = error.copy()
    if not moving.all():
        found[~moving] -= np.median(error[~moving])
    if moving.sum() < max(FEWEST_MOVING, 3 * columns.shape[1]):
        found[moving] -= np.median(error[moving]) if moving.any() else 0.0
        return found
    own = columns[moving] / np.maximum(np.linalg.norm(columns[moving], axis=0), 1e-12)
    target, weight = error[moving], np.ones(int(moving.sum()))
    rest = target
    for _ in range(ROUNDS):
        root = np.sqrt(weight)[:, None]
        values = np.linalg.lstsq(root * own, root[:, 0] * target, rcond=1e-8)[0]
        rest = target - own @ values
        size = np.abs(rest) / max(BISQUARE * robust_scale(rest), 1e-12)
        weight = np.where(size < 1.0, (1.0 - np.minimum(size, 1.0) ** 2) ** 2, 0.0)
    found[moving] = rest
    return found
