"""A motor that moves its link through a transmission with play: two masses and a contact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

CONTACT = 200.0  # rad/s, frequency of motor and link on the compliance of their contact
DAMPING = 0.5  # of that oscillation, relative to critical damping


@dataclass
class MotorWithPlay:
    """Motor side of a joint with play; friction of the joint acts on it.

    The link feels the contact alone: a spring and a damper that push and never pull while the
    angles differ by more than half of the play.

    Attributes
    ----------
    inertia, link_inertia : float
        Of the motor, and of what it drives, kg·m²; the second one sets the contact's stiffness.
    play : float
        rad.
    coulomb, viscous, offset : float
        Friction, N·m and N·m·s/rad.
    q, dq : float
        State of the motor, rad and rad/s.
    """

    inertia: float
    link_inertia: float
    play: float
    coulomb: float
    viscous: float
    offset: float
    q: float
    dq: float = 0.0

    def contact(self, q: float, dq: float) -> float:
        """Return the torque on the link, N·m, at its position and velocity."""
        reduced = self.inertia * self.link_inertia / (self.inertia + self.link_inertia)
        half, twist = 0.5 * self.play, self.q - q
        depth = twist - float(np.clip(twist, -half, half))
        if depth == 0.0:
            return 0.0
        speed = self.dq - dq
        torque = reduced * CONTACT * (CONTACT * depth + 2.0 * DAMPING * speed)
        return torque if torque * depth > 0.0 else 0.0

    def step(self, constant: float, gain: float, contact: float, h: float) -> float:
        """Move by h, s, under the torque constant − gain·a of its drive; return the middle angle.

        Parameters
        ----------
        constant, gain : float
            N·m and N·m·s²/rad; a is the acceleration of the motor.
        contact : float
            Torque on the link, N·m.
        h : float
            s.
        """
        middle = self.q + 0.5 * h * self.dq
        total = self.inertia + gain + 0.5 * h * self.viscous
        free = constant - contact - self.offset - self.viscous * self.dq
        speed = self.dq + h * free / total
        level = h * self.coulomb / total
        speed = float(np.sign(speed) * max(abs(speed) - level, 0.0))
        self.q, self.dq = middle + 0.5 * h * speed, speed
        return middle
