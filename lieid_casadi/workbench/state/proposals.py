"""Effects that a diagnosis proposes, as the page shows and saves them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ProposedEffect:
    """An effect that a diagnosis proposes.

    Attributes
    ----------
    label : str
        ``load_friction:2``.
    effect : str
        Its name.
    joints : tuple of int
        From 1; none for effects on the whole arm.
    joint : int
        Where the error falls most, from 0.
    before, after : float
        Held-out error on that joint, N·m.
    selected : float or None
        Fraction of block-bootstrap repetitions in which it was chosen; None if not computed.
    confirmed : bool or None
        Whether the error on the test falls; None without a test.
    rivals : tuple of (str, str)
        Labels of rivals, and their kind, ``exact`` or ``data``.
    value : str
        Parameters as text, for changes since a fit.
    parameters : tuple of (str, float)
        Names and values of coefficients and shape parameters.
    """

    label: str
    effect: str
    joints: tuple[int, ...]
    joint: int
    before: float | None
    after: float | None
    selected: float | None = None
    confirmed: bool | None = None
    rivals: tuple[tuple[str, str], ...] = ()
    value: str = ""
    parameters: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class FoundEffects:
    """Result of a diagnosis.

    Attributes
    ----------
    verdict, sentence : str
    proposed : tuple of ProposedEffect
    effects : tuple of str
        Of the model that was diagnosed.
    unexplained : tuple of str
        Sentences on the unexplained residual.
    shapes : tuple of (str, float)
        Labels and values of the shape parameters with all proposed effects.
    """

    verdict: str
    sentence: str
    proposed: tuple[ProposedEffect, ...]
    effects: tuple[str, ...]
    unexplained: tuple[str, ...] = ()
    shapes: tuple[tuple[str, float], ...] = ()
