"""One step of a diagnosis: an effect, its parameters, errors and evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.identification.fit import Fit
from lieid_casadi.json_numbers import number_or_none, numbers_or_none

if TYPE_CHECKING:
    from lieid_casadi.diagnosis.screening.candidates import Candidate
    from lieid_casadi.diagnosis.search.search_results import AcceptedEffect, Significance

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Evidence:
    """Evidence for a step.

    Attributes
    ----------
    significance : Significance
        In the last model, in addition to all other steps.
    joint : int
        From 0: the joint of the effect; of an effect on all joints that whose error falls most.
    effect_size : float
        RMS of the residual that the effect explains on that joint, N·m.
    held_out_before, held_out_after : float
        Error of that joint of the last model without the effect and with it, N·m: on held-out
        parts of the training, or on the new recording if the model is kept.
    confirmed : bool or None
        Whether the error on the test falls; None without a test.
    selected_with_rivals : float
        Fraction of block-bootstrap repetitions in which the effect or one of its rivals is
        selected.
    """

    significance: Significance
    joint: int
    effect_size: float
    held_out_before: float
    held_out_after: float
    confirmed: bool | None
    selected_with_rivals: float = float("nan")

    @property
    def log10_p(self) -> float:
        """log₁₀ of the family-wise p-value over all candidates that were screened."""
        return self.significance.log10_p

    def to_dict(self) -> dict[str, Any]:
        """Return the evidence for JSON: p = 1 − (1 − P(χ² ≥ statistic))^family_size."""
        s = self.significance
        return {
            "p_value": float(10.0 ** max(s.log10_p, -300.0)),
            "log10_p": max(s.log10_p, -1e6),
            "statistic": s.gain,
            "degrees_of_freedom": s.degrees,
            "family_size": s.tests,
            "dispersion": s.dispersion,
            "effective_rows": s.rows,
            "joint": self.joint + 1,
            "effect_size": self.effect_size,
            "rms_cv_before": self.held_out_before,
            "rms_cv_after": self.held_out_after,
            "test_confirms": self.confirmed,
            "selected_with_rivals": number_or_none(self.selected_with_rivals),
        }


@dataclass(frozen=True, eq=False)
class DiagnosisStep:
    """One effect that was found.

    Attributes
    ----------
    label : str
        As on the command line, ``load_friction:2``.
    effect : str
        Its name.
    joints : tuple of int
        From 0; target and source for couplings, none for effects on the whole arm.
    parameters : dict
        Estimated coefficients and shape parameters by name.
    units : dict
        Unit of each parameter.
    rms_train, rms_test : (n,) or None
        Error of each joint after this step, N·m. ``rms_test`` is None without a test,
        ``rms_train`` if the model is kept.
    evidence : Evidence
    indistinguishable : tuple of (Candidate, str)
        Rivals, and the kind of rivalry: ``exact`` if no data can separate the two, ``data`` if
        these data cannot.
    rival_pairs : tuple of (Candidate, Candidate)
        Pairs of effects that together fit as well.
    fit : Fit or None
        With this effect and those before it; None if the model is kept.
    moving : (n,) or None
        Test error of joints in motion, N·m.
    share : float
        RMS of the torque that the effect explains, relative to the RMS of the measured torque of
        the joint where the error falls most.
    selected : float
        Fraction of block-bootstrap repetitions of the screening in which it is selected again.
    """

    label: str
    effect: str
    joints: tuple[int, ...]
    parameters: dict[str, float]
    units: dict[str, str]
    rms_train: Array | None
    rms_test: Array | None
    evidence: Evidence
    indistinguishable: tuple[tuple[Candidate, str], ...]
    rival_pairs: tuple[tuple[Candidate, Candidate], ...] = ()
    fit: Fit | None = None
    moving: Array | None = None
    share: float = float("nan")
    selected: float = float("nan")

    @classmethod
    def of(
        cls,
        accepted: AcceptedEffect,
        *,
        confirmed: bool | None,
        rms_train: Array | None,
        rms_test: Array | None,
        moving: Array | None,
    ) -> DiagnosisStep:
        """Return the step of an accepted effect.

        Parameters
        ----------
        accepted : AcceptedEffect
        confirmed : bool or None
            Whether the error on the test falls; None without a test.
        rms_train, rms_test, moving : (n,) or None
            Errors after the step, N·m.
        """
        before, after = accepted.errors[:, accepted.joint]
        effect_size = float(np.sqrt(max(before**2 - after**2, 0.0)))
        return cls(
            label=accepted.candidate.placement.label,
            effect=accepted.candidate.name,
            joints=accepted.candidate.joints,
            parameters=accepted.parameters,
            units=accepted.units,
            rms_train=rms_train,
            rms_test=rms_test,
            evidence=Evidence(
                significance=accepted.significance,
                joint=accepted.joint,
                effect_size=effect_size,
                held_out_before=float(before),
                held_out_after=float(after),
                confirmed=confirmed,
                selected_with_rivals=accepted.selected_with_rivals,
            ),
            indistinguishable=accepted.rivals,
            rival_pairs=accepted.rival_pairs,
            fit=accepted.fit,
            moving=moving,
            selected=accepted.selected,
            share=effect_size / accepted.torque_rms if accepted.torque_rms else float("nan"),
        )

    @property
    def rms_cv(self) -> Array | None:
        """Error (n,) on held-out blocks of the training, joints in motion, N·m; as `fit` None."""
        return None if self.fit is None else self.fit.rms_cv

    def to_dict(self) -> dict[str, Any]:
        """Return the step for JSON, joints from 1."""
        return {
            "effect": self.effect,
            "joints": [j + 1 for j in self.joints],
            "label": self.label,
            "parameters": self.parameters,
            "units": self.units,
            "rms_train": numbers_or_null(self.rms_train),
            "rms_test": numbers_or_null(self.rms_test),
            "rms_test_moving": numbers_or_null(self.moving),
            "rms_cv": numbers_or_null(self.rms_cv),
            "share": number_or_none(self.share),
            "selected": number_or_none(self.selected),
            "confirmed": self.evidence.confirmed,
            "evidence": self.evidence.to_dict(),
            "indistinguishable": [
                {"effect": c.name, "joints": [j + 1 for j in c.joints], "kind": kind}
                for c, kind in self.indistinguishable
            ],
            "rival_pairs": [
                [{"effect": c.name, "joints": [j + 1 for j in c.joints]} for c in pair]
                for pair in self.rival_pairs
            ],
        }


def numbers_or_null(values: Sequence[float] | Array | None) -> list[float | None] | None:
    """Return a list with None in place of numbers that are not finite; None for None."""
    return None if values is None else numbers_or_none(values)
