"""The explainable part of one joint's residual, and which signals it depends on."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from lieid_casadi.diagnosis.screening.smooth_functions import has_memory, measured_signal
from lieid_casadi.diagnosis.wording import join_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lieid_casadi.diagnosis.residual.shapes import SmoothShape
    from lieid_casadi.diagnosis.residual.symbolic_formula import Formula


@dataclass(frozen=True)
class PartialCandidate:
    """An effect that explains part of an unexplained part and is not in the model.

    Attributes
    ----------
    label : str
        As on the command line, ``stribeck:2``.
    effect : str
        Its name.
    joints : tuple of int
        From 0; target and source for couplings.
    part : float
        Of what the smooth functions explain, 0 to 1.
    reason : str
        Why it was not added to the model.
    """

    label: str
    effect: str
    joints: tuple[int, ...]
    part: float
    reason: str

    def to_dict(self) -> dict[str, Any]:
        """Return it for JSON, joints from 1."""
        return {
            "effect": self.effect,
            "joints": [j + 1 for j in self.joints],
            "label": self.label,
            "part": self.part,
            "reason": self.reason,
        }


@dataclass(frozen=True)
class Unexplained:
    """An explainable part of one joint's residual.

    Attributes
    ----------
    joint : int
        From 0.
    fraction : float
        Of the variance of the joint's residual, on held-out blocks of time.
    depends_on : tuple of str
        At most three signals, those that explain most first. Empty if the error is far above
        that of a complete model and no smooth function of the signals explains it.
    terms : tuple of tuple of str
        Signals of each smooth function, the one that explains most first; ``play3`` is the past
        of ``load3``.
    shapes : tuple of SmoothShape
        These functions, with confidence bands; none of functions of the past.
    formula : Formula or None
        A short formula that explains nearly as much.
    confirmed : bool or None
        Whether the formula, or the smooth functions where there is none, reduce the test error of
        the joint; reported only. None without a test and for functions of time.
    candidates : tuple of PartialCandidate
        Effects that explain part of it, those that explain most first.
    contained_in : str
        Label of the library's effect whose formula contains it, or empty.
    carries_over : bool
        Whether the formula, or the first smooth function where there is none, reduces the error
        of training data that was held out; never for a function of time.
    ratio : float or None
        If it depends on no signal: the joint's error relative to the noise floor or, where a fit
        is kept, to the error that is expected of it.
    """

    joint: int
    fraction: float
    depends_on: tuple[str, ...]
    terms: tuple[tuple[str, ...], ...] = ()
    shapes: tuple[SmoothShape, ...] = field(default=(), repr=False)
    formula: Formula | None = field(default=None, repr=False)
    confirmed: bool | None = None
    candidates: tuple[PartialCandidate, ...] = ()
    contained_in: str = ""
    carries_over: bool = True
    ratio: float | None = None

    @property
    def hysteresis(self) -> tuple[str, ...]:
        """The signals on whose past it depends: one value has several torques."""
        names = [name for term in self.terms for name in term if has_memory((name,))]
        return tuple(dict.fromkeys(map(measured_signal, names)))

    @property
    def signals(self) -> tuple[str, ...]:
        """The signals that it depends on, for sentences and tables."""
        past = self.hysteresis
        return tuple(f"{s} (with hysteresis)" if s in past else s for s in self.depends_on)

    @property
    def relation(self) -> str:
        """What the error of the joint follows, as the end of a sentence that begins with it."""
        part = f"{100 * self.fraction:.0f} % of the variance of the residual"
        if not self.depends_on:
            limit = f"{self.ratio:.2g} times that of a complete model" if self.ratio else "large"
            return f"the error is {limit} and follows none of the functions that were tried"
        if self.depends_on == ("t",):
            return f"{part} changes over the recording and follows no other signal"
        return f"{part} depends on {join_words(self.signals)}"

    def to_dict(self) -> dict[str, Any]:
        """Return it for JSON, joints from 1."""
        return {
            "joint": self.joint + 1,
            "fraction": self.fraction,
            "depends_on": list(self.depends_on),
            "hysteresis": list(self.hysteresis),
            "form": None if self.formula is None else self.formula.to_dict(),
            "confirmed": self.confirmed,
            "contained_in": self.contained_in or None,
            "carries_over": self.carries_over,
            "error_ratio": self.ratio,
            "candidates": [candidate.to_dict() for candidate in self.candidates],
            "shape": [shape.to_dict() for shape in self.shapes],
        }

    def as_effect_code(self) -> str:
        """Return Python code that registers it as a user-defined effect with free coefficients.

        See `own_effects` for the labels under which the effects are added to a model.
        """
        from lieid_casadi.diagnosis.residual.user_effect_code import own_effects

        return own_effects([self]).code

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the first smooth function as a curve with its band or as a map; not shown."""
        from lieid_casadi.diagnosis.residual.shape_plots import plot_shapes

        return plot_shapes([self], ax)
