"""A body attached to the tool."""

from collections.abc import Mapping

import casadi as ca
import numpy as np

from lieid_casadi.effects.arm_effect import ArmEffect, Array, InstantModel, SegmentModel
from lieid_casadi.effects.effect import Coefficient
from lieid_casadi.effects.registry import register

LEAST_STEP = 1e-3  # N·m, of the load in the slope of load friction
LEAST_MASS = 1e-3  # kg
INERTIA = np.tril_indices(3)


@register
class Payload(ArmEffect):
    """Mass and first moments of a body attached to the tool: τ = Y_tool·[m, m·c].

    m in kg, m·c (3,) in kg·m in the tool frame; the inertia about the tool's origin is neglected.
    In a fit with free link parameters it is absorbed by those of the last link; it is identifiable
    as a change of a fit.
    """

    name = "payload"
    finding = ("A body is attached to the tool",)
    change = ("The body at the tool has become heavier", "The body at the tool has become lighter")
    formula = "Y_tool·[m, m·c]"
    coefficients = (
        Coefficient("m", "kg", limit=500.0, meaning="mass"),
        *(Coefficient(f"mc{x}", "kg·m", meaning=f"first moment along {x}") for x in "xyz"),
    )
    whole_arm = True
    on_measurement = False
    linear = True
    revealed_by = "gravity torque in at least three orientations of the tool"
    confused_with = {
        "external_wrench": "similar over few orientations; a force keeps its direction",
        "torque_gain": "similar on a single joint; a payload acts on all joints before it",
    }
    typical = "up to the arm's rated payload"
    references = ("Swevers, Verdonck, De Schutter, IEEE Control Systems Magazine 27(5), 2007",)

    def size_text(self, parameters: Mapping[str, float]) -> str:
        """Return mass and centre of mass; a lost body has a negative mass."""
        mass = parameters["m"]
        if not mass:
            return ""
        com = ", ".join(f"{1000.0 * parameters[f'mc{x}'] / mass:z.0f}" for x in "xyz")
        return f"{abs(mass):.3g} kg, centre of mass at ({com}) mm in the tool frame"

    def segment_columns(self, arm: SegmentModel, joint: int, values: Array) -> Array:
        return arm.tool_regressor()[:, :, :4]

    def instant_columns(self, arm: InstantModel, joint: int, values: ca.SX) -> ca.SX:
        return arm.tool_regressor()[:, :4]

    def tool_body(self, values: ca.SX) -> ca.SX:
        """Return mass and first moments, with an inertia of zero."""
        return ca.vertcat(values, ca.SX(6, 1))


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
    mass, moment, eye = values[0], values[1:], np.eye(3)
    if mass < LEAST_MASS:
        return np.zeros((6, 4))
    half = moment @ moment * eye - np.outer(moment, moment)
    both = [np.outer(axis, moment) + np.outer(moment, axis) for axis in eye]
    slopes = [2.0 * m * eye - own for m, own in zip(moment, both, strict=True)]
    return np.array([(x / mass)[INERTIA] for x in (-half / mass, *slopes)]).T
