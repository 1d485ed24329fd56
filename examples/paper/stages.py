"""Identification in stages: links, friction of single joints, links again (sections 4.1 to 4.3).

The first stage identifies the links with simple friction (Eq. 11) from excitation. The second stage
fits a nonlinear friction model (Eq. 8) to the friction curve of each joint (Eq. 15). Friction runs
are slow, so terms that grow with speed do not extrapolate to the speeds of an excitation: put
together with the links (Eq. 16) they leave large errors. The third stage, which the paper does not
have, therefore identifies the links and these terms again from the excitation, with the dry
friction of the second stage subtracted.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from arm import Array
from numpy.typing import NDArray

from lieid_casadi.compiled import Compiled
from lieid_casadi.effects import Placement
from lieid_casadi.friction_curves import FrictionFit
from lieid_casadi.friction_curves.friction_fit import steady_columns
from lieid_casadi.identification import Fit, identify
from lieid_casadi.identification.prediction import training_rms
from lieid_casadi.model import Model, Parameter
from lieid_casadi.recording import Recording, process

SPEEDS = np.array([0.03, 0.3, 1.0])  # rad/s at which the columns of friction are not all zero
HIGH_SPEEDS = np.array([1e3, 1e4])  # rad/s, far above those at which dry friction changes
GROWTH = 3.0  # ratio of a column at the high speeds above which it grows with speed
REFITS = 2  # of the third stage: load friction changes with the links


def combine_stages(
    first_stage: Fit,
    friction: Mapping[int, FrictionFit],
    excitation: Sequence[Recording],
    *,
    refit: bool = True,
) -> Fit:
    """Combine a first stage and the friction of single joints into one model (Eq. 16).

    ``first_stage``: its friction is kept on joints that ``friction`` does not contain;
    ``friction``: second stage, by joint from 0; ``excitation``: training recordings of the first
    stage; ``refit``: whether links and friction that grows with speed are identified again from the
    excitation (third stage).
    """
    placements = _kept_placements(first_stage, friction)
    for own in friction.values():
        placements += _determined_placements(own)
    stages = [_values_of(first_stage), *map(_values_of_curve, friction.values())]
    model = Model.of_placements(first_stage.model.robot, placements)
    fit = _combined(first_stage, model, stages)
    if refit:
        dry = _dry_friction(friction)
        for _ in range(REFITS):
            refitted = _refitted(fit, dry, excitation)
            fit = _combined(refitted, model, [*stages, _values_of(refitted)])
    segments = process(excitation, fit.processing)
    rms, raw = training_rms(fit.compiled, segments, fit.parameters, fit.shapes)
    return replace(
        fit, rms_train=rms, rms_train_raw=raw, warnings=first_stage.warnings,
        provenance=first_stage.provenance,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _StageValues:
    """Coefficients and shapes of one stage by label, and the covariance (k, k) of ``labels``."""

    values: dict[str, float]
    labels: tuple[str, ...]
    covariance: Array


def _values_of(fit: Fit) -> _StageValues:
    parameters = (*fit.model.columns, *fit.model.shapes)
    values = _by_label(parameters, [*fit.effect_coefficients, *fit.shapes])
    return _StageValues(values, tuple(p.label for p in fit.fitted), fit.covariance)


def _values_of_curve(own: FrictionFit) -> _StageValues:
    determined = Model.of_placements(own.model.robot, _determined_placements(own))
    labels = {p.label for p in (*determined.columns, *determined.shapes)}
    kept = [k for k, p in enumerate(own.parameters) if p.label in labels]
    parameters = [own.parameters[k] for k in kept]
    values = _by_label(parameters, np.concatenate([own.coefficients, own.shapes])[kept])
    return _StageValues(
        values, tuple(p.label for p in parameters), own.covariance[np.ix_(kept, kept)]
    )


def _by_label(parameters: Sequence[Parameter], values: Iterable[float]) -> dict[str, float]:
    return {p.label: float(value) for p, value in zip(parameters, values, strict=True)}


def _combined(links: Fit, model: Model, stages: Sequence[_StageValues]) -> Fit:
    """Return a model with the links of a fit and the effects of the latest stage with each."""
    values: dict[str, float] = {}
    for stage in stages:
        values |= stage.values
    coefficients = [values[c.label] for c in model.columns]
    parameters = np.concatenate([links.link_parameters, coefficients])
    return replace(
        links,
        model=model,
        method="stages",
        values=model.base.combination @ parameters,
        shapes=np.array([values[s.label] for s in model.shapes]),
        covariance=_covariance(model, stages),
        parameters=parameters,
        rms_cv=np.full(model.n, np.nan),
        certificate=None,
    )


def _covariance(model: Model, stages: Sequence[_StageValues]) -> Array:
    """Return the block-diagonal covariance (p + s, p + s), the latest stage for each label."""
    labels = [p.label for p in (*model.base_columns, *model.shapes)]
    covariance = np.zeros((len(labels), len(labels)))
    latest = {label: k for k, stage in enumerate(stages) for label in stage.labels}
    for k, stage in enumerate(stages):
        own = [i for i, x in enumerate(stage.labels) if latest[x] == k and x in labels]
        place = [labels.index(stage.labels[i]) for i in own]
        covariance[np.ix_(place, place)] = stage.covariance[np.ix_(own, own)]
    return covariance


def _kept_placements(first_stage: Fit, friction: Mapping[int, FrictionFit]) -> list[Placement]:
    """Return the effects of the first stage that the second stage does not replace.

    It replaces friction that is odd in velocity, on its own joints.
    """
    odd = {
        joint: _odd_columns(first_stage.compiled, joint, first_stage.shapes) for joint in friction
    }
    return [
        slot.placement
        for slot in first_stage.model.slots
        if slot.placement.joint not in friction or not odd[slot.placement.joint][slot.columns].any()
    ]


def _determined_placements(own: FrictionFit) -> list[Placement]:
    """Return the effects of a second stage that its curve determines: those odd in velocity."""
    odd = _odd_columns(own.compiled, own.curve.joint, own.shapes)
    return [slot.placement for slot in own.model.slots if odd[slot.columns].any()]


def _odd_columns(compiled: Compiled, joint: int, shapes: Array) -> NDArray[np.bool_]:
    """Mark the columns (m,) whose torque on a joint changes sign with its velocity."""
    columns = steady_columns(compiled, joint, SPEEDS, shapes, load=1.0)
    return np.asarray(np.any(columns, axis=0))


def _dry_friction(friction: Mapping[int, FrictionFit]) -> set[str]:
    """Return the labels of second-stage effects that stay bounded at high speed."""
    dry = set()
    for own in friction.values():
        slow, fast = np.abs(
            steady_columns(own.compiled, own.curve.joint, HIGH_SPEEDS, own.shapes, load=1.0)
        )
        for slot in own.model.slots:
            if not np.all(fast[slot.columns] > GROWTH * slow[slot.columns]):
                dry.add(slot.placement.label)
    return dry


def _refitted(fit: Fit, dry: set[str], excitation: Sequence[Recording]) -> Fit:
    """Identify all but the dry friction again, with the torque of the latter subtracted.

    The robust method treats joints that stick at a reversal for an instant as outliers.
    """
    rest = [p for p in fit.model.placements if p.label not in dry]
    held = np.zeros(len(fit.model.columns))
    for slot in fit.model.slots:
        held[slot.columns] = slot.placement.label in dry
    with_dry, without = (
        replace(fit, parameters=np.concatenate([fit.link_parameters, coefficients]))
        for coefficients in (fit.effect_coefficients * held, np.zeros(len(held)))
    )
    remaining = []
    for recording in excitation:
        assert recording.tau is not None  # the first stage was identified from it
        torque = with_dry.predict(recording) - without.predict(recording)
        remaining.append(replace(recording, tau=recording.tau - torque))
    return identify(
        Model.of_placements(fit.model.robot, rest),
        remaining,
        method="robust",
        processing=fit.processing,
    )
