"""Effects as changes of a model that is not fitted again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.effects.arm_effect import SegmentModel
from lieid_casadi.effects.effect import Effect, Signals
from lieid_casadi.effects.payload import Payload
from lieid_casadi.effects.registry import make

LEAST_STEP = 1e-3  # N·m, of the load in the slope of load friction
LEAST_MASS = 1e-3  # kg
INERTIA = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))


class IncrementalEffect(Effect):
    """An effect added to a model in place of, or together with, another effect."""

    def __init__(
        self, effect: Effect, replaced: Sequence[Effect], companions: Sequence[Effect]
    ) -> None:
        self.name = effect.name  # type: ignore[misc]
        self.option, self.formula = effect.option, effect.formula
        self.shapes, self.states, self.dry = effect.shapes, effect.states, effect.dry
        self._effect, self._replaced, self._companions = effect, replaced, companions
        every = (effect, *replaced, *companions)
        self.signals = tuple({signal for each in every for signal in each.signals})
        self.coefficients = sum((c.coefficients for c in companions), effect.coefficients)

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """Return the columns of the change."""
        own = list(self._effect.columns(s, shape))
        for replaced in self._replaced:
            own[0] = own[0] - replaced.columns(s, {})[0]
        return own + [c for each in self._companions for c in each.columns(s, {})]

    def advance(self, before: Signals, now: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """Return the states after a step; ``before`` contains those at its beginning."""
        return self._effect.advance(before, now, shape)


class AddedPayload(Payload):
    """A payload on an arm that is not fitted again, with what follows from its mass and place.

    That is the inertia of a point mass, and the change of the model's load friction.
    """

    linear = False

    def segment_columns(self, arm: SegmentModel, joint: int, values: Array) -> Array:
        """Return the columns (K, n, 4): columns · values is the whole change of the torque.

        The inertia is homogeneous of degree one in m and m·c, which are the values, and therefore
        equal to its gradient times the values. Load friction of a joint depends on the load of this
        joint alone, so that its change is in proportion to the payload's torque there.
        """
        whole = arm.tool_regressor()
        columns = whole[:, :, :4] + whole[:, :, 4:] @ _point_mass_gradient(values)
        torque = columns @ values
        step = np.where(np.abs(torque) > LEAST_STEP, torque, LEAST_STEP)
        change = arm.joint_torque_at(arm.load + step) - arm.joint_torque_at(arm.load)
        return np.asarray(columns * (1.0 + change / step)[:, :, None])


def _point_mass_gradient(values: Array) -> Array:
    """Return the gradient (6, 4) of the inertia of a point mass with respect to m and m·c.

    The inertia is Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the origin; zero without a positive mass.
    """
    mass, moment = values[0], values[1:]
    if mass < LEAST_MASS:
        return np.zeros((6, 4))
    rows = []
    for i, j in INERTIA:
        both = np.eye(3)[i] * moment[j] + np.eye(3)[j] * moment[i]
        size = (moment @ moment if i == j else 0.0) - moment[i] * moment[j]
        slope = (2.0 * moment if i == j else 0.0) - both
        rows.append([-size / mass**2, *(slope / mass)])
    return np.array(rows)


def incremental(effect: Effect, present: Sequence[str]) -> Effect:
    """Return an effect as the change that it makes to a model with the named effects."""
    replaced = [make(name) for name in effect.replaces if name in present]
    companions = [make(name) for name in effect.accompanied_by]
    if isinstance(effect, Payload):
        return AddedPayload()
    return IncrementalEffect(effect, replaced, companions) if replaced or companions else effect
