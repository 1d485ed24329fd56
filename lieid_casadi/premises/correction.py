"""What corrects a premise, in recordings and in samples: a change of signals or of mounting."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import linear_sum_assignment

from lieid_casadi.arrays import Array
from lieid_casadi.errors import RecordingError
from lieid_casadi.premises.plain_fit import Samples
from lieid_casadi.recording import Recording
from lieid_casadi.robot import Robot


@dataclass(frozen=True, eq=False)
class Correction:
    """A change of the signals, from those recorded to those of the model.

    Torques follow from the matrix of the positions by its inverse transpose: power stays the same.
    """

    position: Array  # (n, n) from recorded to model joints: an order, signs, couplings
    zero: Array  # (n,) added to the positions after that, rad or m
    torque: Array  # (n, n) applied to the torques before that: an order, signs, units
    late: float = 0.0  # time by which the torque is late, s
    time: float = 1.0  # factor from the stamps to seconds
    gravity: Array | None = None  # (3,) in the model's base frame, where it is not the robot's
    derive: bool = False  # velocities are derived from the positions
    weight: bool = False  # the stated gravity is added to the torque; by `Screen` alone
    options: tuple[str, ...] = ()  # that state it, such as ``--joint-order 1 3 2``

    @classmethod
    def none(cls, n: int) -> Correction:
        """Return the correction of n joints that changes nothing."""
        return cls(np.eye(n), np.zeros(n), np.eye(n))

    def then(self, later: Correction) -> Correction:
        """Return this correction followed by another."""
        carried = np.linalg.inv(self.position).T
        return Correction(
            later.position @ self.position,
            later.position @ self.zero + later.zero,
            np.linalg.inv(carried) @ later.torque @ carried @ self.torque,
            self.late + later.late,
            self.time * later.time,
            self.gravity if later.gravity is None else later.gravity,
            self.derive or later.derive,
            self.weight or later.weight,
            self.options + later.options,
        )

    @cached_property
    def positions_stay(self) -> bool:
        """Whether positions and time stay as they are."""
        same = np.array_equal(self.position, np.eye(len(self.zero)))
        return same and not self.zero.any() and self.time == 1.0

    @cached_property
    def torque_only(self) -> bool:
        """Whether only torques change, if anything does."""
        return self.positions_stay and self.gravity is None

    @cached_property
    def signals_stay(self) -> bool:
        """Whether velocities and torques stay as they are: another zero, or gravity."""
        n = len(self.zero)
        same = np.array_equal(self.position, np.eye(n)) and np.array_equal(self.torque, np.eye(n))
        return same and not self.late and self.time == 1.0

    @cached_property
    def key(self) -> bytes:
        """Bytes that are the same for the same correction."""
        gravity = np.full(3, np.nan) if self.gravity is None else self.gravity
        parts = [self.position.ravel(), self.zero, self.torque.ravel(), gravity]
        return np.concatenate([*parts, [self.late, self.time, self.weight]]).tobytes()

    @cached_property
    def torque_matrix(self) -> Array:
        """From recorded to model torques (n, n)."""
        return np.asarray(np.linalg.inv(self.position).T @ self.torque)

    def of_samples(self, s: Samples) -> Samples:
        """Return corrected samples."""
        q, dq, ddq = self.of_motion(s)
        return replace(
            s,
            t=s.t * self.time,
            q=q,
            dq=dq,
            ddq=ddq,
            measured=s.measured @ self.position.T,
            tau=self.of_torque(s),
            moving=np.asarray(s.moving @ (self.position != 0.0).T.astype(float) > 0.5),
            window=s.window * self.time,
        )

    def of_motion(self, s: Samples) -> tuple[Array, Array, Array]:
        """Return corrected positions, velocities and accelerations (N, n)."""
        turned, f = self.position.T, self.time
        return s.q @ turned + self.zero, s.dq @ turned / f, s.ddq @ turned / f**2

    def of_torque(self, s: Samples) -> Array:
        """Return corrected torques (N, n)."""
        tau = s.tau
        if self.late:
            tau = np.empty_like(tau)
            for stretch in np.unique(s.segment):
                at = np.flatnonzero(s.segment == stretch)
                tau[at] = shifted(s.t[at], s.tau[at], self.late)
        return np.asarray(tau @ self.torque_matrix.T)

    def of_recording(self, recording: Recording) -> Recording:
        """Return a corrected recording."""
        position, f = self.position.T, self.time
        tau, t = recording.tau, recording.t
        if tau is not None and self.late:
            edges = [(s.t[0], s.t[-1]) for s in recording.segments()]
            tau = tau.copy()
            for first, last in edges:
                at = np.flatnonzero((t >= first) & (t <= last))
                tau[at] = shifted(t[at], tau[at], self.late)

        def turned(x: Array | None) -> Array | None:
            return None if x is None else x @ position

        command = recording.command
        return replace(
            recording,
            t=t * f,
            q=recording.q @ position + self.zero,
            dq=None if self.derive else turned(recording.dq),
            ddq=None if self.derive else turned(recording.ddq),
            command=None if command is None else command @ position + self.zero,
            tau=None if tau is None else tau @ self.torque_matrix.T,
            corrections=recording.corrections + self.options,
        )

    def of_robot(self, robot: Robot) -> Robot:
        """Return the robot as it is mounted."""
        if self.gravity is None:
            return robot
        keeps = robot.source is not None and robot.source.kind != "yaml"  # its text is not changed
        return replace(robot, gravity=self.gravity, source=robot.source if keeps else None)


def shifted(t: Array, x: Array, late: float) -> Array:
    """Return x(t + late) (N, n), the ends held."""
    if len(t) < 4:
        return x
    return np.asarray(CubicSpline(t, x)(np.clip(t + late, t[0], t[-1])))


def base_rpy(gravity: Array) -> tuple[float, float, float]:
    """Return roll, pitch and yaw of a base whose world's gravity points down (3,) → rad."""
    up = -np.asarray(gravity) / np.linalg.norm(gravity)
    pitch = np.arcsin(np.clip(-up[0], -1.0, 1.0))
    roll = np.arctan2(up[1], up[2]) if np.hypot(up[1], up[2]) > 1e-6 else 0.0
    return float(roll), float(pitch), 0.0


def gravity_of(rpy: tuple[float, float, float]) -> Array:
    """Return gravity in the frame of a base mounted with roll, pitch and yaw; see `base_rpy`."""
    roll, pitch, _ = rpy
    up = [-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)]
    return -9.81 * np.array(up)


def correction_of(options: Sequence[str], n: int) -> Correction:
    """Return the correction that options such as ``--joint-order 1 3 2`` state, in any order."""
    given = {text.split()[0]: text.split()[1:] for text in options}
    unknown = [name for name in given if name not in OPTIONS]
    if unknown:
        raise RecordingError(f"{unknown[0]}: unknown correction, expected {', '.join(OPTIONS)}")
    made = Correction.none(n)
    for name, (expected, read) in OPTIONS.items():
        if name in given:
            try:
                made = made.then(read(given[name], n))
            except (ValueError, IndexError):
                found = " ".join([name, *given[name]])
                raise RecordingError(f"{found}: expected {expected.format(n=n)}") from None
    texts = [f"{name} {' '.join(given[name])}".strip() for name in OPTIONS if name in given]
    return replace(made, options=tuple(t for t in texts if not t.startswith("--base-rpy")))


def load_by_columns(
    path: str | Path, columns: Sequence[str], options: Mapping[str, Any]
) -> Recording:
    """Load a recording by the columns of other ones (NAME=COLUMN), if its file has those."""
    if columns:
        with contextlib.suppress(RecordingError):
            return Recording.load(path, **{**options, "columns": ",".join(columns)})
    return Recording.load(path, **options)


def options_of(correction: Correction) -> dict[str, str] | None:
    """Return the options that state a correction, empty if not needed; None if options cannot.

    Positions are coupled · sign · order of those in rad, torques gain · order of what is recorded.
    """
    n = len(correction.zero)
    position = correction.position / np.abs(correction.position).max(axis=0)  # --units converts
    order = linear_sum_assignment(-np.abs(position))[1]
    sign = np.sign(position[np.arange(n), order])
    coupling = position[:, order] * sign - np.eye(n)
    torque = position.T @ correction.torque_matrix
    source = np.argmax(np.abs(torque), axis=1)
    gain = torque[np.arange(n), source]
    single = np.count_nonzero(np.abs(torque) > 1e-9, axis=1) == 1
    if (
        not single.all()
        or not np.isin(coupling, (-1.0, 0.0, 1.0)).all()
        or coupling.diagonal().any()
    ):
        return None
    currents = not np.allclose(np.abs(gain), 1.0)
    prefix = "i" if currents else "tau"
    columns = [f"{prefix}{i + 1}=tau{k + 1}" for i, k in enumerate(source) if currents or i != k]
    gravity = np.zeros(3) if correction.gravity is None else correction.gravity
    stated: dict[str, list[Any]] = {
        "--base-rpy": [*base_rpy(gravity)] if gravity.any() else [],
        "--joint-order": [*order + 1] if np.any(np.diff(order) < 0) else [],
        "--joint-sign": [*sign] if np.any(sign < 0.0) else [],
        "--joint-coupling": [
            f"{i + 1}{'+' if coupling[i, j] > 0.0 else '-'}{j + 1}"
            for i, j in np.argwhere(coupling)
        ],
        "--joint-zero": [*correction.zero] if correction.zero.any() else [],
        "--time-offset": [correction.late] if correction.late else [],
        "--derive-velocity": [""] if correction.derive else [],
        "--torque-sign": [*np.sign(gain)] if np.any(gain < 0.0) else [],
        "--columns": [",".join(columns)] if columns else [],
        "--torque-constants": [",".join(f"{abs(g):.4g}" for g in gain)] if currents else [],
    }
    words = {
        name: [x if isinstance(x, str) else f"{x + 0.0:.4g}" for x in values]
        for name, values in stated.items()
    }
    return {name: " ".join([name, *x]).strip() if x else "" for name, x in words.items()}


def _numbers(words: Sequence[str], count: int) -> Array:
    values = np.array([float(word) for word in words])
    if values.shape != (count,) or not np.all(np.isfinite(values)):
        raise ValueError
    return values


def _signs(words: Sequence[str], n: int) -> Array:
    signs = _numbers(words, n)
    if not np.all(np.abs(signs) == 1.0):
        raise ValueError
    return np.diag(signs)


def _order(words: Sequence[str], n: int) -> Correction:
    order = [int(word) - 1 for word in words]
    if sorted(order) != list(range(n)):
        raise ValueError
    return replace(Correction.none(n), position=np.eye(n)[order])


def _couplings(words: Sequence[str], n: int) -> Correction:
    matrix = np.eye(n)
    for word in words:
        match = re.fullmatch(r"([1-9][0-9]?)([+-])([1-9][0-9]?)", word)
        if match is None or match[1] == match[3]:
            raise ValueError
        matrix[int(match[1]) - 1, int(match[3]) - 1] = 1.0 if match[2] == "+" else -1.0
    return replace(Correction.none(n), position=matrix)


def _flag(words: Sequence[str], n: int) -> Correction:
    if words:
        raise ValueError
    return replace(Correction.none(n), derive=True)


def _base(words: Sequence[str], n: int) -> Correction:
    roll, pitch, yaw = _numbers(words, 3)
    return replace(Correction.none(n), gravity=gravity_of((roll, pitch, yaw)))


#: Options, in the order in which they are applied: what they expect, and how they are read.
OPTIONS: dict[str, tuple[str, Callable[[Sequence[str], int], Correction]]] = {
    "--base-rpy": ("roll, pitch and yaw of the base, rad", _base),
    "--torque-sign": (
        "{n} times 1 or -1, one per torque of the recording",
        lambda words, n: replace(Correction.none(n), torque=_signs(words, n)),
    ),
    "--joint-order": ("the numbers 1 to {n}, the recorded joint at each joint's place", _order),
    "--joint-sign": (
        "{n} times 1 or -1, one per joint",
        lambda words, n: replace(Correction.none(n), position=_signs(words, n)),
    ),
    "--joint-coupling": (
        "couplings such as 6+5 (angle 6 is that of its motor, plus 5)",
        _couplings,
    ),
    "--joint-zero": (
        "{n} angles, rad (m), that are added to the positions",
        lambda words, n: replace(Correction.none(n), zero=_numbers(words, n)),
    ),
    "--time-offset": (
        "the time by which the torque is late, s",
        lambda words, n: replace(Correction.none(n), late=float(_numbers(words, 1)[0])),
    ),
    "--derive-velocity": ("no value", _flag),
}
