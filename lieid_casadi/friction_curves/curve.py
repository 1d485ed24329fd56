"""Friction curve of a joint from recordings of its forward and backward motion (Eq. 15).

At equal positions the torques of both directions differ by twice the friction. Instants of a
forward and a backward pass over the same positions are paired, and the pairs averaged in groups of
similar speed and load.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np

from lieid_casadi import errors, plot_style
from lieid_casadi.arrays import Array, Indices, Mask
from lieid_casadi.compiled import compile
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.recording_checks import Source, check_recordings
from lieid_casadi.model import Model
from lieid_casadi.plot_style import Axes, Figure
from lieid_casadi.recording import Processed, Processing, Recording, check, process
from lieid_casadi.recording.recording import listed
from lieid_casadi.robot.robot import Robot
from lieid_casadi.tables import Table, html, make_table

MOST_ROWS = 30  # of a curve's table; its JSON has all
LEAST_SAMPLES = 4  # of a pass
ONE_DIRECTION = 0.99  # least filtered sign of velocity, which excludes samples near reversals
SPEED_RATIO = 1.3  # largest ratio of the two speeds of a pair
OTHERS_APART = 0.03  # rad, largest difference of the other joints' positions in a pair
SPEED_STEP = 0.05  # relative step in which the speeds of two passes are compared
MOST_SPEEDS = 40  # groups
FINEST = 0.06  # least relative width of a speed group
LOADS = 12  # groups
LOAD_RANGE = 0.2  # range of loads, relative to the largest, below which they form one group
LEAST_PAIRS = 3  # of a group
BATCH = 8  # pairs: two periods of the cut-off, beyond which filtered noise is uncorrelated
PRIOR_WEIGHT = 4.0  # number of batches that the common scatter of all groups counts for


@dataclass(frozen=True, eq=False)
class FrictionCurve:
    """Friction torque of one joint: half of forward minus backward torque (Eq. 15).

    It does not contain what differs between the directions (offset, asymmetric friction).
    """

    robot: Robot
    joint: int  # from 0
    unit: str  # unit of the torque
    speed: Array  # (G,) Mean speed of each point, rad/s
    load: Array  # (G,) Mean magnitude of the rigid torque, N·m
    friction: Array  # (G,) Friction torque, N·m
    std: Array  # (G,) Standard error of the friction, N·m
    #: (G,) Number of pairs of a forward and a backward pass that contribute to each point
    count: Indices
    load_source: str  # ``model`` (the rigid torque) or ``measured`` (the mean of both directions)
    cutoff: float  # cut-off frequency of the low-pass filter, Hz
    recordings: tuple[Source, ...]
    warnings: tuple[errors.LieidWarning, ...]

    def __len__(self) -> int:
        return len(self.speed)

    @property
    def joint_name(self) -> str:
        """Name of the joint."""
        return self.robot.joints[self.joint].name

    @property
    def points(self) -> tuple[Array, Array, Array, Array]:
        """Speeds, friction, standard errors and loads (G,)."""
        return self.speed, self.friction, self.std, self.load

    @property
    def load_varies(self) -> bool:
        """Whether the points have different loads."""
        return bool(np.ptp(self.load) > LOAD_RANGE * self.load.max(initial=0.0))

    def to_dict(self) -> dict[str, Any]:
        """Return points and provenance for JSON; joints count from 1."""
        columns = ("speed", "load", "friction", "std", "count")
        values = [getattr(self, name).tolist() for name in columns]
        return {
            "joint": self.joint + 1,
            "unit": self.unit,
            "points": [
                dict(zip(columns, point, strict=True)) for point in zip(*values, strict=True)
            ],
            "load_source": self.load_source,
            "cutoff": self.cutoff,
            "recordings": [r.to_dict() for r in self.recordings],
            "warnings": errors.warning_list(self.warnings),
        }

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw friction over speed, coloured by load, and return the figure."""
        title = f"joint {self.joint + 1} {self.joint_name}: half of forward − backward torque"
        return plot_friction(self.points, self.unit, title, ax=ax)

    def _repr_html_(self) -> str:
        return html(curve_table(self))

    def __repr__(self) -> str:
        return (
            f"<FrictionCurve of {self.joint_name}: {len(self)} points, "
            f"{self.speed.min():.3g} to {self.speed.max():.3g} rad/s>"
        )


def curve_table(curve: FrictionCurve) -> Table:
    """Return the points of a curve over speed, at most `MOST_ROWS` evenly chosen ones."""
    shown = np.argsort(curve.speed, kind="stable")[:: max(1, -(-len(curve) // MOST_ROWS))]
    return make_table(
        f"Friction of joint {curve.joint + 1} {curve.joint_name}: half of forward − backward "
        f"(low-pass {curve.cutoff:.3g} Hz, load {curve.load_source}; {len(shown)} of "
        f"{len(curve)} points)",
        ("speed, rad/s", f"load, {curve.unit}", f"friction, {curve.unit}", "std", "passes"),
        [
            (float(curve.speed[k]), float(curve.load[k]), float(curve.friction[k]),
             float(curve.std[k]), int(curve.count[k]))
            for k in shown
        ],
    )  # fmt: skip


def friction_curve(
    arm: Robot | Fit,
    recordings: Recording | Sequence[Recording],
    joint: int,
    *,
    processing: Processing | None = None,
) -> FrictionCurve:
    """Return the friction of one joint, from 0, from its forward and backward motion.

    Suitable are runs at constant speed and any other motion that passes the same positions in both
    directions while the other joints stand still. The difference of the rigid torque (due to
    different accelerations and velocities) is subtracted where link parameters are known: those
    identified of a fit, or nominal ones. The load that friction may depend on is the rigid torque
    of a fit, or the mean torque of both directions for a robot. Samples near reversals, within the
    length of the filter, are left out.
    """
    given = listed(recordings)
    robot = arm.model.robot if isinstance(arm, Fit) else arm
    if not 0 <= joint < robot.n:
        raise errors.ModelError(f"no joint {joint + 1}; {robot.name} has joints 1 to {robot.n}")
    if not given:
        raise errors.RecordingError("no recordings given; expected at least one")
    check_recordings(Model(robot), given)
    source = "model" if isinstance(arm, Fit) else "measured"
    segments = process(given, processing)
    names = ", ".join(r.name for r in given if r.name) or "recording"
    pairs = _matched(segments, _torques(arm, segments, joint), joint, names)
    load_torque = np.abs(pairs.rigid if source == "model" else pairs.measured)
    pairs, load_torque, member = _grouped(pairs, load_torque)
    size = np.bincount(member)
    found = [w for r in given for w in check(r, robot)]
    found += [w for s in segments for w in s.warnings]
    trends = np.column_stack([pairs.speed, load_torque])
    return FrictionCurve(
        robot=robot,
        joint=joint,
        unit="N·m" if robot.joints[joint].revolute else "N",
        speed=np.bincount(member, pairs.speed) / size,
        load=np.bincount(member, load_torque) / size,
        friction=np.bincount(member, pairs.friction) / size,
        std=_standard_errors(pairs, member, trends),
        count=np.array([len(np.unique(pairs.stretch[member == g])) for g in range(len(size))]),
        load_source=source,
        cutoff=segments[0].cutoff,
        recordings=tuple(Source.of(r) for r in given),
        # the other joints stand still as they should
        warnings=errors.unique_warnings(
            [w for w in found if not isinstance(w, errors.JointStillWarning)]
        ),
    )


def _torques(arm: Robot | Fit, segments: Sequence[Processed], joint: int) -> Array:
    """Return filtered rigid torque and measured torque without that of the armature (M, 2)."""
    robot, armature = (arm.model.robot if isinstance(arm, Fit) else arm), 0.0
    if isinstance(arm, Fit):
        columns = zip(arm.model.columns, arm.effect_coefficients, strict=True)
        own = [x for c, x in columns if (c.joint, c.name) == (joint, "armature.I_a")]
        armature = float(sum(own))
    compiled, parts = compile(Model(robot)), []
    for s in segments:
        assert s.tau is not None  # checked where recordings come in
        rigid = np.zeros(len(s))
        if isinstance(arm, Fit) or robot.has_inertia:
            rigid = compiled.inverse_dynamics(s.q, s.dq, s.ddq, arm.link_parameters)[:, joint]
        measured = s.tau[:, joint] - armature * s.ddq[:, joint]
        parts.append(s.filter(np.column_stack([rigid, measured])))
    return np.concatenate(parts)


@dataclass(frozen=True, eq=False)
class _Pass:
    """Filtered samples of one segment in which a joint moves in one direction."""

    segment: int
    samples: Indices  # (S,) of all segments' filtered samples, in order of increasing position
    position: Array  # (S,) of the joint, increasing, rad
    speed: Array  # (S,) absolute velocity of the joint, rad/s
    forward: bool
    time: float  # mean time of the pass, s

    def over(self, other: _Pass) -> slice:
        """Return the samples at positions that another pass covers."""
        first = int(self.position.searchsorted(other.position[0]))
        return slice(first, int(self.position.searchsorted(other.position[-1], "right")))


@dataclass(frozen=True, eq=False)
class _Pairs:
    """P pairs of instants at which a joint passes the same position forward and backward."""

    friction: Array  # (P,) half of forward − backward of measured − rigid torque, N·m
    rigid: Array  # (P,) mean rigid torque of both directions, N·m
    measured: Array  # (P,) mean measured torque of both directions, N·m
    speed: Array  # (P,) mean of the two speeds, rad/s
    stretch: Indices  # (P,) number of the pair of passes
    samples: Indices  # (P, 2) filtered samples nearest to the two instants

    def at(self, kept: Indices | Mask) -> _Pairs:
        """Return some of the pairs."""
        return _Pairs(**{name: value[kept] for name, value in vars(self).items()})


def _passes(segments: Sequence[Processed], joint: int) -> list[_Pass]:
    found, first = [], 0
    for number, segment in enumerate(segments):
        direction = segment.filter(np.sign(segment.dq[:, joint]))
        steady = (np.abs(direction) > ONE_DIRECTION) & segment.filtered_moving[:, joint]
        side = np.where(steady, np.sign(direction), 0.0)
        q, dq = (x[segment.kept][:, joint] for x in (segment.q, segment.dq))
        for run in np.split(np.arange(len(side)), np.flatnonzero(np.diff(side)) + 1):
            if len(run) < LEAST_SAMPLES or side[run[0]] == 0.0:
                continue
            forward, time = bool(side[run[0]] > 0.0), float(np.mean(segment.filtered_time[run]))
            order = run if forward else run[::-1]
            # noise can reverse the order of positions slightly at low speed
            position = np.maximum.accumulate(q[order])
            found.append(
                _Pass(number, first + order, position, np.abs(dq[order]), forward, time)
            )  # fmt: skip
        first += len(side)
    return found


def _matched(segments: Sequence[Processed], torques: Array, joint: int, name: str) -> _Pairs:
    """Match the forward and backward motion of a joint by position; ``name`` is for messages.

    Each pass is matched with the pass in the opposite direction that covers the same positions
    at the most similar speed, and among equals with the nearest in time.
    """
    passes = _passes(segments, joint)
    _check_directions(passes, segments, joint, name)
    chosen: dict[tuple[int, int], tuple[_Pass, _Pass]] = {}
    for p in passes:
        back = (o for o in passes if o.forward != p.forward)
        others = [o for o in back if len(p.position[p.over(o)]) >= LEAST_SAMPLES]
        if others:
            other = min(others, key=lambda o: _difference(p, o))
            f, b = (p, other) if p.forward else (other, p)
            chosen[id(f), id(b)] = f, b
    if not chosen:
        raise errors.RecordingError(
            f"{name}: joint {joint + 1} passes no position in both directions "
            f"(forward {_extent(passes, forward=True)}, backward "
            f"{_extent(passes, forward=False)} rad); record it forward and backward "
            "over the same range"
        )
    q = np.concatenate([s.q[s.kept] for s in segments])
    made = [_pairs(f, b, k, torques, q) for k, (f, b) in enumerate(chosen.values())]
    pairs = _Pairs(
        **{key: np.concatenate([vars(p)[key] for p, _, _ in made]) for key in vars(made[0][0])}
    )
    similar, still = (np.concatenate([part[k] for part in made]) for k in (1, 2))
    if not similar.any():
        raise errors.RecordingError(
            f"{name}: joint {joint + 1} passes the same positions only at different "
            "speeds; record both directions at the same speeds"
        )
    if not (similar & still).any():
        raise errors.RecordingError(
            f"{name}: when joint {joint + 1} returns to a position, the other joints have moved; "
            "record it while they stand still, or fit friction with identify"
        )
    return pairs.at(similar & still)


def _check_directions(
    passes: Sequence[_Pass], segments: Sequence[Processed], joint: int, name: str
) -> None:
    if not passes:
        fastest = max(float(np.abs(s.dq[:, joint]).max()) for s in segments)
        raise errors.RecordingError(
            f"{name}: joint {joint + 1} never moves in one direction for long enough (fastest "
            f"{fastest:.2g} rad/s); record it moving forward and backward"
        )
    if all(p.forward for p in passes) or not any(p.forward for p in passes):
        found, missing = ("forward", "backward") if passes[0].forward else ("backward", "forward")
        raise errors.RecordingError(
            f"{name}: joint {joint + 1} moves {found} only; friction is half the difference of "
            f"both directions, so record it {missing} over the same positions as well"
        )


def _extent(passes: Sequence[_Pass], *, forward: bool) -> str:
    own = [p.position for p in passes if p.forward == forward]
    return f"{min(x[0] for x in own):.3g} to {max(x[-1] for x in own):.3g}"


def _difference(a: _Pass, b: _Pass) -> tuple[float, bool, float]:
    """Return a sort key of two passes: speed ratio in steps, another segment, time between."""
    inside = a.over(b)
    speed = np.interp(a.position[inside], b.position, b.speed)
    ratio = median(np.abs(np.log(a.speed[inside] / speed)).tolist())  # of few: faster than NumPy's
    return round(ratio / SPEED_STEP), a.segment != b.segment, abs(a.time - b.time)


def _pairs(f: _Pass, b: _Pass, stretch: int, torques: Array, q: Array) -> tuple[_Pairs, Mask, Mask]:
    """Return a pair for each forward sample, and where speeds are similar and others still."""
    inside = f.over(b)
    at = f.samples[inside]
    place = np.interp(f.position[inside], b.position, np.arange(len(b.position)))
    before = np.minimum(place.astype(np.intp), len(b.position) - 2)
    share = (place - before)[:, None]
    first, second = b.samples[before], b.samples[before + 1]

    def back(values: Array) -> Array:
        return np.asarray((1.0 - share) * values[first] + share * values[second])

    there, speeds = (
        back(torques),
        (f.speed[inside], np.interp(f.position[inside], b.position, b.speed)),
    )
    half, mean = 0.5 * (torques[at] - there), 0.5 * (torques[at] + there)
    apart = np.abs(q[at] - back(q)).max(axis=1)
    pairs = _Pairs(
        friction=half[:, 1] - half[:, 0],
        rigid=mean[:, 0],
        measured=mean[:, 1],
        speed=0.5 * (speeds[0] + speeds[1]),
        stretch=np.full(len(at), stretch),
        samples=np.column_stack([at, np.where(share[:, 0] < 0.5, first, second)]),
    )
    similar = np.abs(np.log(speeds[0] / speeds[1])) <= np.log(SPEED_RATIO)
    return pairs, similar, apart <= OTHERS_APART


def _grouped(pairs: _Pairs, load: Array) -> tuple[_Pairs, Array, Indices]:
    """Group pairs by speed (logarithmically) and, if it varies, by the magnitude of the load."""
    logarithm = np.log(pairs.speed)
    width = max(FINEST, float(np.ptp(logarithm)) / MOST_SPEEDS)
    cell = ((logarithm - logarithm.min()) / width).astype(np.intp) * LOADS
    low, high = load.min(), load.max()
    if high - low > LOAD_RANGE * high:
        cell += np.minimum((load - low) / (high - low) * LOADS, LOADS - 1).astype(np.intp)
    _, member, size = np.unique(cell, return_inverse=True, return_counts=True)
    kept = size[member] >= min(LEAST_PAIRS, size.max())
    _, member = np.unique(member[kept], return_inverse=True)
    return pairs.at(kept), load[kept], member.astype(np.intp)


def _standard_errors(pairs: _Pairs, member: Indices, trends: Array) -> Array:
    """Return the standard error (G,) of the average friction of each group.

    Neighbouring pairs are correlated, batches of them are not. The variance is estimated from the
    means of batches, without the linear influence of ``trends`` (P, k) within the groups, and
    shrunk towards the variance common to all groups, which dominates in groups with few batches.
    """
    size = np.bincount(member)
    values = np.column_stack([pairs.friction, trends])
    means = np.array([np.bincount(member, column) / size for column in values.T]).T
    scatter = values - means[member]
    slope = np.linalg.lstsq(scatter[:, 1:], scatter[:, 0], rcond=None)[0]
    residual = scatter[:, 0] - scatter[:, 1:] @ slope
    batch, owner = _batches(member, pairs.stretch)
    length = np.bincount(batch)
    # var(batch mean) = variance/length, so that batches are weighted by their length
    squares = np.bincount(owner, np.bincount(batch, residual) ** 2 / length)
    freedom = np.maximum(np.bincount(owner) - 1.0, 0.0)
    # a sample that occurs c times in a group contributes c² to its variance: Σ c² / Σ c
    keys, uses = np.unique(
        member[:, None] * (int(pairs.samples.max()) + 1) + pairs.samples, return_counts=True
    )
    group = keys // (int(pairs.samples.max()) + 1)
    independent = size * np.bincount(group, uses) / np.bincount(group, uses**2)
    if freedom.sum() == 0.0:
        return np.asarray(np.sqrt(np.mean(residual**2) / np.maximum(independent / BATCH, 1.0)))
    common = squares[freedom > 0].sum() / freedom.sum()
    variance = (PRIOR_WEIGHT * common + squares) / (PRIOR_WEIGHT + freedom)
    return np.asarray(np.sqrt(variance / independent))


def _batches(member: Indices, stretch: Indices) -> tuple[Indices, Indices]:
    """Return the batch of each pair, and the group of each batch."""
    change = (np.diff(member) != 0) | (np.diff(stretch) != 0)
    run = np.concatenate([[0], np.cumsum(change)])
    first = np.concatenate([[0], np.flatnonzero(change) + 1])
    within = (np.arange(len(member)) - first[run]) // BATCH
    _, index, batch = np.unique(
        np.column_stack([run, within]), axis=0, return_index=True, return_inverse=True
    )
    return np.ravel(batch).astype(np.intp), member[index]


COLOURS = "viridis"
LINES = 3


def plot_friction(
    points: tuple[Array, Array, Array, Array],
    unit: str,
    title: str,
    *,
    model: Callable[[Array, float], Array] | None = None,
    ax: Axes | None = None,
) -> Figure:
    """Draw speeds, friction, standard errors and loads (G,) as points; return the figure."""
    speed, friction, std, load = points
    figure, ax = plot_style.drawing(ax, 7.0, 4.2)
    plot_style.style(ax)
    ax.errorbar(speed, friction, std, fmt="none", ecolor=plot_style.MEASURED, zorder=2)
    cloud = ax.scatter(speed, friction, c=load, cmap=COLOURS, s=16, zorder=3, vmin=0.0)
    bar = figure.colorbar(cloud, ax=ax)
    bar.set_label(f"|τ_load| [{unit}]", fontsize=plot_style.SMALL)
    bar.ax.tick_params(labelsize=plot_style.SMALL)
    if model is not None:
        drawn = np.geomspace(speed.min(), speed.max(), 200)
        for each in np.linspace(load.min(), load.max(), LINES):
            ax.plot(drawn, model(drawn, each), color=cloud.to_rgba(each), linewidth=1.2)
    plot_style.title(ax, title)
    speed_unit = "rad/s" if unit == "N·m" else "m/s"
    plot_style.label(ax, x=f"|q̇| [{speed_unit}]", y=f"friction [{unit}]")
    ax.autoscale(True)
    ax.set_xlim(left=0.0)
    if friction.min() > 0.0:
        ax.set_ylim(bottom=0.0)
    return figure
