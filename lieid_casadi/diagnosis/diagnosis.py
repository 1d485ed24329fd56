"""Result of a diagnosis: the verdict, the steps, and the unexplained residual."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import LieidWarning, warning_list
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.provenance import Source

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lieid_casadi.diagnosis.residual.unexplained import Unexplained
    from lieid_casadi.diagnosis.screening.aliases import Aliases
    from lieid_casadi.diagnosis.screening.candidates import Candidate
    from lieid_casadi.diagnosis.search.search_results import AcceptedEffect

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Evidence:
    """Evidence for a step.

    Attributes
    ----------
    log10_p : float
        log₁₀ of the family-wise p-value over all candidates that were screened.
    rows : int
        Effective sample size: whitened rows of all joints.
    effect_size : float
        RMS of the residual that the effect explains on the joint where the error falls most, N·m.
    held_out_before, held_out_after : float
        Error of that joint, N·m: of blocked cross-validation, or of the new recording if the
        model is kept.
    confirmed : bool or None
        Whether the error on the test falls; None without a test.
    """

    log10_p: float
    rows: int
    effect_size: float
    held_out_before: float
    held_out_after: float
    confirmed: bool | None

    def to_dict(self) -> dict[str, Any]:
        """Return the evidence for JSON."""
        return {
            "p_value": float(10.0 ** max(self.log10_p, -300.0)),
            "log10_p": max(self.log10_p, -1e6),
            "effective_rows": self.rows,
            "effect_size": self.effect_size,
            "rms_cv_before": self.held_out_before,
            "rms_cv_after": self.held_out_after,
            "test_confirms": self.confirmed,
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
    fit : Fit or None
        With this effect and those before it; None if the model is kept.
    moving : (n,) or None
        Test error of joints in motion, N·m.
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
    fit: Fit | None = None
    moving: Array | None = None

    @classmethod
    def of(
        cls,
        accepted: AcceptedEffect,
        *,
        rms_train: Array | None,
        rms_test: Array | None,
        moving: Array | None,
    ) -> DiagnosisStep:
        """Return the step of an accepted effect.

        Parameters
        ----------
        accepted : AcceptedEffect
        rms_train, rms_test, moving : (n,) or None
            Errors after the step, N·m.
        """
        before, after = accepted.errors[:, accepted.joint]
        return cls(
            label=accepted.candidate.placement.label,
            effect=accepted.candidate.name,
            joints=accepted.candidate.joints,
            parameters=accepted.parameters,
            units=accepted.units,
            rms_train=rms_train,
            rms_test=rms_test,
            evidence=Evidence(
                log10_p=accepted.significance.log10_p,
                rows=accepted.significance.rows,
                effect_size=float(np.sqrt(max(before**2 - after**2, 0.0))),
                held_out_before=float(before),
                held_out_after=float(after),
                confirmed=accepted.confirmed,
            ),
            indistinguishable=accepted.rivals,
            fit=accepted.fit,
            moving=moving,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the step for JSON, joints from 1."""
        return {
            "effect": self.effect,
            "joints": [j + 1 for j in self.joints],
            "label": self.label,
            "parameters": self.parameters,
            "units": self.units,
            "rms_train": _numbers(self.rms_train),
            "rms_test": _numbers(self.rms_test),
            "rms_test_moving": _numbers(self.moving),
            "evidence": self.evidence.to_dict(),
            "indistinguishable": [
                {"effect": c.name, "joints": [j + 1 for j in c.joints], "kind": kind}
                for c, kind in self.indistinguishable
            ],
        }


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Result of :func:`lieid_casadi.diagnose`.

    Attributes
    ----------
    mode : str
        ``missing``: effects that the model lacks; ``changed``: changes since a fit.
    verdict : str
        ``sufficient``, ``effect_found`` or ``unexplained``.
    joint_names : tuple of str
    noise_floor : (n,)
        Error that a model without any missing effect would have, N·m; see
        `lieid_casadi.comparison.noise_floor`. Of the test if there is one.
    noise_source : str
        How the noise floor was estimated, a key of `lieid_casadi.comparison.noise_floor.SOURCES`.
    baseline_effects : tuple of str
        Of the first model.
    baseline_train, baseline_test : (n,) or None
        Error of the first model, N·m.
    steps : tuple of DiagnosisStep
        In the order added.
    unexplained : tuple of Unexplained
    rejected : tuple of (str, str)
        Candidates that were selected but not accepted, or removed, and the reason.
    tried : int
        Number of candidates that were screened.
    aliases : Aliases
        Candidates that cannot be identified beside the first model.
    fit : Fit
        The last model's.
    warnings : tuple of LieidWarning
    train, test : tuple of Source
        The recordings.
    baseline_moving : (n,) or None
        Test error of the first model for joints in motion, N·m.
    expected : (n,) or None
        Held-out error of the fit, N·m: what its error is if nothing has changed. None if the
        model is fitted again.
    limits_reached : tuple of str
        Names of the options whose limit ended the search, so that further effects may be missing.
    """

    mode: str
    verdict: str
    joint_names: tuple[str, ...]
    noise_floor: Array
    noise_source: str
    baseline_effects: tuple[str, ...]
    baseline_train: Array | None
    baseline_test: Array | None
    steps: tuple[DiagnosisStep, ...]
    unexplained: tuple[Unexplained, ...]
    rejected: tuple[tuple[str, str], ...]
    tried: int
    aliases: Aliases
    fit: Fit
    warnings: tuple[LieidWarning, ...]
    train: tuple[Source, ...]
    test: tuple[Source, ...]
    baseline_moving: Array | None = None
    expected: Array | None = None
    limits_reached: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return what ``lieid diagnose --json`` writes."""
        return {
            "mode": self.mode,
            "verdict": self.verdict,
            "noise_floor": _numbers(self.noise_floor),
            "noise_source": self.noise_source,
            "expected": _numbers(self.expected),
            "baseline": {
                "effects": list(self.baseline_effects),
                "rms_train": _numbers(self.baseline_train),
                "rms_test": _numbers(self.baseline_test),
            },
            "steps": [step.to_dict() for step in self.steps],
            "unexplained": [u.to_dict() for u in self.unexplained],
            "rejected": [{"effect": label, "reason": reason} for label, reason in self.rejected],
            "tried": self.tried,
            "limits_reached": list(self.limits_reached),
            "absorbed": list(self.aliases.absorbed),
            "weak": [{"effect": label, "remains": part} for label, part in self.aliases.weak],
            "cutoff": self.fit.processing.cutoff,
            "warnings": warning_list(self.warnings),
            "recordings": {
                "train": [{"name": s.name, "sha256": s.sha256} for s in self.train],
                "test": [{"name": s.name, "sha256": s.sha256} for s in self.test],
            },
        }

    @property
    def shown(self) -> tuple[str, list[Array]]:
        """The recordings whose errors are shown, and the errors of all models, N·m.

        The errors (n,) of each model, from the first to the last, are those of the test in
        motion if all joints move, otherwise those of the whole test or of the training.
        """
        moving = [self.baseline_moving, *(step.moving for step in self.steps)]
        available = [values for values in moving if values is not None]
        if len(available) == len(moving) and np.isfinite(available).all():
            return "test, joints in motion", available
        tested = self.baseline_test is not None
        errors = [self.baseline_test if tested else self.baseline_train]
        errors += [step.rms_test if tested else step.rms_train for step in self.steps]
        return "test" if tested else "training", [values for values in errors if values is not None]

    @property
    def sentence(self) -> str:
        """The verdict in full sentences."""
        from lieid_casadi.diagnosis.text_summary import sentence

        return sentence(self)

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the errors of all models from the first to the last; not shown."""
        from lieid_casadi.diagnosis.waterfall_plot import plot_waterfall

        return plot_waterfall(self, ax)

    def plot_unexplained(self, ax: Axes | None = None) -> Figure:
        """Draw the smooth functions of the unexplained residual; not shown."""
        from lieid_casadi.diagnosis.residual.shape_plots import plot_shapes

        return plot_shapes(self.unexplained, ax)

    def _repr_html_(self) -> str:
        from lieid_casadi.diagnosis.text_summary import html

        return html(self)


def _numbers(values: Sequence[float] | Array | None) -> list[float | None] | None:
    if values is None:
        return None
    return [float(value) if np.isfinite(value) else None for value in values]
