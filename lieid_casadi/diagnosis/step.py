"""What a diagnosis found: effects with their numbers, and errors without an explanation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from lieid_casadi.arrays import Array, Indices
from lieid_casadi.json_numbers import number_or_none, numbers_or_none
from lieid_casadi.simulation.integration import FARTHEST, LEAST_ERROR

Status = Literal["named", "one_of", "shape"]
#: Why the name of an effect without rivals is not certain: a path without some held-out part does
#: not contain it, its gain or its coefficients are within noise, friction that changes at one
#: instant does as well, dry friction reverses late, it is torque before its motion, or more than it
#: explains is left unexplained.
Doubt = Literal["", "selected", "gain", "coefficients", "instant", "late_friction", "lead", "rest"]

LEAST_STRETCHES = 2  # independent ones in each held-out part, for full evidence


@dataclass(frozen=True)
class Rival:
    """An effect that would do as well as a step's.

    ``kind`` is ``exact`` if no data can separate the two, ``data`` if these data cannot. ``joints``
    are from 0, as those of a step.
    """

    label: str
    effect: str
    joints: tuple[int, ...]
    kind: str

    def to_dict(self) -> dict[str, Any]:
        """Return the rival for JSON, joints from 1."""
        return {"effect": self.effect, "joints": [j + 1 for j in self.joints], "kind": self.kind}


@dataclass(frozen=True)
class Fall:
    """RMS error in motion on a step's joint without it, refitted, minus with it, N·m.

    On the training recordings, on blocks of them that are held out, and on the test, if any.
    """

    train: float | None
    cv: float | None
    test: float | None


@dataclass(frozen=True)
class Evidence:
    """What the held-out parts say of an effect.

    Attributes
    ----------
    gains : tuple of float
        ln of the error of each held-out part without the effect over that with it. The choice of
        the effect did not see the part.
    expected : tuple of float
        The same if what the effect changes in a part were uncorrelated with the error there.
    deviations : float
        Mean of the gains in its standard errors, from their scatter about those expected.
    gain_certainty : float
        The number of standard errors that noise exceeds as often with equal parts. It is smaller
        where few parts show the effect, so that the standard error is uncertain.
    selected : float
        Fraction of the paths, each without one part, that contain the effect.
    selected_with_rivals : float
        The same for the effect or one of its rivals.
    independent : int
        Stretches of the recordings as long as the correlation of the residual: with few of them
        the standard error is uncertain.
    coefficient_deviations : float
        How far its coefficients in the final fit together are from zero: the standard deviations
        that noise exceeds as often (Wald's test); NaN where it has none.
    """

    gains: tuple[float, ...]
    expected: tuple[float, ...]
    deviations: float
    gain_certainty: float
    selected: float
    selected_with_rivals: float
    independent: int
    coefficient_deviations: float = float("nan")

    @property
    def certainty(self) -> float:
        """What decides on a name: the smaller one of the gain's and the coefficients' certainty."""
        return float(np.fmin(self.gain_certainty, self.coefficient_deviations))

    def to_dict(self) -> dict[str, Any]:
        """Return the evidence for JSON."""
        return {
            "gains": list(self.gains),
            "expected": list(self.expected),
            "deviations": number_or_none(self.deviations),
            "gain_certainty": number_or_none(self.gain_certainty),
            "coefficient_deviations": number_or_none(self.coefficient_deviations),
            "selected_with_rivals": self.selected_with_rivals,
            "independent_stretches": self.independent,
        }


@dataclass(frozen=True, eq=False)
class MotionGain:
    """How much better a second fit predicts the motion of the same windows of recordings.

    ``before`` and ``after`` (n,) are the RMS errors of the position at the windows' ends, rad.
    ``fall`` is the mean over parts of the time of ln(before/after), of the RMS errors at all
    instants of the part's windows, of one joint or over all of them; ``std`` is its standard
    error over the parts, ``window`` the windows' length, s.
    """

    before: Array
    after: Array
    fall: float
    std: float
    window: float

    @classmethod
    def of(
        cls, before: Array, after: Array, window: float, parts: Indices, joint: int | None = None
    ) -> MotionGain:
        """Compare errors (W, T, n) of two fits in windows, rad, in parts (W,) of time."""

        def rms(errors: Array) -> Array:
            return np.asarray(np.sqrt(np.mean(errors**2, axis=(0, 1))))

        def logarithms(errors: Array) -> Array:
            finite = np.nan_to_num(errors, nan=FARTHEST)  # a motion that has left every range
            own = [rms(finite[parts == k]) for k in np.unique(parts)]
            return np.asarray(np.log(np.maximum(own, LEAST_ERROR)))

        every = logarithms(before) - logarithms(after)
        falls = np.mean(every, axis=1) if joint is None else every[:, joint]
        std = float(falls.std(ddof=1) / np.sqrt(len(falls))) if len(falls) > 1 else np.inf
        return cls(rms(before[:, -1:]), rms(after[:, -1:]), float(falls.mean()), std, window)

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers for JSON; angles in rad."""
        return {
            "window": self.window,
            "before": numbers_or_none(self.before),
            "after": numbers_or_none(self.after),
            "fall": number_or_none(self.fall),
            "std": number_or_none(self.std),
        }


@dataclass(frozen=True, eq=False)
class Step:
    """One effect of the final model that the first model lacks, or one change since a fit.

    Attributes
    ----------
    label, effect : str
        ``load_friction:2``, and its name.
    joints : tuple of int
        From 0; target and source for couplings, none for effects on the whole arm.
    joint : int
        Where it counts: its own joint, or that whose error falls most.
    status : str
        ``named``, ``one_of`` or ``shape``; see `lieid_casadi.diagnose`.
    parameters, std : dict
        Coefficients and shape parameters of the final fit, and their standard deviations.
    units : dict
    before, after : float
        RMS error in motion on ``joint`` without the step and with it, N·m: cross-validated, or on
        the new recordings if the model is kept.
    fall : Fall
    share : float
        RMS of the torque that it explains relative to the joint's torque.
    evidence : Evidence
    doubt : str
        Why its name is not certain, rivals aside, or empty.
    rivals : tuple of Rival
        Nearest first.
    group : int
        From 1: steps with the same effect on single joints share one.
    depends_on : tuple of str
        Signals of a smooth function, ``dq3``.
    formula : str
        Close to a smooth function, with the part of its variance: ``−12.5·q4 (99 % …)``; empty
        where none is, and for effects of the library.
    errors : dict
        ``rms_train``, ``rms_test``, ``rms_test_moving``, ``rms_cv``: (n,) errors of the model with
        the steps up to this one, N·m, with the weights of the final fit; None where they do not
        exist. Those of the last step are the errors of the final fit.
    rival_pairs : tuple of tuple of Rival
        The effects, together, in whose place this one is.
    motion : MotionGain or None
        Of arms under commands that can be simulated: errors of the simulated motion on held-out
        data without the effect and with it.
    """

    label: str
    effect: str
    joints: tuple[int, ...]
    joint: int
    status: Status
    parameters: dict[str, float]
    std: dict[str, float]
    units: dict[str, str]
    before: float
    after: float
    fall: Fall
    share: float
    evidence: Evidence
    doubt: Doubt
    rivals: tuple[Rival, ...]
    group: int
    depends_on: tuple[str, ...]
    errors: dict[str, Array | None]
    formula: str = ""
    rival_pairs: tuple[tuple[Rival, ...], ...] = ()
    motion: MotionGain | None = None

    @property
    def confirmed(self) -> bool | None:
        """Whether the test error falls; None without a test."""
        return None if self.fall.test is None else self.fall.test > 0.0

    @property
    def part(self) -> float:
        """The fall of the error relative to the error without the step."""
        return 1.0 - self.after / self.before if self.before > 0.0 else 0.0

    def to_dict(self) -> dict[str, Any]:
        """Return the step for JSON, joints from 1."""
        return {
            "effect": self.effect,
            "joints": [j + 1 for j in self.joints],
            "label": self.label,
            "status": self.status,
            "parameters": self.parameters,
            "std": {name: number_or_none(value) for name, value in self.std.items()},
            "units": self.units,
            **{name: or_null(values) for name, values in self.errors.items()},
            "fall": {
                "joint": self.joint + 1,
                "train": self.fall.train,
                "cv": self.fall.cv,
                "test": self.fall.test,
            },
            "share": number_or_none(self.share),
            "selected": self.evidence.selected,
            "confirmed": self.confirmed,
            "evidence": self.evidence.to_dict(),
            "doubt": self.doubt,
            "indistinguishable": [rival.to_dict() for rival in self.rivals],
            "rival_pairs": [[rival.to_dict() for rival in pair] for pair in self.rival_pairs],
            "motion": None if self.motion is None else self.motion.to_dict(),
            "group": self.group,
            "depends_on": list(self.depends_on),
            "formula": self.formula,
        }


@dataclass(frozen=True)
class Unexplained:
    """Error of a joint that no model of the arm lowers on held-out data.

    Attributes
    ----------
    joint : int
        From 0.
    fraction : float
        Of the residual's variance that is not noise.
    ratio : float
        Error in motion relative to the noise floor or, of a kept model, to that of noise.
    depends_on : tuple of str
        Signals that it follows, ``t`` is time; none if they are not known.
    candidates : tuple of (str, str)
        Effects that explain part of it on the training data, and why each was not added.
    recordings : str
        Where it is that large: ``training recordings`` or ``test``; empty without a test.
    beyond_noise : bool
        Whether the error is so large; otherwise a part of it changes with time.
    differs : bool
        Whether a part of it differs between the recordings or changes with time.
    within : bool
        Whether the uncertainty of the fit's parameters explains it.
    """

    joint: int
    fraction: float
    ratio: float
    depends_on: tuple[str, ...] = ()
    candidates: tuple[tuple[str, str], ...] = ()
    recordings: str = ""
    beyond_noise: bool = True
    differs: bool = False
    within: bool = False

    @property
    def relation(self) -> str:
        """What the error is, as a clause."""
        if not self.beyond_noise:
            return f"{100 * self.fraction:.0f} % of the error's square change with time"
        where = f" on the {self.recordings}" if self.recordings else ""
        text = f"the error in motion{where} is {self.ratio:.2g} times what noise explains"
        if self.differs:
            return f"{text}; what differs between recordings or changes with time is a part of it"
        if self.within:
            return f"{text}, which uncertain parameters explain: fit longer or larger motion"
        rest = "neither an effect of the library nor a smooth function lowers it on held-out data"
        return f"{text}, and {rest}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {
            "joint": self.joint + 1,
            "fraction": self.fraction,
            "ratio": self.ratio,
            "depends_on": list(self.depends_on),
            "candidates": [{"effect": label, "reason": why} for label, why in self.candidates],
        }


@dataclass(frozen=True)
class Difference:
    """An effect that is not the same in all training recordings, or all of one; joints from 0.

    ``since``: time of the recording from which it is, s, of each since it began; None for all.
    ``period``: of a slow oscillation with time, s.
    ``fraction``: of the square of its joint's error on held-out data.
    ``depends_on``: time (``t``) and signals of a change in the course of a recording.
    """

    label: str
    effect: str
    joints: tuple[int, ...]
    recording: str
    parameters: dict[str, float]
    std: dict[str, float]
    units: dict[str, str]
    of_model: bool
    since: float | None = None
    period: float | None = None
    fraction: float = 0.0
    depends_on: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {
            "effect": self.effect,
            "joints": [j + 1 for j in self.joints],
            "label": self.label,
            "recordings": [self.recording],
            "from": self.since,
            "period": self.period,
            "parameters": self.parameters,
            "std": self.std,
            "is_change": self.of_model,
        }


def or_null(values: Array | None) -> list[float | None] | None:
    """Return numbers for JSON, with None in place of those that are not finite."""
    return None if values is None else numbers_or_none(np.asarray(values))
