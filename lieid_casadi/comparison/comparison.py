"""Result of a comparison: errors per joint, their table and their summary in sentences."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from lieid_casadi.arrays import Array, Mask
from lieid_casadi.comparison import plots
from lieid_casadi.comparison.noise_floor import SOURCES
from lieid_casadi.comparison.series import LargeError, Series
from lieid_casadi.errors import LieidWarning, SameRecordingWarning, warning_list
from lieid_casadi.identification.recording_checks import Source
from lieid_casadi.json_numbers import numbers_or_none
from lieid_casadi.messages import joints_text
from lieid_casadi.plot_style import Axes, Figure
from lieid_casadi.tables import Table, figures, html, make_table

AS_NOISE = 1.3  # times the noise floor, up to which an error is explained by noise
BEYOND_NOISE = 2.0  # times the noise floor, from which an error is certainly systematic
NUMBERS = (
    "rms", "rms_raw", "rms_moving", "rms_at_rest", "at_rest", "torque_rms",
    "relative_rms", "relative_rms_moving", "correlation", "bias", "noise_floor",
)  # fmt: skip
HEADINGS = (
    "joint", "in motion", "noise floor", "of torque", "at rest", "all", "raw", "correlation",
    "bias", "unit",
)  # fmt: skip
RESTS = 0.1  # of the time, from which on the error at rest is reported
FALLS, RISES = 3.0, 2.0  # %, from which on a change of a joint's error is stated


@dataclass(frozen=True, eq=False)
class Comparison:
    """Result of :func:`lieid_casadi.compare`; errors are measured − predicted.

    Numbers refer to processed signals, measured and predicted through the fit's filter, unless
    called raw. They are NaN, in JSON None, if there are no samples to compute them from.

    Attributes
    ----------
    joint_names, units : tuple of str
        Of each joint; the torque's unit is N·m, N for prismatic joints.
    rms, rms_moving, rms_at_rest : (n,)
        RMS error of all samples, of joints in motion, and at rest, N·m. Samples near reversals,
        which a fit with a delay of commands leaves out, are not among those in motion.
    rms_raw : (n,)
        RMS error on the uniform grid, resampled but not filtered.
    at_rest : (n,)
        Fraction of the samples at rest.
    torque_rms, relative_rms : (n,)
        RMS of the measured torque, and ``rms / torque_rms``.
    correlation, bias : (n,)
        Of measured and predicted torque, per joint; the mean error.
    noise_floor, noise_source : (n,), str
        RMS error in motion of a model that lacks nothing, and a key of
        `lieid_casadi.comparison.noise_floor.SOURCES`.
    worst : tuple of LargeError
        Largest errors of each joint, largest first.
    series : tuple of Series
        One per segment.
    cutoff, duration : float
        Of the filter, Hz; compared time, s.
    recordings, warnings : tuple of Source, tuple of LieidWarning
    """

    joint_names: tuple[str, ...]
    units: tuple[str, ...]
    rms: Array
    rms_raw: Array
    rms_moving: Array
    rms_at_rest: Array
    at_rest: Array
    torque_rms: Array
    relative_rms: Array
    correlation: Array
    bias: Array
    noise_floor: Array
    noise_source: str
    worst: tuple[LargeError, ...]
    series: tuple[Series, ...]
    cutoff: float
    recordings: tuple[Source, ...]
    duration: float
    warnings: tuple[LieidWarning, ...]

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.rms)

    @property
    def over_noise(self) -> Array:
        """RMS error in motion in multiples of the noise floor (n,), NaN for joints at rest."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(self.rms_moving / self.noise_floor)

    @property
    def relative_rms_moving(self) -> Array:
        """RMS error relative to the RMS of the measured torque, both in motion (n,)."""
        measured = np.concatenate([s.measured for s in self.series])
        moving = np.concatenate([s.moving for s in self.series])
        squares = np.sum(np.where(moving, measured, 0.0) ** 2, axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            torque = np.sqrt(squares / moving.sum(axis=0))
            return np.where(torque > 0.0, self.rms_moving / torque, np.nan)

    @property
    def rest_dominates(self) -> Mask:
        """Joints (n,) that rest for a part of the time, with a larger error than in motion."""
        larger = np.nan_to_num(self.rms_at_rest) > np.nan_to_num(self.rms_moving)
        return np.asarray(larger & (self.at_rest > RESTS))

    def to_dict(self) -> dict[str, Any]:
        """Return what ``lieid compare --json`` writes; one number per joint, None for NaN."""
        return {
            **{name: numbers_or_none(getattr(self, name)) for name in NUMBERS},
            "noise_source": self.noise_source,
            "worst": [error.to_dict() for error in self.worst],
            "warnings": warning_list(self.warnings),
            "cutoff": self.cutoff,
            "duration": self.duration,
            "recordings": [r.to_dict() for r in self.recordings],
        }

    def plot(self, ax: Axes | None = None, *, joint: int | None = None) -> Figure:
        """Plot measured torque, predicted torque and error over time; the figure is not shown.

        Parameters
        ----------
        ax : Axes, optional
            Axes for one joint; without, all joints are drawn in a new figure.
        joint : int, optional
            Number of the joint, from 0; the one with the largest relative error if left out and
            ``ax`` is given.
        """
        if ax is None and joint is None:
            return plots.plot_torques(self.series, self._labels())
        shown = self.worst_joint if joint is None else joint
        return plots.plot_joint(self.series, shown, self._labels()[shown], ax)

    def plot_errors(self) -> Figure:
        """Plot every joint's error over q, q̇, direction, load and time."""
        return plots.plot_errors(self.series, self._labels())

    def _labels(self) -> list[plots.JointLabel]:
        return [
            plots.JointLabel(
                joint_title(self, j), self.units[j], _error_text(self, j), self.noise_floor[j]
            )
            for j in range(self.n)
        ]

    @property
    def worst_joint(self) -> int:
        """Number, from 0, of the joint with the largest relative error in motion, if any moves."""
        moving = self.relative_rms_moving
        relative = moving if np.isfinite(moving).any() else self.relative_rms
        return int(np.argmax(np.nan_to_num(relative, nan=-1.0)))

    def _repr_html_(self) -> str:
        names = ", ".join(source.name or "recording" for source in self.recordings)
        warnings = [f"{type(w).__name__}: {w}" for w in self.warnings]
        return html(f"{names}, {self.duration:.4g} s", error_table(self), *warnings)

    def __repr__(self) -> str:
        pairs = zip(self.rms_moving, self.units, strict=True)
        errors = ", ".join(f"{rms:.3g} {unit}" for rms, unit in pairs)
        return f"<Comparison over {self.duration:.4g} s: RMS error in motion {errors}>"


def error_table(comparison: Comparison) -> Table:
    """Return the errors, one row per joint, with the columns `HEADINGS`."""
    c = comparison
    relative = c.relative_rms_moving
    rows = [
        (
            joint_title(c, j),
            figures(c.rms_moving[j]),
            figures(c.noise_floor[j]),
            percent(relative[j]),
            figures(c.rms_at_rest[j]),
            figures(c.rms[j]),
            figures(c.rms_raw[j]),
            "–" if math.isnan(c.correlation[j]) else f"{c.correlation[j]:.4f}",
            figures(c.bias[j], sign="+"),
            c.units[j],
        )
        for j in range(c.n)
    ]
    source = SOURCES[c.noise_source]
    title = (
        f"Error, measured − predicted (low-pass {c.cutoff:.3g} Hz on both; noise floor: {source})"
    )
    note = (
        f"Error: measured − predicted torque, both filtered by a zero-phase low-pass of "
        f"{c.cutoff:.3g} Hz; raw: resampled only. In motion, at rest: RMS while the joint moves "
        "and while it is at rest, where friction is undetermined. Of torque: RMS relative to the "
        "RMS of the measured torque, both in motion. "
        f"Noise floor: {source}."
    )
    return make_table(title, HEADINGS, rows, note=note)


def largest_errors_table(comparison: Comparison) -> Table:
    """Return the samples with the largest errors, a few for each joint."""
    headings = ("joint", "recording", "time, s", "error", "measured", "q", "q̇", "unit")
    rows = [
        (
            joint_title(comparison, moment.joint),
            moment.recording,
            f"{moment.time:z.2f}",
            figures(moment.error, sign="+"),
            figures(moment.measured, sign="+"),
            f"{moment.q:z.3f}",
            f"{moment.dq:z.3f}" if moment.moving else "at rest",
            comparison.units[moment.joint],
        )
        for moment in comparison.worst
    ]
    return make_table("Largest errors", headings, rows)


def joint_title(comparison: Comparison, joint: int) -> str:
    """Return a joint's number, from 1, and its name unless it is that number."""
    name = comparison.joint_names[joint]
    return f"{joint + 1} {name}" if name and name != str(joint + 1) else f"{joint + 1}"


def percent(value: float) -> str:
    """Return a fraction in percent, an en dash for NaN."""
    if math.isnan(value):
        return "–"
    text = f"{100.0 * value:#.2g}" if value < 0.995 else f"{100.0 * value:.0f}"
    return text.rstrip(".") + " %"


def _error_text(c: Comparison, joint: int) -> str:
    """Return the size of a joint's error, as a plot states it."""
    unit, moving = c.units[joint], c.rms_moving[joint]
    if np.isnan(moving):
        return f"at rest: RMS {figures(c.rms[joint])} {unit}"
    relative = f"{percent(c.relative_rms_moving[joint])} of the torque"
    floor = f"noise floor {figures(c.noise_floor[joint])}"
    return f"in motion: RMS {figures(moving)} {unit}, {relative}; {floor}"


def fall_sentence(
    before: Array,
    after: Array,
    floor: Array,
    *,
    where: str = "unseen motion",
    reference: str = "its noise floor",
) -> str:
    """Return by how much the errors (n,) fall, and which joint stays most above its floor (n,).

    Examples
    --------
    >>> fall_sentence(np.array([1.0, 2.0]), np.array([0.5, 1.2]), np.array([0.5, 0.4]))
    'On unseen motion the error falls by 40 to 50 %; joint 2 stays at 3.0 times its noise floor.'
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        falls, ratio = 100.0 * (1.0 - after / before), np.nan_to_num(after / floor, posinf=0.0)
    if not np.any(np.isfinite(falls)):
        return ""
    lower = np.nan_to_num(falls) > FALLS
    text = f"error falls by {np.nanmax(falls):z.0f} % at most"
    if lower.any():
        size = [f"{value:.0f}" for value in (falls[lower].min(), falls[lower].max())]
        whose = "" if np.all(lower | np.isnan(falls)) else f" of {joints_text(lower)}"
        text = f"error{whose} falls by {' to '.join(dict.fromkeys(size))} %"
    if np.nanmin(falls) < -RISES:
        text += f", that of {joints_text(falls < -RISES)} rises by up to {-np.nanmin(falls):.0f} %"
    worst = int(np.argmax(ratio))
    beyond = f"; joint {worst + 1} stays at {ratio[worst]:.1f} times {reference}"
    if ratio[worst] <= AS_NOISE:
        beyond = f"; no joint exceeds {AS_NOISE} times {reference}" if ratio[worst] > 0.0 else ""
    return f"On {where} the {text}{beyond}."


def verdict(comparison: Comparison) -> str:
    """Return how large the error is, and whether it exceeds the noise of the measurement."""
    return " ".join(verdict_sentences(comparison, "lieid diagnose searches for missing effects"))


def verdict_sentences(comparison: Comparison, remedy: str) -> list[str]:
    """Return the sentences of `verdict`; ``remedy`` is what to do about a systematic error."""
    c = comparison
    names = ", ".join(source.name or "the recording" for source in c.recordings)
    trained = any(isinstance(warning, SameRecordingWarning) for warning in c.warnings)
    training = ", used to fit the model" if trained else ""
    sentences = [f"{names} ({c.duration:.3g} s{training}): {_size(c)}."]
    if np.any(np.isfinite(_over_noise(c))):
        sentences.append(_noise(c, remedy))
    if c.rest_dominates.any():
        at_rest = ", ".join(figures(rms) for rms in c.rms_at_rest[c.rest_dominates])
        sentences.append(
            f"On {joints_text(c.rest_dominates)} the error at rest, where friction is "
            f"undetermined, is larger (RMS {at_rest})."
        )
    return sentences


def _size(c: Comparison) -> str:
    moves = bool(np.isfinite(c.relative_rms_moving).any())
    relative, rms = (c.relative_rms_moving, c.rms_moving) if moves else (c.relative_rms, c.rms)
    relative = relative[np.isfinite(relative)]
    if not relative.size:
        return "the measured torque is zero"
    error = "the error in motion" if moves else "no joint moves; the error at rest"
    worst = c.worst_joint
    where = f"joint {worst + 1} (RMS {figures(rms[worst])} {c.units[worst]})"
    if relative.size == 1 or relative.max() - relative.min() < 5e-4:
        return f"{error} is {percent(relative.max())} of the torque"
    return (
        f"{error} is {percent(relative.min())} to {percent(relative.max())} of the torque, "
        f"largest on {where}"
    )


def _over_noise(c: Comparison) -> Array:
    """Return the error in motion in multiples of the noise floor (n,)."""
    return np.where((c.noise_floor > 0.0) & (c.torque_rms > 0.0), c.over_noise, np.nan)


def _noise(c: Comparison, remedy: str) -> str:
    """Compare the error in motion with the noise floor."""
    ratio = np.nan_to_num(_over_noise(c), nan=0.0)
    floor = "the noise floor"
    beyond, most = ratio > BEYOND_NOISE, int(np.argmax(ratio))
    if not beyond.any():
        noise = ": no systematic error is detectable" if ratio[most] <= AS_NOISE else ""
        return (
            f"The error in motion is at most {figures(ratio[most], digits=2)} times {floor}{noise}."
        )
    where = "every joint" if beyond.all() and c.n > 1 else joints_text(beyond)
    size = f"{figures(ratio[most], digits=2)} times"
    of_floor = f"{size} {floor}"
    if beyond.sum() > 1:
        of_floor = f"more than {BEYOND_NOISE:g} times {floor}, most on joint {most + 1} ({size})"
    return f"On {where} the error in motion is {of_floor}: part of it is systematic; {remedy}."
