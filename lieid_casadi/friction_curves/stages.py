"""Identification in stages: links, friction of single joints, links again (sections 4.1 to 4.3).

The first stage identifies the links with simple friction (Eq. 11) from excitation. The second stage
fits a nonlinear friction model (Eq. 8) to the friction curve of each joint (Eq. 15). Friction runs
are slow, so terms that grow with speed do not extrapolate to the speeds of an excitation: put
together with the links (Eq. 16) they leave large errors. The third stage, which the paper does not
have, therefore identifies the links and these terms again from the excitation, with the dry
friction of the second stage subtracted.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import Compiled
from lieid_casadi.effects import Effect, Placement
from lieid_casadi.errors import LieidWarning, ModelError, unique_warnings
from lieid_casadi.friction_curves.curve import LoadSource, friction_curve
from lieid_casadi.friction_curves.friction_fit import FrictionFit, fit_friction, steady_columns
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.identify import Method, identify
from lieid_casadi.identification.prediction import center_temperature, training_rms
from lieid_casadi.identification.recording_checks import Source
from lieid_casadi.model import Model, Parameter
from lieid_casadi.recording import Processing, Recording, process
from lieid_casadi.recording.recording import listed

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

    This is the last step of `identify_in_stages`, for friction curves that were measured in
    another way, for example with a known payload.

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
    mean = _temperature_mean(first_stage, friction)
    fit = _combined(replace(first_stage, temperature_mean=mean), model, stages)
    if refit:
        dry = _dry_friction(friction)
        for _ in range(REFITS):
            refitted = _refitted(fit, dry, excitation, first_stage.method)
            refitted = replace(refitted, temperature_mean=mean)
            fit = _combined(refitted, model, [*stages, _values_of(refitted)])
    recordings = _sources(first_stage, friction)
    fit = replace(
        fit,
        warnings=_warnings(first_stage, friction),
        provenance=replace(first_stage.provenance, recordings=recordings),
    )
    return _with_training_errors(fit, excitation)


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
    columns = steady_columns(compiled, joint, SPEEDS, shapes, load=1.0, temperature=1.0)
    return np.asarray(np.any(columns, axis=0))


def _dry_friction(friction: Mapping[int, FrictionFit]) -> set[str]:
    """Return the labels of second-stage effects that stay bounded at high speed."""
    dry = set()
    for own in friction.values():
        slow, fast = np.abs(
            steady_columns(
                own.compiled, own.curve.joint, HIGH_SPEEDS, own.shapes, load=1.0, temperature=1.0
            )
        )
        for slot in own.model.slots:
            if not np.all(fast[slot.columns] > GROWTH * slow[slot.columns]):
                dry.add(slot.placement.label)
    return dry


def _refitted(fit: Fit, dry: set[str], excitation: Sequence[Recording], method: str) -> Fit:
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
        method="feasible" if method == "feasible" else "robust",
        processing=fit.processing,
    )


def _with_training_errors(fit: Fit, excitation: Sequence[Recording]) -> Fit:
    segments, _ = center_temperature(process(excitation, fit.processing), fit.temperature_mean)
    rms, raw = training_rms(fit.compiled, segments, fit.parameters, fit.shapes)
    return replace(fit, rms_train=rms, rms_train_raw=raw)


def _temperature_mean(first_stage: Fit, friction: Mapping[int, FrictionFit]) -> Array | None:
    """Return the temperatures that effects refer to: the first stage's mean, if it has one."""
    means = [own.curve.data.temperature_mean for own in friction.values()]
    return next((m for m in (first_stage.temperature_mean, *means) if m is not None), None)


def _sources(first_stage: Fit, friction: Mapping[int, FrictionFit]) -> tuple[Source, ...]:
    """Return the recordings of all stages."""
    found = [*first_stage.provenance.recordings]
    found += [source for own in friction.values() for source in own.curve.recordings]
    return tuple(dict.fromkeys(found))


def _warnings(first_stage: Fit, friction: Mapping[int, FrictionFit]) -> tuple[LieidWarning, ...]:
    found = [*first_stage.warnings]
    for own in friction.values():
        found += [*own.curve.warnings, *own.warnings]
    return unique_warnings(found)


@dataclass(frozen=True, eq=False)
class StagedFit:
    """Result of `identify_in_stages`.

    Attributes
    ----------
    first_stage : Fit
        Links with simple friction, from the excitation.
    friction : dict of int to FrictionFit
        Second stage: the friction model of each joint (from 0) that has friction runs.
    fit : Fit
        The combined model, see `combine_stages`.
    """

    first_stage: Fit
    friction: dict[int, FrictionFit]
    fit: Fit

    def to_dict(self) -> dict[str, Any]:
        """Return the first stage and the friction of each joint for JSON."""
        return {
            "first_stage": self.first_stage.to_dict(),
            "friction": [own.to_dict() for own in self.friction.values()],
        }

    def __repr__(self) -> str:
        joints = ", ".join(str(joint + 1) for joint in self.friction)
        return f"<StagedFit: {self.fit!r}, friction runs of joints {joints or 'none'}>"


def identify_in_stages(
    model: Model,
    excitation: Recording | Sequence[Recording],
    friction_runs: Mapping[int, Recording | Sequence[Recording]],
    friction_effects: str | Iterable[str | Effect] = "paper",
    *,
    refit: bool = True,
    method: Method = "wls",
    load: LoadSource | None = None,
    processing: Processing | None = None,
    friction_processing: Processing | None = None,
    seed: int = 0,
) -> StagedFit:
    """Identify links from excitation and friction from runs of single joints (Eqs. 11 to 16).

    Parameters
    ----------
    model : Model
        Model of the first stage. That of the paper (Eq. 11) has the effects coulomb, viscous,
        viscous_polynomial and offset.
    excitation : Recording or sequence of Recording
        Motion of all joints, without payload.
    friction_runs : mapping of int to Recording or sequence of Recording
        Forward and backward motion of single joints, by joint from 0. Joints without runs keep
        the friction of the first stage.
    friction_effects : str or sequence of str or Effect
        Friction model of the second stage, see `fit_friction`; ``"paper"`` is Eq. 8.
    refit : bool
        Whether links and friction that grows with speed are identified again (third stage).
        Without it the result is that of the paper's two stages.
    method : str
        Method of the first stage, see `identify`.
    load : {"model", "measured"}, optional
        Source of the load torque of the friction runs, see `friction_curve`; ``"measured"`` for
        runs with a payload.
    processing, friction_processing : Processing, optional
        Filter options of the excitation and of the friction runs.
    seed : int
        Seed of the starting points of the second stage.

    Returns
    -------
    StagedFit

    Raises
    ------
    ModelError
        No friction runs are given.
    LieidError
        As `identify`, `friction_curve` and `fit_friction`.
    """
    if not friction_runs:
        raise ModelError("no friction runs given; expected runs of at least one joint")
    first_stage = identify(model, excitation, method=method, processing=processing)
    effects = friction_effects if isinstance(friction_effects, str) else list(friction_effects)

    def fitted(joint: int) -> FrictionFit:
        curve = friction_curve(
            first_stage, friction_runs[joint], joint, processing=friction_processing, load=load
        )
        return fit_friction(curve, effects, seed=seed)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        friction = dict(zip(friction_runs, pool.map(fitted, friction_runs), strict=True))
    given = listed(excitation)
    return StagedFit(
        first_stage, friction, combine_stages(first_stage, friction, given, refit=refit)
    )
