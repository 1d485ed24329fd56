"""Result of a diagnosis, and its tables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.comparison.comparison import fall_sentence, percent
from lieid_casadi.comparison.noise_floor import SOURCES
from lieid_casadi.comparison.plots import draw_errors
from lieid_casadi.diagnosis.findings import (
    MOST_RIVALS,
    difference_sentence,
    finding,
    findings,
    join_words,
    unexplained_sentence,
)
from lieid_casadi.diagnosis.step import (
    LEAST_STRETCHES,
    Difference,
    MotionGain,
    Step,
    Unexplained,
    or_null,
)
from lieid_casadi.diagnosis.transients import Event
from lieid_casadi.errors import LieidWarning, warning_list
from lieid_casadi.identification import Fit
from lieid_casadi.identification.recording_checks import Source
from lieid_casadi.json_numbers import numbers_or_none
from lieid_casadi.plot_style import Axes, Figure
from lieid_casadi.tables import Table, figures, html, make_table

SAME = 0.995  # of an error: a noise floor from there on is the same number


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Result of :func:`lieid_casadi.diagnose`.

    Attributes
    ----------
    mode : str
        ``missing`` or ``changed``.
    fit : Fit
        The final fit, with all steps; the given one if the model is kept.
    steps : tuple of Step
        In the order in which the path added them.
    unexplained : tuple of Unexplained
    differing : tuple of Difference
    rejected : tuple of (str, str)
        Candidates that were selected and not added, and why.
    undecided : tuple of (str, float)
        Of these, candidates that would lower the held-out error by enough, and what they have of
        the standard errors that would suffice (`name_deviations`): more data would decide.
    noise_floor : (n,)
        N·m, of the test, or of the training recordings without one.
    noise_source : str
    baseline_effects : tuple of str
    baseline : dict
        As ``errors`` of a step, of the first model.
    expected : (n,) or None
        Error in motion that a kept model expects of noise, of dry friction at reversals and of its
        uncertain parameters, N·m.
    tried : int
        Number of candidates.
    absorbed : tuple of str
        Candidates that parameters of the model imitate exactly.
    weak : tuple of (str, float)
        Candidates, and the part of their torque that differs from the model's.
    warnings : tuple of LieidWarning
    train, test : tuple of Source
    limits_reached : tuple of str
        Options whose limit ended the search.
    events : tuple of Event
        Stretches that were left out.
    uncertain : tuple of Unexplained
        Large errors of a kept model that the uncertainty of its parameters explains.
    motion : MotionGain or None
        Of arms under commands: errors of the first and the final fit's motion on held-out data.
    """

    mode: str
    fit: Fit
    steps: tuple[Step, ...]
    unexplained: tuple[Unexplained, ...]
    differing: tuple[Difference, ...]
    rejected: tuple[tuple[str, str], ...]
    noise_floor: Array
    noise_source: str
    baseline_effects: tuple[str, ...]
    baseline: dict[str, Array | None]
    expected: Array | None
    tried: int
    absorbed: tuple[str, ...]
    weak: tuple[tuple[str, float], ...]
    warnings: tuple[LieidWarning, ...]
    train: tuple[Source, ...]
    test: tuple[Source, ...]
    limits_reached: tuple[str, ...] = ()
    events: tuple[Event, ...] = ()
    seed: int = 0
    motion: MotionGain | None = None
    undecided: tuple[tuple[str, float], ...] = ()
    uncertain: tuple[Unexplained, ...] = ()

    @property
    def verdict(self) -> str:
        """``sufficient``, ``effect_found`` or ``unexplained``, as an arm at rest is."""
        n = self.fit.model.n
        resting = any(len(e.joints) == n for e in self.events if e.kind == "standstill")
        if resting or self.unexplained or self.differing:
            return "unexplained"
        return "effect_found" if self.steps else "sufficient"

    @property
    def shown(self) -> tuple[str, list[Array]]:
        """Recordings whose errors are shown, and the errors (n,) of all models, N·m."""
        if self.mode == "changed":
            name, key = "new recordings, joints in motion", "rms_test_moving"
        elif self.baseline["rms_test_moving"] is not None:
            name, key = "test, joints in motion", "rms_test_moving"
        else:
            name, key = "held-out training data, joints in motion", "rms_cv"
        errors = [self.baseline[key], *(step.errors[key] for step in self.steps)]
        return name, [values for values in errors if values is not None]

    @property
    def reference(self) -> tuple[str, Array]:
        """Name and values (n,), N·m, of what the errors of a complete model are."""
        if self.expected is None:
            return "noise floor", self.noise_floor
        return "expected", self.expected

    @property
    def sentences(self) -> list[str]:
        """The verdict, one sentence for each finding and each unexplained part."""
        parts = [event.sentence for event in self.events]
        parts += [finding(group, self.mode) for group in findings(self.steps, self.mode)]
        every = self.fit.model.placements
        own: set[object] = {p.label for p in every}
        own |= {(p.effect.name, p.joint) for p in every if p.effect.per_recording}
        new = [s.label for s in self.steps if s.joints and not own & {s.label, (s.effect, s.joint)}]
        if new and self.mode == "changed":
            lacked = f"The fit does not model {join_words(new)}"
            parts.append(f"{lacked}; what its recordings hardly show may have acted before.")
        if self.verdict == "sufficient" and self.mode == "missing":
            parts.append("No effect lowers the error of data that its choice did not see.")
        elif self.verdict == "sufficient":
            unchanged = "Nothing has changed since the fit."
            parts.append("No change since the fit is certain." if self.uncertain else unchanged)
        if self.limits_reached:
            parts.append(
                f"The search ended at its limit ({join_words(self.limits_reached)}); "
                "further effects may be missing."
            )
        found = [step.evidence for step in self.steps]
        stretches = min((e.independent for e in found), default=0)
        if any(e.independent < LEAST_STRETCHES * len(e.gains) for e in found):
            parts.append(
                f"The recordings have only {stretches} stretch{'es' * (stretches != 1)} with "
                "independent errors, fewer than two in each held-out part, so that the evidence is "
                "uncertain; record longer."
            )
        parts += [difference_sentence(each) for each in self.differing]
        return parts + [unexplained_sentence(e) for e in (*self.uncertain, *self.unexplained)]

    @property
    def sentence(self) -> str:
        """The verdict as a paragraph."""
        return " ".join(self.sentences)

    @property
    def summary(self) -> str:
        """By how much the error falls with all effects; empty if none was found."""
        _, errors = self.shown
        if not self.steps or len(errors) < 2:
            return ""
        name, floor = self.reference
        where = "the new recordings" if self.mode == "changed" else "unseen motion"
        if self.mode == "missing" and any(map(self.fit.provenance.contains, self.test)):
            where = "the motion of the training"
        reference = "the expected error" if name == "expected" else "its noise floor"
        return fall_sentence(errors[0], errors[-1], floor, where=where, reference=reference)

    def to_dict(self) -> dict[str, Any]:
        """Return what ``lieid diagnose --json`` writes."""
        baseline = {name: or_null(values) for name, values in self.baseline.items()}
        return {
            "mode": self.mode,
            "verdict": self.verdict,
            "sentences": self.sentences,
            "noise_floor": numbers_or_none(self.noise_floor),
            "noise_source": self.noise_source,
            "expected": or_null(self.expected),
            "baseline": {"effects": list(self.baseline_effects), **baseline},
            "steps": [step.to_dict() for step in self.steps],
            "unexplained": [part.to_dict() for part in self.unexplained],
            "rejected": [{"effect": label, "reason": why} for label, why in self.rejected],
            "motion": None if self.motion is None else self.motion.to_dict(),
            "differs_between_recordings": [d.to_dict() for d in self.differing],
            "seed": self.seed,
            "tried": self.tried,
            "limits_reached": list(self.limits_reached),
            "events": [event.to_dict() for event in self.events],
            "absorbed": list(self.absorbed),
            "weak": [{"effect": label, "remains": part} for label, part in self.weak],
            "cutoff": self.fit.processing.cutoff,
            "warnings": warning_list(self.warnings),
            "recordings": {
                name: [{"name": s.name, "sha256": s.sha256} for s in sources]
                for name, sources in (("train", self.train), ("test", self.test))
            },
        }

    def error_table(self) -> Table:
        """Return the error of each joint, N·m, one row per model."""
        measured, errors = self.shown
        names = [
            " + ".join(self.baseline_effects) or "rigid",
            *(f"+ {step.label}" for step in self.steps),
        ]
        rows: list[list[object]] = [
            [name, *map(figures, values)] for name, values in zip(names, errors, strict=True)
        ]
        reference, values = self.reference
        source = SOURCES[self.noise_source]
        note = (
            "Each row adds an effect to the row above and fits the linear parameters again; "
            "the last one is the final fit."
        )
        if self.expected is not None:
            source, note = "noise, reversals, uncertain parameters", "The model is kept."
        if self.expected is not None or np.any(values < SAME * errors[-1]):
            rows.append([reference, *map(figures, values)])
        else:
            reference += ", as the last row"  # which it would repeat
        about = f"; {reference}: {source}" if np.isfinite(values).any() else ""
        return make_table(
            f"RMS error on the {measured}, N·m (low-pass {self.fit.processing.cutoff:.3g} Hz"
            f"{about})",
            ["model", *(f"joint {j + 1}" for j in range(self.fit.model.n))],
            rows,
            note=note,
        )

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the errors of all models from the first to the last; not shown."""
        recordings, errors = self.shown
        labels = ["first model", *(f"+ {step.label}" for step in self.steps)]
        return draw_errors(errors, labels, self.reference, recordings, ax)

    def _repr_html_(self) -> str:
        return html(self.sentence, self.error_table())


def evidence_table(d: Diagnosis) -> Table:
    """Return errors without and with each step, status, rivals and evidence."""
    steps = [step for group in findings(d.steps, d.mode) for step in group]
    error = "held-out error" if d.mode == "missing" else "error"
    columns: dict[str, list[object]] = {
        "effect": [step.label for step in steps],
        "status": [step.status.replace("_", " ") for step in steps],
        f"{error}, N·m": [_errors(step) for step in steps],
        "falls by": [percent(step.part) for step in steps],
        "on the test by, N·m": [figures(step.fall.test) for step in steps],
        "motion, deg": [_degrees(step) for step in steps],
        "of torque": [percent(step.share) for step in steps],
        "gain / its error": [figures(step.evidence.gain_certainty, digits=2) for step in steps],
        "selected": [percent(step.evidence.selected) for step in steps],
        "rivals": [
            ", ".join(f"{r.label} ({r.kind})" for r in step.rivals[:MOST_RIVALS]) or None
            for step in steps
        ],
    }
    if d.mode == "changed" or not any(step.fall.test is not None for step in steps):
        del columns["on the test by, N·m"]
    if d.motion is None:
        del columns["motion, deg"]
    note = (
        "Errors are those of the final model without the effect and with it. Gain: mean fall of "
        "the error of stretches of time that the choice did not see. Selected: in paths without "
        "one of these stretches. exact: no data can separate the two; data: these data cannot."
    )
    rows = list(zip(*columns.values(), strict=True))
    return make_table("Found" if rows else "Nothing found", list(columns), rows, note=note)


def _errors(step: Step) -> str:
    where = "" if step.joint in step.joints[:1] else f" (joint {step.joint + 1})"
    return f"{figures(step.before)} → {figures(step.after)}{where}"


def _degrees(step: Step) -> str | None:
    """Return the error of the simulated motion of the step's joint without and with it."""
    if step.motion is None:
        return None
    before, after = (np.degrees(x[step.joint]) for x in (step.motion.before, step.motion.after))
    return f"{before:.3g} → {after:.3g}"


def motion_table(d: Diagnosis) -> Table:
    """Return the error of the simulated motion of each joint, deg; empty if there is none."""
    models = [] if d.motion is None else [("first model", d.motion.before)]
    if d.motion is not None and d.steps:
        models.append(("final model", d.motion.after))
    window = 1.0 if d.motion is None else d.motion.window
    return make_table(
        f"RMS error of the simulated motion after {window:.3g} s, deg",
        ["model", *(f"joint {j + 1}" for j in range(d.fit.model.n)), "all"],
        [
            [name, *map(float, np.degrees(x)), float(np.degrees(np.sqrt(np.mean(x**2))))]
            for name, x in models
        ],
        note="Under the recorded commands, from measured states, on windows of held-out data.",
    )


def unexplained_table(d: Diagnosis) -> Table:
    """Return the joints whose error neither effects nor smooth functions lower."""
    return make_table(
        "Unexplained",
        ("joint", "error over noise", "part of the residual's variance", "not added"),
        [
            (
                f"{u.joint + 1}",
                u.ratio,
                f"{100 * u.fraction:.0f} %",
                "; ".join(f"{label}: {why}" for label, why in u.candidates) or None,
            )
            for u in d.unexplained
        ],
    )


def rejected_table(d: Diagnosis) -> Table:
    """Return the candidates that were selected and not added, and why."""
    return make_table(
        f"Not added ({d.tried} candidates were tried)",
        ("candidate", "reason"),
        list(d.rejected),
        note=alias_sentence(d),
    )


def alias_sentence(d: Diagnosis) -> str:
    """Return which effects this diagnosis cannot name."""
    parts = []
    if d.absorbed:
        parts.append(
            "Not identifiable from any recording, because parameters of the model have the same "
            f"effect: {', '.join(d.absorbed)}."
        )
    if d.weak:
        named = ", ".join(f"{label} ({100 * part:.1f} %)" for label, part in d.weak)
        parts.append(
            "Hardly identifiable from these recordings (part of the effect that differs from the "
            f"model): {named}."
        )
    return " ".join(parts)
