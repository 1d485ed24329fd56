"""Effects that a search accepted, rejected, or proposes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.search.parameter_checks import belongs_to
from lieid_casadi.effects import Placement
from lieid_casadi.identification import Fit
from lieid_casadi.model import Model
from lieid_casadi.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Significance:
    """Statistical evidence for an effect.

    Attributes
    ----------
    log10_p : float
        log₁₀ of the family-wise p-value: 1 − (1 − p)^tests with p of a χ² distribution.
    gain : float
        The statistic: fall of the whitened sum of squares, divided by the dispersion.
    degrees : int
        Degrees of freedom of the χ² distribution.
    rows : int
        Whitened rows of all joints: the effective sample size.
    tests : float
        Number of independent tests in the family of all candidates and grid points.
    dispersion : float
        Mean square of the whitened residual on the joints where the effect acts, at least 1.
    """

    log10_p: float
    gain: float
    degrees: int
    rows: int
    tests: float
    dispersion: float


@dataclass(frozen=True, eq=False)
class AcceptedEffect:
    """One accepted effect.

    Attributes
    ----------
    candidate : Candidate
    parameters : dict
        Coefficients and shape parameters by name.
    units : dict
        Unit of each parameter.
    errors : (2, n)
        Error of each joint before and after, N·m: held out if the model is fitted again, of the
        new recording if it is kept.
    joint : int
        Where the error falls most, from 0.
    torque_rms : float
        RMS of the measured torque on that joint, N·m.
    significance : Significance
    rivals : tuple of (Candidate, str)
        Candidates that could take its place, and the kind of rivalry, ``exact`` or ``data``.
    fit : Fit or None
        With this effect and those accepted before; None if the model is kept.
    selected : float
        Fraction of block-bootstrap repetitions of the screening in which it is selected again.
    selected_with_rivals : float
        The same for the effect or one of its rivals.
    rival_pairs : tuple of (Candidate, Candidate)
        Pairs of candidates that together could take its place.
    """

    candidate: Candidate
    parameters: dict[str, float]
    units: dict[str, str]
    errors: Array
    joint: int
    torque_rms: float
    significance: Significance
    rivals: tuple[tuple[Candidate, str], ...]
    fit: Fit | None = None
    selected: float = float("nan")
    selected_with_rivals: float = float("nan")
    rival_pairs: tuple[tuple[Candidate, Candidate], ...] = ()


def fitted_parameters(fit: Fit, placement: Placement) -> dict[str, float]:
    """Return the coefficients and shape parameters of a placed effect by name."""
    values = zip(fit.fitted, np.concatenate([fit.values, fit.shapes]), strict=True)
    return {
        p.name.rpartition(".")[2]: float(value)
        for p, value in values
        if belongs_to(placement, p.name, p.joint)
    }


def with_fit(effect: AcceptedEffect, fit: Fit) -> AcceptedEffect:
    """Return an accepted effect with another fit and its parameters."""
    parameters = fitted_parameters(fit, effect.candidate.placement)
    return replace(effect, fit=fit, parameters=parameters)


def parameter_units(
    robot: Robot, placement: Placement, parameters: Iterable[str]
) -> dict[str, str]:
    """Return the unit of named parameters of a placed effect, N for N·m on a prismatic joint.

    Parameters
    ----------
    robot : Robot
    placement : Placement
    parameters : iterable of str
        Names without the effect's.
    """
    model = Model.of_placements(robot, (placement,))
    units = {p.name.rpartition(".")[2]: p.unit for p in (*model.columns, *model.shapes)}
    return {name: units[name] for name in parameters}


@dataclass(frozen=True, eq=False)
class Replacement:
    """A candidate that is to take the place of an accepted effect.

    Attributes
    ----------
    effect : AcceptedEffect
    candidate : Candidate
    shapes : (s,)
        Shape parameters of the candidate.
    reason : str
        Why the effect is removed.
    """

    effect: AcceptedEffect
    candidate: Candidate
    shapes: Array
    reason: str


@dataclass(frozen=True)
class RejectedEffect:
    """A candidate that was selected and not accepted, or accepted and removed, and why.

    Attributes
    ----------
    candidate : Candidate
    reason : str
    final : bool
        Whether it stays rejected; otherwise it is tried again after the next acceptance.
    """

    candidate: Candidate
    reason: str
    final: bool = True


@dataclass(frozen=True)
class Difference:
    """An effect that explains the residual of some training recordings and not of the others.

    Attributes
    ----------
    label, effect : str
        ``base_tilt``, ``encoder_offset:2``; its name.
    joints : tuple of int
        From 0.
    recordings : tuple of str
        Names of the recordings that it explains.
    parameters : dict
        Coefficients there.
    is_change : bool
        Whether the model has the effect: the coefficients are changes of its own.
    """

    label: str
    effect: str
    joints: tuple[int, ...]
    recordings: tuple[str, ...]
    parameters: dict[str, float]
    is_change: bool = False

    def to_dict(self) -> dict[str, Any]:
        """Return it for JSON, joints from 1."""
        return {
            "effect": self.effect,
            "joints": [j + 1 for j in self.joints],
            "recordings": list(self.recordings),
            "parameters": self.parameters,
            "is_change": self.is_change,
        }


@dataclass(frozen=True)
class Proposal:
    """A step that is about to be accepted.

    Attributes
    ----------
    label : str
        Of the effect: ``load_friction:2``.
    joint : int
        Where the error falls most, from 0.
    before, after : float
        Held-out error on that joint, N·m.
    """

    label: str
    joint: int
    before: float
    after: float
