"""The paper's two stages: inertias first, then each joint's friction by itself (4.1, 4.2)."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.effects import Effect, Placement
from lieid_casadi.errors import LieidWarning
from lieid_casadi.friction_curves.agreement import FrictionAgreement, compare_friction
from lieid_casadi.friction_curves.constant_speed import steady_columns
from lieid_casadi.friction_curves.extraction import friction_curve
from lieid_casadi.friction_curves.fit_curve import fit_friction
from lieid_casadi.friction_curves.friction_fit import FrictionFit
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.identify import identify
from lieid_casadi.identification.prediction import torque_along
from lieid_casadi.identification.temperature import relative_temperature
from lieid_casadi.model import Model
from lieid_casadi.recording import Processing, Recording, process

Array = NDArray[np.float64]
SPEEDS = np.array([0.03, 0.3, 1.0])  # rad/s, at which a friction column differs from zero


@dataclass(frozen=True, eq=False)
class TwoStage:
    """Result of `two_stage`.

    Attributes
    ----------
    rigid : Fit
        First stage, with its simple friction.
    friction : dict of int to FrictionFit
        Second stage, by joint from 0.
    fit : Fit
        Both together: links, armatures and offsets of the first stage, friction of the second
        where there is one. Its covariance takes the stages as independent.
    """

    rigid: Fit
    friction: dict[int, FrictionFit]
    fit: Fit

    def compare(self, joint_fit: Fit) -> tuple[FrictionAgreement, ...]:
        """Compare each joint's friction with that of a fit of everything together."""
        return tuple(compare_friction(own, joint_fit) for own in self.friction.values())

    def to_dict(self) -> dict[str, Any]:
        """Return the friction of each joint, and the first stage."""
        return {
            "rigid": self.rigid.to_dict(),
            "friction": [own.to_dict() for own in self.friction.values()],
        }


def two_stage(
    model: Model,
    excitation: Recording | Sequence[Recording],
    runs: Mapping[int, Recording | Sequence[Recording]],
    effects: str | Iterable[str | Effect] = "paper",
    *,
    method: str = "wls",
    processing: Processing | None = None,
    friction_processing: Processing | None = None,
    seed: int = 0,
) -> TwoStage:
    """Identify inertias from excitation with simple friction, then friction joint by joint.

    Parameters
    ----------
    model : Model
        For the first stage; the paper's (Eq. 11) has coulomb, viscous, viscous_polynomial and
        offset.
    excitation : Recording or sequence of Recording
    runs : mapping of int to recordings
        Forward and backward motion of single joints (from 0). Joints without keep the friction
        of the first stage.
    effects : str or sequence of str or Effect
        Friction model of the second stage, see `fit_friction`.
    method : str
        Of the first stage, see `identify`.
    processing, friction_processing : Processing, optional
    seed : int
        Of the second stage's starts.

    Raises
    ------
    LieidError
        As `identify`, `friction_curve` and `fit_friction` do.
    """
    rigid = identify(model, excitation, method=method, processing=processing)
    spec = effects if isinstance(effects, str) else list(effects)

    def fitted(joint: int) -> FrictionFit:
        curve = friction_curve(rigid, runs[joint], joint, processing=friction_processing)
        return fit_friction(curve, spec, seed=seed)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        friction = dict(zip(runs, pool.map(fitted, runs), strict=True))
    given = [excitation] if isinstance(excitation, Recording) else list(excitation)
    return TwoStage(rigid, friction, together(rigid, friction, given))


def together(
    rigid: Fit, friction: Mapping[int, FrictionFit], excitation: Sequence[Recording]
) -> Fit:
    """Put a first stage and friction by joint (from 0) together, as `two_stage` does.

    For friction curves that were made otherwise, with a payload for instance.

    Parameters
    ----------
    rigid : Fit
        First stage; its friction is kept on joints without a second stage.
    friction : mapping of int to FrictionFit
    excitation : sequence of Recording
        That ``rms_train`` refers to.
    """
    placements = _kept(rigid, friction)
    for own in friction.values():
        placements += own.model.placements
    model = Model.of_placements(rigid.model.robot, placements)
    numbers, mean = _numbers(rigid, friction), _temperature_mean(rigid, friction)
    coefficients = [numbers[c.label] for c in model.columns]
    parameters = np.concatenate([rigid.link_parameters, coefficients])
    values = model.base.combination @ parameters
    shapes = np.array([numbers[s.label] for s in model.shapes])
    fit = replace(
        rigid,
        model=model,
        method="two_stage",
        values=values,
        shapes=shapes,
        covariance=_covariance(model, rigid, friction),
        parameters=parameters,
        rms_cv=np.full(model.n, np.nan),
        warnings=_warnings(rigid, friction),
        temperature_mean=mean,
        certificate=None,
    )
    filtered, raw = [], []
    for segment in process(excitation, rigid.processing):
        warm = relative_temperature(segment, mean)
        assert warm.tau is not None  # the first stage was identified from it
        raw.append(warm.tau - torque_along(fit.compiled, warm, parameters, shapes))
        filtered.append(segment.filter(raw[-1]))
    return replace(fit, rms_train=_rms(filtered), rms_train_raw=_rms(raw))


def _temperature_mean(rigid: Fit, friction: Mapping[int, FrictionFit]) -> Array | None:
    """Return what temperatures refer to: the first stage's mean, which curves take over."""
    means = [own.curve.data.temperature_mean for own in friction.values()]
    return next((m for m in (rigid.temperature_mean, *means) if m is not None), None)


def _kept(rigid: Fit, friction: Mapping[int, FrictionFit]) -> list[Placement]:
    """Return the first stage's effects that the second does not stand for.

    It stands for friction that is odd in speed, on its own joints.
    """
    odd = {
        joint: np.any(
            steady_columns(rigid.compiled, joint, SPEEDS, rigid.shapes, load=1.0, temperature=1.0),
            axis=0,
        )
        for joint in friction
    }
    kept, first = [], 0
    for placement in rigid.model.placements:
        own = slice(first, first + len(placement.effect.coefficients))
        first = own.stop
        if placement.joint not in friction or not odd[placement.joint][own].any():
            kept.append(placement)
    return kept


def _numbers(rigid: Fit, friction: Mapping[int, FrictionFit]) -> dict[str, float]:
    """Return each coefficient and shape by its label, the second stage's where there is one."""
    first = (*rigid.model.columns, *rigid.model.shapes)
    values = np.concatenate([rigid.effect_coefficients, rigid.shapes])
    found = {p.label: float(value) for p, value in zip(first, values, strict=True)}
    for own in friction.values():
        values = np.concatenate([own.coefficients, own.shapes])
        found |= {p.label: float(x) for p, x in zip(own.parameters, values, strict=True)}
    return found


def _covariance(model: Model, rigid: Fit, friction: Mapping[int, FrictionFit]) -> Array:
    """Return the covariance (p + s, p + s) of both stages side by side."""
    labels = [p.label for p in (*model.base_columns, *model.shapes)]
    covariance = np.zeros((len(labels), len(labels)))
    second = {p.label for own in friction.values() for p in own.parameters}
    stages: list[tuple[list[str], Array]] = [
        ([p.label if p.label not in second else "" for p in rigid.fitted], rigid.covariance)
    ]
    stages += [([p.label for p in own.parameters], own.covariance) for own in friction.values()]
    for names, block in stages:
        here = [k for k, name in enumerate(names) if name in labels]
        there = [labels.index(names[k]) for k in here]
        covariance[np.ix_(there, there)] = block[np.ix_(here, here)]
    return covariance


def _warnings(rigid: Fit, friction: Mapping[int, FrictionFit]) -> tuple[LieidWarning, ...]:
    found = [*rigid.warnings]
    for own in friction.values():
        found += [*own.curve.warnings, *own.warnings]
    return tuple({(type(w), str(w)): w for w in found}.values())


def _rms(errors: Sequence[Array]) -> Array:
    return np.asarray(np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0)))
