"""What corrects a premise: a change of the recording's signals, or of the robot's mounting.

A correction is applied to recordings (by the options of the command line) and to the samples of
the plain fit (to test it), by the same formulas.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import RecordingError
from lieid_casadi.premises.plain_fit import Samples
from lieid_casadi.recording import Recording
from lieid_casadi.robot import Robot


@dataclass(frozen=True, eq=False)
class Correction:
    """A change of the signals, from those recorded to those of the model.

    Attributes
    ----------
    position : (n, n)
        Matrix from recorded to model joints: an order, signs, couplings. Torques follow from it
        by its inverse transpose, so that power stays the same.
    zero : (n,)
        Added to the positions after that, rad or m.
    torque : (n, n)
        Applied to the torques before that: an order, signs or units of torque alone.
    late : float
        Time by which the torque is late, s.
    time : float
        Factor from the stamps to seconds.
    gravity : (3,), optional
        In the model's base frame, m/s², where it is not the robot's.
    derive : bool
        Whether velocities are derived from the positions, not taken from the recording.
    options : tuple of str
        The options that state it, such as ``--joint-order 1 3 2``.
    """

    position: Array
    zero: Array
    torque: Array
    late: float = 0.0
    time: float = 1.0
    gravity: Array | None = None
    derive: bool = False
    options: tuple[str, ...] = ()

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
            self.options + later.options,
        )

    @cached_property
    def torque_alone(self) -> bool:
        """Whether positions, time and gravity stay as they are."""
        same = np.array_equal(self.position, np.eye(len(self.zero))) and not self.zero.any()
        return same and self.time == 1.0 and self.gravity is None

    @cached_property
    def key(self) -> bytes:
        """Bytes that are the same for the same correction."""
        gravity = np.full(3, np.nan) if self.gravity is None else self.gravity
        parts = [self.position.ravel(), self.zero, self.torque.ravel(), gravity]
        return np.concatenate([*parts, [self.late, self.time]]).tobytes()

    @cached_property
    def torque_matrix(self) -> Array:
        """From recorded to model torques (n, n)."""
        return np.asarray(np.linalg.inv(self.position).T @ self.torque)

    def of_samples(self, s: Samples) -> Samples:
        """Return corrected samples."""
        f = self.time
        touched = (self.position != 0.0).astype(float)
        return replace(
            s,
            t=s.t * f,
            q=s.q @ self.position.T + self.zero,
            dq=s.dq @ self.position.T / f,
            ddq=s.ddq @ self.position.T / f**2,
            measured=s.measured @ self.position.T,
            tau=self._earlier(s) @ self.torque_matrix.T,
            moving=np.asarray(s.moving @ touched.T > 0.5),
            window=s.window * f,
        )

    def _earlier(self, s: Samples) -> Array:
        """Return the torque that was recorded later by the delay."""
        if not self.late:
            return s.tau
        late, tau = self.late, np.empty_like(s.tau)
        for stretch in np.unique(s.segment):
            at = np.flatnonzero(s.segment == stretch)
            tau[at] = shifted(s.t[at], s.tau[at], late)
        return tau

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
        keeps = robot.source is not None and robot.source.kind == "urdf"  # no gravity in its text
        return replace(robot, gravity=self.gravity, source=robot.source if keeps else None)


def shifted(t: Array, x: Array, late: float) -> Array:
    """Return x(t + late) (N, n), the ends held."""
    if len(t) < 4:
        return x
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(t, x)(np.clip(t + late, t[0], t[-1])))


def base_rpy(gravity: Array) -> tuple[float, float, float]:
    """Return roll, pitch and yaw of a base whose world's gravity points down (3,) → rad."""
    up = -np.asarray(gravity) / np.linalg.norm(gravity)
    pitch = np.arcsin(np.clip(-up[0], -1.0, 1.0))
    roll = np.arctan2(up[1], up[2]) if np.hypot(up[1], up[2]) > 1e-6 else 0.0
    return float(roll), float(pitch), 0.0


def gravity_of(rpy: tuple[float, float, float], size: float = 9.81) -> Array:
    """Return gravity in the frame of a base mounted with roll, pitch and yaw; see `base_rpy`."""
    roll, pitch, _ = rpy
    up = [-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)]
    return -size * np.array(up)


def correction_of(options: Sequence[str], n: int) -> Correction:
    """Return the correction of n joints that options state, in the order of `OPTIONS`.

    Parameters
    ----------
    options
        Texts such as ``--joint-order 1 3 2``.

    Raises
    ------
    RecordingError
        An unknown option, or other values than it takes.
    """
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
