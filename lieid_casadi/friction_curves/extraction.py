"""Friction curve of a joint from recordings of its forward and backward motion (Eq. 15)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import Compiled, compile
from lieid_casadi.errors import (
    JointStillWarning,
    LieidWarning,
    LoadMismatchWarning,
    ModelError,
    RecordingError,
    RobotError,
    unique_warnings,
)
from lieid_casadi.friction_curves.binning import group_pairs, standard_errors
from lieid_casadi.friction_curves.curve import FrictionCurve
from lieid_casadi.friction_curves.curve_data import CurveData
from lieid_casadi.friction_curves.position_matching import Matching, match
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.prediction import center_temperature
from lieid_casadi.identification.recording_checks import Source
from lieid_casadi.model import Model
from lieid_casadi.recording import Processed, Processing, Recording, check, process
from lieid_casadi.recording.recording import listed
from lieid_casadi.robot.robot import Robot

LoadSource = Literal["model", "measured"]
LOAD_MISMATCH = 0.1  # difference relative to the RMS of the load that is reported


def friction_curve(
    arm: Robot | Fit,
    recordings: Recording | Sequence[Recording],
    joint: int,
    *,
    processing: Processing | None = None,
    load: LoadSource | None = None,
) -> FrictionCurve:
    """Return the friction of one joint from its forward and backward motion.

    At equal positions the torques of both directions differ by twice the friction. Where link
    parameters are known, the difference of the rigid torque (due to different accelerations and
    velocities) is subtracted. Suitable are runs at constant speed and any other motion that
    passes the same positions in both directions while the other joints stand still. Samples near
    reversals, within the length of the filter, are left out.

    ``arm``: source of link parameters: identified ones and armatures of a fit, or nominal ones;
    ``recordings``: recordings with torques; ``joint``: from 0; ``processing``: filter options; by
    default the cut-off is chosen from the spectrum. ``load``: source of the load that friction may
    depend on: the rigid torque of the model, or the mean torque of both directions. The default is
    the model for a fit and the measurement for a robot, whose inertias are nominal.
    Raises `RecordingError`: the joint never moves or moves in one direction only, or passes no
    position in both directions. Raises `ModelError`: the arm does not have this joint, or
    recordings have no torque or are of another arm. Raises `RobotError`: ``load="model"`` is given
    for a robot without inertias.
    """
    given = listed(recordings)
    robot = arm.model.robot if isinstance(arm, Fit) else arm
    _check(robot, given, joint)
    links = _link_parameters(arm)
    if links is None and load == "model":
        raise RobotError(f"{robot.name}: its links have no inertia; expected load='measured'")
    compiled = compile(Model(robot))
    found = [w for r in given for w in check(r, robot)]
    mean = arm.temperature_mean if isinstance(arm, Fit) else None
    segments, mean = center_temperature(process(given, processing), mean)
    found += [w for s in segments for w in s.warnings]
    motion = _MatchedMotion(segments, match(segments, joint, name=_name(given)), joint)
    source: LoadSource = load or ("model" if isinstance(arm, Fit) else "measured")
    rigid = [_rigid(compiled, s, links)[:, joint] for s in segments]
    series = rigid if source == "model" else motion.measured_load()
    remaining = [
        _torque(s)[:, joint] - x - _armature(arm, joint) * s.ddq[:, joint]
        for s, x in zip(segments, rigid, strict=True)
    ]
    mismatch = float("nan") if links is None else _rms(motion.half_sum(remaining))
    found += _load_warnings(mismatch, _rms(motion.half_sum(rigid)), joint, source)
    speed, load_torque = motion.matching.speed, motion.half_sum(series)
    data = CurveData(
        robot=robot,
        segments=segments,
        load=tuple(_in_joint(x, joint, robot.n) for x in series),
        matching=motion.matching,
        groups=group_pairs(speed, load_torque, motion.matching.stretch),
        friction=motion.half_difference(remaining),
        temperature_mean=mean,
    )
    return FrictionCurve(
        joint=joint,
        joint_name=robot.joints[joint].name,
        unit="N·m" if robot.joints[joint].revolute else "N",
        speed=data.groups.mean(speed),
        load=data.groups.mean(np.abs(load_torque)),
        friction=data.groups.mean(data.friction),
        std=standard_errors(
            data.groups,
            data.friction,
            motion.matching.stretch,
            motion.matching.samples,
            np.column_stack([speed, np.abs(load_torque)]),
        ),
        count=data.groups.count,
        load_source=source,
        load_error=mismatch,
        cutoff=segments[0].cutoff,
        recordings=tuple(Source.of(r) for r in given),
        warnings=_unique(found),
        data=data,
    )


@dataclass(frozen=True, eq=False)
class _MatchedMotion:
    """Segments with the matched pairs of instants of one joint."""

    segments: tuple[Processed, ...]
    matching: Matching
    joint: int

    def half_sum(self, series: Sequence[Array]) -> Array:
        return self.matching.half_sum(self._filtered(series))

    def half_difference(self, series: Sequence[Array]) -> Array:
        return self.matching.half_difference(self._filtered(series))

    def _filtered(self, series: Sequence[Array]) -> Array:
        return np.concatenate([s.filter(x) for s, x in zip(self.segments, series, strict=True)])

    def measured_load(self) -> list[Array]:
        """Return the mean torque of both directions, interpolated by position (K,) per segment.

        Each segment uses its own pairs, or those of all segments if it has none.
        """
        mean = self.half_sum([_torque(s)[:, self.joint] for s in self.segments])
        ends = np.cumsum([0, *(len(s.filtered_time) for s in self.segments)])
        first = self.matching.forward.indices
        loads = []
        for segment, a, b in zip(self.segments, ends[:-1], ends[1:], strict=True):
            own = (first >= a) & (first < b)
            own = own if own.any() else np.ones(len(first), dtype=bool)
            order = np.argsort(self.matching.position[own])
            position, value = self.matching.position[own][order], mean[own][order]
            loads.append(np.interp(segment.q[:, self.joint], position, value))
        return loads


def _check(robot: Robot, recordings: Sequence[Recording], joint: int) -> None:
    if not 0 <= joint < robot.n:
        raise ModelError(f"no joint {joint + 1}; {robot.name} has joints 1 to {robot.n}")
    if not recordings:
        raise RecordingError("no recordings given; expected at least one")
    for recording in recordings:
        name = recording.name or "recording"
        if recording.n != robot.n:
            raise ModelError(f"{name}: {recording.n} joints; robot {robot.name!r} has {robot.n}")
        if recording.tau is None:
            raise ModelError(
                f"{name}: no torque; expected columns tau1…tau{robot.n}, or currents and torque "
                "constants"
            )


def _link_parameters(arm: Robot | Fit) -> Array | None:
    if isinstance(arm, Fit):
        return arm.link_parameters
    return arm.link_parameters if arm.has_inertia else None


def _armature(arm: Robot | Fit, joint: int) -> float:
    """Return the identified armature of a joint, kg·m², zero if the links absorbed it."""
    if not isinstance(arm, Fit):
        return 0.0
    return sum(
        float(value)
        for column, value in zip(arm.model.columns, arm.effect_coefficients, strict=True)
        if column.joint == joint and column.name == "armature.I_a"
    )


def _rigid(compiled: Compiled, segment: Processed, links: Array | None) -> Array:
    if links is None:
        return np.zeros_like(segment.q)
    return compiled.inverse_dynamics(segment.q, segment.dq, segment.ddq, links)


def _load_warnings(
    mismatch: float, size: float, joint: int, source: LoadSource
) -> list[LieidWarning]:
    if not mismatch > LOAD_MISMATCH * size:
        return []
    consequence = (
        "but its load dependence is" if source == "model" else "and its load is the measured one"
    )
    return [
        LoadMismatchWarning(
            f"joint {joint + 1}: the mean torque of both directions differs from the model's rigid "
            f"torque by {mismatch:.3g} N·m RMS, which is "
            f"{100.0 * mismatch / max(size, 1e-300):.0f} % of the rigid torque; check inertias, "
            "tool, torque constants and the offset of the torque signal. The friction torque is "
            f"not affected, {consequence}"
        )
    ]


def _in_joint(series: Array, joint: int, n: int) -> Array:
    whole = np.zeros((len(series), n))
    whole[:, joint] = series
    return whole


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _torque(segment: Processed) -> Array:
    assert segment.tau is not None  # checked where recordings come in
    return segment.tau


def _name(recordings: Sequence[Recording]) -> str:
    return ", ".join(r.name for r in recordings if r.name) or "recording"


def _unique(found: Sequence[LieidWarning]) -> tuple[LieidWarning, ...]:
    """Remove repeated warnings, and those of joints that stand still as they should."""
    return unique_warnings([w for w in found if not isinstance(w, JointStillWarning)])
