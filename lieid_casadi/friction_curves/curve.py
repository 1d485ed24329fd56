"""Friction curve of a joint from recordings of its forward and backward motion (Eq. 15)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

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
    warning_list,
)
from lieid_casadi.friction_curves.matching import (
    Matching,
    PairGroups,
    group_pairs,
    match,
    standard_errors,
)
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.prediction import center_temperature
from lieid_casadi.identification.recording_checks import Source, check_recordings
from lieid_casadi.json_numbers import number_or_none
from lieid_casadi.model import Model
from lieid_casadi.recording import Processed, Processing, Recording, check, process
from lieid_casadi.recording.recording import listed
from lieid_casadi.robot.robot import Robot
from lieid_casadi.tables import Table, html, make_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MOST_INSTANTS = 30  # of a point and direction, if columns are averaged over a subset


@dataclass(frozen=True, eq=False)
class CurveData:
    """Segments of motion, pairs of instants in them, and groups of pairs."""

    robot: Robot
    segments: tuple[Processed, ...]  # their temperatures are relative to ``temperature_mean``
    load: tuple[Array, ...]  # τ_load along each segment, N·m; zero for the other joints
    matching: Matching
    groups: PairGroups
    friction: Array  # (P,) Friction torque of each pair of instants, N·m
    temperature_mean: Array | None  # (n,) or None Mean temperature of the training recordings, °C

    @property
    def has_temperature(self) -> bool:
        """Whether all segments have a temperature."""
        return all(s.temperature is not None for s in self.segments)

    def columns(
        self, compiled: Compiled, joint: int, shapes: Array, *, thinned: bool = False
    ) -> Array:
        """Return the columns of effects, matched and averaged like the torque.

        The columns are not filtered: near the instants used there is no reversal, and between
        reversals the filter hardly changes them. Effects with memory are evaluated along the
        segments.
        """
        average, used = self._thinned if thinned else self._whole
        if compiled.model.states:
            whole = [
                self._along(compiled, k, slice(None), shapes)[s.kept, joint]
                for k, s in enumerate(self.segments)
            ]
            return np.asarray(average @ np.concatenate(whole)[used])
        parts = [
            self._along(compiled, k, rows, shapes)[:, joint]
            for k, rows in enumerate(self._rows(used))
        ]
        return np.asarray(average @ np.concatenate(parts))

    def _along(
        self, compiled: Compiled, number: int, rows: slice | NDArray[np.intp], shapes: Array
    ) -> Array:
        """Return the columns (R, n, m) at rows of a segment's grid."""
        s = self.segments[number]
        return compiled.effect_columns(
            s.q[rows],
            s.dq[rows],
            s.ddq[rows],
            load=self.load[number][rows],
            temperature=None if s.temperature is None else s.temperature[rows],
            time=(s.t - s.t[0])[rows],
            shapes=shapes,
            dead_zone=s.dead_zone,
        )

    @cached_property
    def _difference(self) -> csr_matrix[np.float64]:
        """Matrix (G, M) that averages half the difference of both directions."""
        halves = 0.5 * (self.matching.forward - self.matching.backward)
        return csr_matrix(self.groups.average @ halves)

    @cached_property
    def _whole(self) -> tuple[csr_matrix[np.float64], NDArray[np.intp]]:
        """`_difference` restricted to the samples that it uses (G, U), and their indices (U,)."""
        return _on_used(self._difference)

    @cached_property
    def _thinned(self) -> tuple[csr_matrix[np.float64], NDArray[np.intp]]:
        """The same with at most MOST_INSTANTS per point and direction, weights scaled up."""
        whole = self._difference
        entries, columns, starts = [], [], [0]
        for first, last in zip(whole.indptr[:-1], whole.indptr[1:], strict=True):
            weights, at = whole.data[first:last], whole.indices[first:last]
            order = np.argsort(at, kind="stable")
            weights, at = weights[order], at[order]
            for direction in (weights > 0.0, weights < 0.0):
                own, where = weights[direction], at[direction]
                step = -(-len(own) // MOST_INSTANTS) or 1
                chosen = own[step // 2 :: step]
                if len(chosen):
                    entries.append(chosen * (own.sum() / chosen.sum()))
                    columns.append(where[step // 2 :: step])
            starts.append(sum(len(x) for x in entries))
        some = (np.concatenate(entries), np.concatenate(columns), starts)
        return _on_used(csr_matrix(some, shape=whole.shape))

    def _rows(self, used: NDArray[np.intp]) -> list[NDArray[np.intp]]:
        """Return indices of filtered samples as rows of each segment's grid."""
        ends = np.cumsum([0, *(len(s.filtered_time) for s in self.segments)])
        return [
            np.arange(len(s))[s.kept][used[(used >= a) & (used < b)] - a]
            for s, a, b in zip(self.segments, ends[:-1], ends[1:], strict=True)
        ]


def _on_used(
    matrix: csr_matrix[np.float64],
) -> tuple[csr_matrix[np.float64], NDArray[np.intp]]:
    used = np.unique(matrix.nonzero()[1]).astype(np.intp)
    return csr_matrix(matrix[:, used]), used


@dataclass(frozen=True, eq=False)
class FrictionCurve:
    """Friction torque of one joint: half of forward minus backward torque (Eq. 15).

    It does not contain what differs between the directions (offset, asymmetric friction).
    """

    joint: int  # from 0
    joint_name: str
    unit: str  # unit of the torque
    speed: Array  # (G,) Mean speed of each point, rad/s
    load: Array  # (G,) Mean magnitude of the rigid torque, N·m
    friction: Array  # (G,) Friction torque, N·m
    std: Array  # (G,) Standard error of the friction, N·m
    #: (G,) int Number of pairs of a forward and a backward pass that contribute to each point
    count: NDArray[np.intp]
    load_source: str  # ``model`` (the rigid torque) or ``measured`` (the mean of both directions)
    #: RMS difference between the mean torque of both directions and the model's rigid torque, N·m;
    #: NaN without a model
    load_error: float
    cutoff: float  # cut-off frequency of the low-pass filter, Hz
    recordings: tuple[Source, ...]
    warnings: tuple[LieidWarning, ...]
    #: the pairs of instants, from which columns of friction models are averaged
    data: CurveData = field(repr=False)

    def __len__(self) -> int:
        return len(self.speed)

    @property
    def points(self) -> tuple[Array, Array, Array, Array]:
        """Speeds, friction, standard errors and loads (G,)."""
        return self.speed, self.friction, self.std, self.load

    def to_dict(self) -> dict[str, Any]:
        """Return points and provenance for JSON; joints count from 1."""
        return {
            "joint": self.joint + 1,
            "unit": self.unit,
            "points": [
                {
                    "speed": float(speed),
                    "load": float(load),
                    "friction": float(friction),
                    "std": float(std),
                    "count": int(count),
                }
                for speed, load, friction, std, count in zip(
                    self.speed, self.load, self.friction, self.std, self.count, strict=True
                )
            ],
            "load_source": self.load_source,
            "load_error": number_or_none(self.load_error),
            "cutoff": self.cutoff,
            "recordings": [r.to_dict() for r in self.recordings],
            "warnings": warning_list(self.warnings),
        }

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw friction over speed, coloured by load, and return the figure."""
        from lieid_casadi.friction_curves.plots import plot_friction

        title = f"joint {self.joint + 1} {self.joint_name}: half of forward − backward torque"
        return plot_friction(self.points, self.unit, title, ax=ax)

    def _repr_html_(self) -> str:
        return html(curve_table(self))

    def __repr__(self) -> str:
        return (
            f"<FrictionCurve of {self.joint_name}: {len(self)} points, "
            f"{self.speed.min():.3g} to {self.speed.max():.3g} rad/s>"
        )


MOST_ROWS = 30  # of a curve; its JSON has all


def curve_table(curve: FrictionCurve) -> Table:
    """Return the points of a curve over speed, at most `MOST_ROWS` evenly chosen ones."""
    order = sorted(range(len(curve)), key=lambda k: float(curve.speed[k]))
    shown = order[:: max(1, -(-len(curve) // MOST_ROWS))]
    return make_table(
        f"Friction of joint {curve.joint + 1} {curve.joint_name}: half of forward − backward "
        f"(low-pass {curve.cutoff:.3g} Hz, load {curve.load_source}; {len(shown)} of "
        f"{len(curve)} points)",
        ("speed, rad/s", f"load, {curve.unit}", f"friction, {curve.unit}", "std", "passes"),
        [
            (
                float(curve.speed[k]),
                float(curve.load[k]),
                float(curve.friction[k]),
                float(curve.std[k]),
                int(curve.count[k]),
            )
            for k in shown
        ],
    )


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
    names = ", ".join(r.name for r in given if r.name) or "recording"
    matching = match(segments, joint, name=names)
    source: LoadSource = load or ("model" if isinstance(arm, Fit) else "measured")
    rigid = [_rigid(compiled, s, links)[:, joint] for s in segments]
    series = rigid if source == "model" else _measured_load(segments, matching, joint)
    remaining = [
        _torque(s)[:, joint] - x - _armature(arm, joint) * s.ddq[:, joint]
        for s, x in zip(segments, rigid, strict=True)
    ]
    remaining_filtered = _filtered(segments, remaining)
    mismatch = float("nan") if links is None else _rms(matching.half_sum(remaining_filtered))
    size = _rms(matching.half_sum(_filtered(segments, rigid)))
    found += _load_warnings(mismatch, size, joint, source)
    speed, load_torque = matching.speed, matching.half_sum(_filtered(segments, series))
    data = CurveData(
        robot=robot,
        segments=segments,
        load=tuple(_in_joint(x, joint, robot.n) for x in series),
        matching=matching,
        groups=group_pairs(speed, load_torque, matching.stretch),
        friction=matching.half_difference(remaining_filtered),
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
            matching.stretch,
            matching.samples,
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


def _filtered(segments: Sequence[Processed], series: Sequence[Array]) -> Array:
    return np.concatenate([s.filter(x) for s, x in zip(segments, series, strict=True)])


def _measured_load(segments: Sequence[Processed], matching: Matching, joint: int) -> list[Array]:
    """Return the mean torque of both directions, interpolated by position (K,) per segment.

    Each segment uses its own pairs, or those of all segments if it has none.
    """
    mean = matching.half_sum(_filtered(segments, [_torque(s)[:, joint] for s in segments]))
    ends = np.cumsum([0, *(len(s.filtered_time) for s in segments)])
    first = matching.forward.indices
    loads = []
    for segment, a, b in zip(segments, ends[:-1], ends[1:], strict=True):
        own = (first >= a) & (first < b)
        own = own if own.any() else np.ones(len(first), dtype=bool)
        order = np.argsort(matching.position[own])
        position, value = matching.position[own][order], mean[own][order]
        loads.append(np.interp(segment.q[:, joint], position, value))
    return loads


def _check(robot: Robot, recordings: Sequence[Recording], joint: int) -> None:
    if not 0 <= joint < robot.n:
        raise ModelError(f"no joint {joint + 1}; {robot.name} has joints 1 to {robot.n}")
    if not recordings:
        raise RecordingError("no recordings given; expected at least one")
    check_recordings(Model(robot), recordings)


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


def _unique(found: Sequence[LieidWarning]) -> tuple[LieidWarning, ...]:
    """Remove repeated warnings, and those of joints that stand still as they should."""
    return unique_warnings([w for w in found if not isinstance(w, JointStillWarning)])
