"""The sigmoid that was published for the Franka Panda."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from lieid_casadi.effects.effect import Coefficient, Effect, Shape, Signals, register


@register
class SigmoidFriction(Effect):
    """Friction that rises steeply but smoothly through rest and levels out.

    In place of `coulomb` and `viscous`: Gaz, Cognetti, Oliva, Robuffo Giordano, De Luca,
    "Dynamic identification of the Franka Emika Panda robot …", IEEE RA-L 2019. Zero at rest;
    φ3 makes the two directions unequal.
    """

    name = "sigmoid_friction"
    formula = "φ1/(1 + e^{−φ2·(q̇+φ3)}) − φ1/(1 + e^{−φ2·φ3})"
    coefficients = (Coefficient("phi1", "N·m"),)
    shapes = (
        Shape("phi2", "s/rad", 8.0, 0.5, 200.0),
        Shape("phi3", "rad/s", 0.0, -0.3, 0.3),
    )
    signals = ("dq",)
    dry = True

    def columns(self, s: Signals, shape: Mapping[str, ca.SX]) -> Sequence[ca.SX]:
        """See the class."""
        steep, shift = shape["phi2"], shape["phi3"]
        # 1/(1 + e^{−x}) = (1 + tanh(x/2))/2, which does not overflow
        return [(ca.tanh(steep * (s.dq + shift) / 2) - ca.tanh(steep * shift / 2)) / 2]
