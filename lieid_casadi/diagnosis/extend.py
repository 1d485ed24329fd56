"""``extend``: add named effects to a fit, refit, and compare before and after."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.comparison import compare
from lieid_casadi.diagnosis.candidates import Candidate, unresolved_shape
from lieid_casadi.diagnosis.steps import fitted_values
from lieid_casadi.effects import Placement, parse_effects
from lieid_casadi.errors import BoundWarning, EffectError, LieidWarning
from lieid_casadi.identification import Fit, identify
from lieid_casadi.identification.identify import Method
from lieid_casadi.json_numbers import numbers_or_none
from lieid_casadi.messages import in_unit
from lieid_casadi.model import Model
from lieid_casadi.plot_style import Axes, Figure
from lieid_casadi.recording import Recording, process
from lieid_casadi.recording.recording import listed

SIGNIFICANT = 2.0  # standard deviations


@dataclass(frozen=True, eq=False)
class Extension:
    """Result of :func:`extend`.

    Attributes
    ----------
    added : tuple of str
        Labels of the added effects.
    before, after : Fit
        Both on the same training recordings.
    rms_train, rms_test : (2, n)
        Before and after, N·m; ``rms_test`` None without a test.
    rms_test_moving, rms_test_at_rest : (2, n) or None
        The same of joints in motion, and at rest; NaN where a joint never moves, or never rests.
    """

    added: tuple[str, ...]
    before: Fit
    after: Fit
    rms_train: Array
    rms_test: Array | None = None
    rms_test_moving: Array | None = None
    rms_test_at_rest: Array | None = None

    @property
    def held_out(self) -> Array:
        """Error in motion before and after (2, n), N·m: of the test, or cross-validated."""
        if self.rms_test_moving is not None:
            return self.rms_test_moving
        return np.array([self.before.rms_cv, self.after.rms_cv])

    @property
    def parameters(self) -> list[dict[str, Any]]:
        """The rows of the parameter table that belong to the added effects."""
        old = {(row["name"], row["joint"]) for row in self.before.parameter_table()}
        table = self.after.parameter_table()
        return [row for row in table if (row["name"], row["joint"]) not in old]

    def to_dict(self) -> dict[str, Any]:
        """Return what ``lieid extend --json`` writes."""
        errors = {
            name: getattr(self, name) for name in ("rms_train", "rms_test", "rms_test_moving")
        }
        before, after = (
            {"effects": fit.model.effects}
            | {name: None if x is None else numbers_or_none(x[k]) for name, x in errors.items()}
            for k, fit in enumerate((self.before, self.after))
        )
        return {
            "added": list(self.added),
            "before": before,
            "after": after,
            "fall": numbers_or_none(1.0 - self.held_out[1] / self.held_out[0]),
            "parameters": self.parameters,
            "fit": self.after.to_dict(),
        }

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the errors of both models per joint; not shown."""
        from lieid_casadi.comparison.plots import draw_errors

        recordings = "held-out training data" if self.rms_test_moving is None else "test"
        names = ["before", f"+ {', '.join(self.added)}"]
        return draw_errors(list(self.held_out), names, None, f"{recordings}, joints in motion", ax)


def extend(
    fit: Fit,
    effects: str,
    train: Recording | Sequence[Recording],
    test: Recording | Sequence[Recording] | None = None,
    *,
    progress: Callable[[str, float], None] | None = None,
) -> Extension:
    """Add effects to a fit's model, refit both on ``train`` and compare them on ``test``.

    Parameters
    ----------
    fit : Fit
        Its model, method and filter options are used.
    effects : str
        ``stribeck:4,load_friction:2+3``; joints from 1.
    train : Recording or sequence of Recording
    test : Recording or sequence of Recording, optional
    progress : callable, optional
        Called with the name of a stage and the fraction done, 0 to 1.

    Raises
    ------
    EffectError
        No effect or an unknown one, one that the model has already, or a joint that does not move.
    """
    model = fit.model
    wanted = parse_effects(effects, model.n)
    if not wanted:
        raise EffectError("no effects to add; expected some such as stribeck:4")
    have = {placement.label for placement in model.placements}
    present = [p.label for p in wanted if p.label in have]
    if present:
        raise EffectError(
            f"the model has {', '.join(present)} already; expected effects that it lacks"
        )
    _check_motion(wanted, train)
    larger = Model.of_placements(model.robot, (*model.placements, *wanted), library=model.library)
    report = progress or (lambda stage, fraction: None)
    report("before", 0.0)
    method = cast(Method, fit.method)  # `identify` refuses those of other functions
    before = identify(model, train, method=method, processing=fit.processing)
    report("after", 0.3)
    after = identify(larger, train, method=method, processing=fit.processing)
    doubts = [*_doubtful(after, wanted), *_unresolved(after, wanted, train)]
    after = replace(after, warnings=(*after.warnings, *doubts))
    names, errors = ("rms", "rms_moving", "rms_at_rest"), list[Array]()
    if test is not None:
        report("test", 0.8)
        tested = [compare(fit, test) for fit in (before, after)]
        errors = [np.array([getattr(c, name) for c in tested]) for name in names]
    report("done", 1.0)
    added = tuple(placement.label for placement in wanted)
    return Extension(added, before, after, np.array([before.rms_train, after.rms_train]), *errors)


def _doubtful(fit: Fit, added: Sequence[Placement]) -> list[LieidWarning]:
    """Return warnings about coefficients of added effects: negative friction, not significant."""
    alone = Model.of_placements(fit.model.robot, added)
    known = [c for p in alone.placements for c in p.effect.coefficients]
    coefficients = {p.label: c for p, c in zip(alone.columns, known, strict=True)}
    found: list[LieidWarning] = []
    for parameter, value, std in zip(fit.model.base_columns, fit.values, fit.std, strict=False):
        coefficient = coefficients.get(parameter.label)
        if coefficient is None:
            continue
        if abs(value) < SIGNIFICANT * std:
            why = "not significantly different from zero: the effect is probably not present"
        elif coefficient.opposes_motion and value < 0.0:
            why = (
                f"negative, but {coefficient.meaning} is expected to be positive: the effect is "
                "probably not present, or another one is missing; lieid diagnose searches for it"
            )
        else:
            continue
        size = f"{parameter.label} = {in_unit(f'{value:.3g} ± {std:.2g}', parameter.unit)}"
        found.append(BoundWarning(f"{size} is {why}"))
    return found


def _unresolved(
    fit: Fit, added: Sequence[Placement], train: Recording | Sequence[Recording]
) -> list[LieidWarning]:
    """Return a warning of each added effect with a shape parameter that the motion cannot show."""
    segments, reasons = process(listed(train), fit.processing), dict[str, str | None]()
    for placement in added:
        values, shapes, _ = fitted_values(fit, placement)
        candidate = Candidate(placement, shapes[None])
        reasons[placement.label] = unresolved_shape(candidate, shapes, values, segments)
    text = "the effect is probably not present on this joint"
    return [BoundWarning(f"{label}: {why}: {text}") for label, why in reasons.items() if why]


def _check_motion(wanted: Sequence[Placement], train: Recording | Sequence[Recording]) -> None:
    recordings = listed(train)
    for placement in wanted:
        for joint in (placement.joint, placement.source):
            if joint is None or joint >= recordings[0].n:
                continue
            if all(np.ptp(r.q[:, joint]) < 1e-6 for r in recordings):
                raise EffectError(
                    f"{placement.label}: joint {joint + 1} does not move in the training "
                    "recordings, so that the effect cannot be identified; use other recordings"
                )
