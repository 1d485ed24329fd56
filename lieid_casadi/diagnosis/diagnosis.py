"""Result of a diagnosis: the verdict, the steps, and what stays unexplained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.residual.unexplained import Unexplained
from lieid_casadi.diagnosis.screening.aliases import Aliases
from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.errors import LieidWarning, warning_list
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.provenance import Source

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
MOST_RIVALS = 3


@dataclass(frozen=True)
class Evidence:
    """How sure a step is.

    Attributes
    ----------
    log10_p : float
        log₁₀ of the family-wise p-value, over everything that was tried.
    rows : int
        Effective sample size: whitened rows of all joints.
    effect_size : float
        RMS of what the effect adds on its joint along the training recordings, N·m.
    held_out_before, held_out_after : float
        Blocked cross-validation error of the joint where it falls most, N·m.
    confirmed : bool or None
        Whether the test's error fell; None without a test.
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
class Step:
    """One effect that was found, in the order added.

    Attributes
    ----------
    label : str
        As on the command line, ``load_friction:2``.
    effect : str
    joints : tuple of int
        From 0; target and source for couplings.
    parameters : dict
        Name → value of the last fit.
    rms_train, rms_test : (n,)
        After this step, N·m; ``rms_test`` is None without a test.
    indistinguishable : tuple of (Candidate, kind)
    fit : Fit or None
        With this effect and those before it.
    moving : (n,) or None
        ``rms_test`` of joints in motion alone: rest says nothing of a model.
    """

    label: str
    effect: str
    joints: tuple[int, ...]
    parameters: dict[str, float]
    rms_train: Array | None
    rms_test: Array | None
    evidence: Evidence
    indistinguishable: tuple[tuple[Candidate, str], ...]
    fit: Fit | None = None
    moving: Array | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the step for JSON, joints from 1."""
        return {
            "effect": self.effect,
            "joints": [j + 1 for j in self.joints],
            "label": self.label,
            "parameters": self.parameters,
            "rms_train": _numbers(self.rms_train),
            "rms_test": _numbers(self.rms_test),
            "rms_test_moving": _numbers(self.moving),
            "evidence": self.evidence.to_dict(),
            "indistinguishable": [
                {"effect": c.name, "joints": [j + 1 for j in c.joints], "kind": kind}
                for c, kind in self.indistinguishable[:MOST_RIVALS]
            ],
        }


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Result of :func:`lieid_casadi.diagnose`.

    Attributes
    ----------
    mode : str
        ``missing``: which effects the model lacks; ``changed``: what is no longer as it was.
    verdict : str
        ``sufficient``, ``effect_found`` or ``unexplained``.
    noise_floor : (n,)
        Error that a perfect model would have, N·m.
    baseline_effects : tuple of str
    baseline_train, baseline_test : (n,) or None
        Error of the first model, N·m.
    baseline_moving : (n,) or None
        Of joints in motion alone, on the test.
    steps : tuple of Step
    unexplained : tuple of Unexplained
    rejected : tuple of (str, str)
        Candidates that looked best and were turned down, and why.
    tried : int
        How many candidates were screened.
    aliases : Aliases
        Which of them the first model absorbs.
    fit : Fit
        The last model's.
    warnings : tuple of LieidWarning
    train, test : tuple of Source
    """

    mode: str
    verdict: str
    joint_names: tuple[str, ...]
    noise_floor: Array
    noise_source: str
    baseline_effects: tuple[str, ...]
    baseline_train: Array | None
    baseline_test: Array | None
    steps: tuple[Step, ...]
    unexplained: tuple[Unexplained, ...]
    rejected: tuple[tuple[str, str], ...]
    tried: int
    aliases: Aliases
    fit: Fit
    warnings: tuple[LieidWarning, ...]
    train: tuple[Source, ...]
    test: tuple[Source, ...]
    baseline_moving: Array | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return what ``lieid diagnose --json`` writes."""
        return {
            "mode": self.mode,
            "verdict": self.verdict,
            "noise_floor": _numbers(self.noise_floor),
            "noise_source": self.noise_source,
            "baseline": {
                "effects": list(self.baseline_effects),
                "rms_train": _numbers(self.baseline_train),
                "rms_test": _numbers(self.baseline_test),
            },
            "steps": [step.to_dict() for step in self.steps],
            "unexplained": [u.to_dict() for u in self.unexplained],
            "rejected": [{"effect": label, "reason": reason} for label, reason in self.rejected],
            "tried": self.tried,
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
        """Where errors are told, and those (n,) of all models from the first to the last, N·m.

        On the test they are those of joints in motion, where all joints move.
        """
        moving = [self.baseline_moving, *(step.moving for step in self.steps)]
        known = [values for values in moving if values is not None]
        if len(known) == len(moving) and np.isfinite(known).all():
            return "test, joints in motion", known
        tested = self.baseline_test is not None
        errors = [self.baseline_test if tested else self.baseline_train]
        errors += [step.rms_test if tested else step.rms_train for step in self.steps]
        return "test" if tested else "training", [values for values in errors if values is not None]

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        from lieid_casadi.diagnosis.text_summary import sentence

        return sentence(self)

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the fall of the error from the first model to the last; not shown."""
        from lieid_casadi.diagnosis.waterfall_plot import plot_waterfall

        return plot_waterfall(self, ax)

    def plot_unexplained(self, ax: Axes | None = None) -> Figure:
        """Draw the smooth functions that explain what stays: curves and maps; not shown."""
        from lieid_casadi.diagnosis.residual.shape_plots import plot_shapes

        return plot_shapes(self.unexplained, ax)

    def _repr_html_(self) -> str:
        from lieid_casadi.diagnosis.text_summary import html

        return html(self)


def _numbers(values: Sequence[float] | Array | None) -> list[float | None] | None:
    if values is None:
        return None
    return [float(value) if np.isfinite(value) else None for value in values]
