"""Result of a diagnosis: the verdict, the steps, and the unexplained residual."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.diagnosis_step import DiagnosisStep, numbers_or_null
from lieid_casadi.diagnosis.events.event import Event
from lieid_casadi.errors import LieidWarning, warning_list
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.recording_checks import Source

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lieid_casadi.diagnosis.residual.unexplained import Unexplained
    from lieid_casadi.diagnosis.screening.aliases import Aliases
    from lieid_casadi.diagnosis.search.search_results import Difference

Array = NDArray[np.float64]


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
    differing : tuple of Difference
        Effects that explain the residual of one training recording and not of the others.
    seed : int
        Of the bootstrap.
    tried : int
        Number of candidates that were screened.
    aliases : Aliases
        Candidates that cannot be identified in addition to the first model.
    fit : Fit
        The last model's.
    warnings : tuple of LieidWarning
    train, test : tuple of Source
        The recordings.
    baseline_moving : (n,) or None
        Test error of the first model for joints in motion, N·m.
    baseline_cv : (n,) or None
        Error of the first model on held-out blocks of the training recordings, joints in motion,
        N·m. None if the model is kept.
    expected : (n,) or None
        Held-out error of the fit, N·m: what its error is if nothing has changed. None if the
        model is fitted again.
    limits_reached : tuple of str
        Names of the options whose limit ended the search, so that further effects may be missing.
    events : tuple of Event
        Stretches that were left out: contact and faults; joints that do not move enough.
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
    baseline_cv: Array | None = None
    expected: Array | None = None
    limits_reached: tuple[str, ...] = ()
    differing: tuple[Difference, ...] = ()
    seed: int = 0
    events: tuple[Event, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return what ``lieid diagnose --json`` writes."""
        return {
            "mode": self.mode,
            "verdict": self.verdict,
            "noise_floor": numbers_or_null(self.noise_floor),
            "noise_source": self.noise_source,
            "expected": numbers_or_null(self.expected),
            "baseline": {
                "effects": list(self.baseline_effects),
                "rms_train": numbers_or_null(self.baseline_train),
                "rms_test": numbers_or_null(self.baseline_test),
                "rms_test_moving": numbers_or_null(self.baseline_moving),
                "rms_cv": numbers_or_null(self.baseline_cv),
            },
            "steps": [
                step.to_dict() | {"group": group}
                for step, group in zip(self.steps, self.groups, strict=True)
            ],
            "unexplained": [u.to_dict() for u in self.unexplained],
            "rejected": [{"effect": label, "reason": reason} for label, reason in self.rejected],
            "differs_between_recordings": [d.to_dict() for d in self.differing],
            "seed": self.seed,
            "tried": self.tried,
            "limits_reached": list(self.limits_reached),
            "events": [event.to_dict() for event in self.events],
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
        motion if all joints move, otherwise those of the whole test. Without a test, they are
        those of held-out training data in motion.
        """
        test = "test" if self.mode == "missing" else "new recordings"
        last = [together[-1] for together in self.additions]
        moving = [self.baseline_moving, *(step.moving for step in last)]
        available = [values for values in moving if values is not None]
        if len(available) == len(moving) and np.isfinite(available).all():
            return f"{test}, joints in motion", available
        if self.baseline_test is not None:
            errors = [self.baseline_test, *(step.rms_test for step in last)]
            return test, [values for values in errors if values is not None]
        errors = [self.baseline_cv, *(step.rms_cv for step in last)]
        held_out = "held-out training data, joints in motion"
        return held_out, [values for values in errors if values is not None]

    @property
    def reference(self) -> tuple[str, Array]:
        """Name and values (n,), N·m, of what the errors of a complete model are."""
        if self.expected is None:
            return "noise floor", self.noise_floor
        return "expected", self.expected

    @property
    def additions(self) -> tuple[tuple[DiagnosisStep, ...], ...]:
        """The steps, those together whose effects were added to the model at once.

        All changes are: their sizes are those beside each other.
        """
        together: dict[int, list[DiagnosisStep]] = {}
        for step in self.steps:
            together.setdefault(id(step.fit), []).append(step)
        return tuple(map(tuple, together.values()))

    @property
    def model_names(self) -> tuple[str, ...]:
        """The effects of the first model, and what each further model of `shown` adds."""
        first = " + ".join(self.baseline_effects) or "rigid"
        return (first, *(_added(steps) for steps in self.additions))

    @property
    def groups(self) -> tuple[int, ...]:
        """Group of each step, from 1: steps with the same effect on single joints share one."""
        names = [step.effect if len(step.joints) == 1 else step.label for step in self.steps]
        order = list(dict.fromkeys(names))
        return tuple(order.index(name) + 1 for name in names)

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


def _added(steps: Sequence[DiagnosisStep]) -> str:
    """Return the effects of steps in the notation of ``--effects``: ``+ stribeck:4+5``."""
    joints: dict[str, list[str]] = {}
    for step in sorted(steps, key=lambda step: step.joints):
        name, _, where = step.label.partition(":")
        joints.setdefault(name, []).append(where)
    return " ".join(f"+ {name}:{'+'.join(at)}".removesuffix(":") for name, at in joints.items())
