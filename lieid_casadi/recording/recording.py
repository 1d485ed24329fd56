"""Recording: a valid measurement on an arm, with its segments, parts and files."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Mask
from lieid_casadi.errors import RecordingError
from lieid_casadi.recording import conversion
from lieid_casadi.recording.measurement import (
    OPTIONAL_SIGNALS,
    Measurement,
    fault_error,
    hash_of_arrays,
    read_only,
    require_sound,
)
from lieid_casadi.recording.readers import registry
from lieid_casadi.recording.readers.columns import (
    ColumnNames,
    is_name,
    measurement_of_columns,
    parse_columns,
    reassigned,
)
from lieid_casadi.recording.repairs import repaired, without_damaged_rows
from lieid_casadi.recording.sample_timing import sample_rate, segment_edges
from lieid_casadi.robot.drive import Drive


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Measurement):
    """A valid measurement on an arm: loaded from a file or made from arrays, SI units.

    The fields are those of `Measurement`: ``t`` (N,), ``q`` (N, n), and optionally ``dq``,
    ``tau``, ``ddq``, ``temperature``, ``current``, ``command`` (N, n) and ``payload_label``.
    """

    @property
    def duration(self) -> float:
        """Time from the first row to the last, s."""
        return float(self.t[-1] - self.t[0]) if self.t.size else 0.0

    @cached_property
    def rate(self) -> float:
        """Samples per second, Hz: one over the median time between rows (see `sample_rate`)."""
        return sample_rate(self.t)

    @classmethod
    def from_arrays(
        cls,
        t: ArrayLike,
        q: ArrayLike,
        dq: ArrayLike | None = None,
        tau: ArrayLike | None = None,
        *,
        ddq: ArrayLike | None = None,
        temperature: ArrayLike | None = None,
        current: ArrayLike | None = None,
        command: ArrayLike | None = None,
        load: Sequence[str] | None = None,
        name: str = "",
        torque_constants: ArrayLike | None = None,
        drives: Sequence[Drive] | None = None,
    ) -> Self:
        """Return a recording from arrays.

        Parameters
        ----------
        t
            (N,) time, s, strictly increasing.
        q, dq, ddq
            (N, n) position, velocity, acceleration, rad or m.
        tau
            (N, n) torque, N·m or N.
        temperature, current
            (N, n) °C, A.
        command
            (N, n) commanded position, rad or m.
        load
            (N,) label of the payload.
        name
            For messages.
        torque_constants
            (n,) N·m/A: currents become torques where there is no ``tau``.
        drives
            (n) control laws, such as ``robot.drives``: commands become torques without ``tau``.

        Raises
        ------
        RecordingError
            Shapes that do not fit, fewer than two rows, NaN or Inf, time that does not
            increase.
        """
        signals = {
            "q": q, "dq": dq, "tau": tau, "ddq": ddq,
            "temperature": temperature, "current": current, "command": command,
        }  # fmt: skip
        arrays = {key: None if x is None else read_only(x) for key, x in signals.items()}
        labels = None if load is None else tuple(str(label) for label in load)
        times = read_only(t)
        made = cls(
            t=times,
            payload_label=labels,
            name=name,
            source_hash=hash_of_arrays([times, *arrays.values(), labels]),
            **arrays,  # type: ignore[arg-type]
        )
        require_sound(made)
        return made.with_torque(torque_constants, drives)

    @classmethod
    def from_dataframe(
        cls,
        frame: Any,
        *,
        name: str = "",
        torque_constants: ArrayLike | None = None,
        drives: Sequence[Drive] | None = None,
        units: str | Sequence[str] = (),
        columns: ColumnNames | None = None,
    ) -> Self:
        """Return a recording from a pandas or polars data frame with the columns of a CSV.

        Parameters
        ----------
        frame
            Columns ``t``, ``q1``…``qn`` and optionally ``dq*``, ``tau*``, ``ddq*``, ``temp*``,
            ``i*``, ``qcmd*``, ``load``; N rows.
        name
            For messages.
        torque_constants, drives, units, columns
            As for :meth:`load`.

        Raises
        ------
        RecordingError
            A missing column, or values that no recording may contain.
        """
        given = {str(column): np.asarray(frame[column]) for column in frame.columns}
        made = measurement_of_columns(given, name or "data frame", stated=parse_columns(columns))
        made = conversion.convert_units(made, units)
        arrays = [made.t, made.q, *(getattr(made, f) for f in OPTIONAL_SIGNALS)]
        made = replace(made, name=name, source_hash=hash_of_arrays([*arrays, made.payload_label]))
        return cls.of_measurement(made).with_torque(torque_constants, drives)

    @classmethod
    def load(
        cls,
        path: str | Path,
        *,
        torque_constants: ArrayLike | None = None,
        drives: Sequence[Drive] | None = None,
        n: int | None = None,
        joint_names: Sequence[str] | None = None,
        topic: str | None = None,
        columns: ColumnNames | None = None,
        episodes: tuple[int, int | None] = (0, None),
        calibration: str | None = None,
        position_limits: ArrayLike | None = None,
        units: str | Sequence[str] = (),
        revolute: Mask | None = None,
    ) -> Self:
        """Read CSV, NPZ, Parquet, MCAP, a ROS bag or a LeRobot dataset.

        Parameters
        ----------
        path
            File or bag folder; ``FILE@T0:T1`` is the part with T0 ≤ t < T1 seconds on the
            recording's own clock, either end may be left out.
        torque_constants
            (n,) N·m/A: columns ``i*`` become torques where there are no ``tau*``.
        drives
            (n) control laws, such as ``robot.drives``: columns ``qcmd*`` become torques where
            there are no ``tau*``.
        n
            Number of joints that is expected.
        joint_names, topic
            For bags: the joints in the robot's order, and the topic to read. Datasets have
            names, too.
        columns
            Columns of other names than those of the file format: ``"t=stamp,q1=elbow"`` or a
            mapping ``{"q1": "elbow"}``; ``"q=pos_*"`` stands for all joints in the order of
            their numbers. Of any file: signals taken for others, as ``"tau2=tau3"``; if they are
            stated for each of ``n`` joints (``"q1=q7,…"``), further joints are left out.
        episodes
            For LeRobot datasets: first episode and end (excluded; None: all).
        calibration, position_limits
            For LeRobot datasets in normalised units: LeRobot's calibration file, or ``"limits"``
            to map the normalised range onto the limits (n, 2), rad.
        units
            Units of the file that are not SI: ``"deg"`` (q, dq, ddq), and ``"ms"``, ``"us"``
            or ``"ns"`` (t); several separated by commas or as a sequence.
        revolute
            (n,) True for joints that turn, to which ``"deg"`` applies; None: all of them.

        Raises
        ------
        RecordingError
            In one line: file, line and column, what was found and what was expected.
        MissingDependency
            The format needs an extra that is not installed.
        """
        file, start, end = split_part(path)
        stated = parse_columns(columns)
        moved = [pair for pair in stated if is_name(pair[1])]
        # of a file with more joints: those of one arm, each of which is stated
        own = n if n and {f"q{j + 1}" for j in range(n)} <= {name for name, _ in moved} else None
        options = registry.ReadOptions(
            n=n if own is None else None,
            joint_names=None if joint_names is None else tuple(joint_names),
            topic=topic,
            columns=tuple(pair for pair in stated if not is_name(pair[1])),
            episodes=episodes,
            calibration=calibration,
            position_limits=None if position_limits is None else read_only(position_limits),
            degrees=conversion.unit_factors(units)[1] != 1.0,
            part=_part_ends(start, end, conversion.unit_factors(units)[0]),
        )
        made = conversion.convert_units(registry.read_measurement(file, options), units, revolute)
        made = reassigned(made, moved, own)
        made = replace(made, columns=tuple("=".join(pair) for pair in stated))
        recording = cls.of_measurement(made, revolute).with_torque(torque_constants, drives)
        return recording if start is None and end is None else recording.cut(start, end)

    @classmethod
    def of_measurement(cls, measurement: Measurement, revolute: Mask | None = None) -> Self:
        """Return a measurement as a recording, with small damage repaired and reported.

        ``revolute`` (n,) marks the joints that turn; None: all of them.

        Raises
        ------
        RecordingError
            Fewer than two rows, many rows with NaN or Inf, time that does not increase.
        """
        made, fault = without_damaged_rows(measurement)
        if fault is not None:
            raise fault_error(measurement, fault)
        made = repaired(made, revolute)
        return cls(**{field: getattr(made, field) for field in cls.__dataclass_fields__})

    def cut(self, start: float | None = None, end: float | None = None) -> Self:
        """Return the part with start ≤ t < end, s, on the recording's own clock.

        Raises
        ------
        RecordingError
            Fewer than two rows are left.
        """
        first, last = np.searchsorted(self.t, _part_ends(start, end)).tolist()
        part = "@" + ":".join("" if limit is None else f"{limit:g}" for limit in (start, end))
        if last - first < 2:
            raise RecordingError(
                f"{self.title}{part}: {max(last - first, 0)} rows in that part, "
                f"expected some of {self.t[0]:g} to {self.t[-1]:g} s"
            )
        return replace(self.rows(first, last), name=self.name + part)

    def segments(self) -> list[Self]:
        """Return the stretches without a gap and with one payload label.

        A gap is a step in time above five median steps and 0.05 s.
        """
        edges = pairwise(segment_edges(self.t, self.payload_label))
        return [self.rows(first, last) for first, last in edges]

    def with_torque_constants(self, constants: ArrayLike) -> Self:
        """Return the recording with tau = constants · current; constants (n,), N·m/A.

        Raises
        ------
        RecordingError
            No currents, or not one finite constant per joint.
        """
        tau = conversion.torque_of_currents(self, constants)
        used = tuple(float(k) for k in np.atleast_1d(np.asarray(constants)))
        return replace(self, tau=tau, torque_constants=used)

    def with_drives(self, drives: Sequence[Drive]) -> Self:
        """Return the recording with the torque that the control laws (n) of its drives state.

        Raises
        ------
        RecordingError
            No commanded positions, or not one law per joint.
        """
        return replace(self, tau=conversion.torque_of_commands(self, drives), drives=tuple(drives))

    def save(self, path: str | Path) -> None:
        """Write ``.csv``, ``.csv.gz``, ``.npz`` or ``.parquet``, atomically, values exact.

        Raises
        ------
        RecordingError
            Another suffix.
        OutputError
            The file cannot be written.
        """
        registry.write_measurement(self, Path(path))

    def with_torque(self, constants: ArrayLike | None, drives: Sequence[Drive] | None) -> Self:
        """Return the recording, with torque from commands or currents where it has none."""
        if self.tau is not None:
            return self
        if self.command is not None and drives is not None:
            return self.with_drives(drives)
        return self if constants is None else self.with_torque_constants(constants)


def listed(recordings: Recording | Iterable[Recording]) -> list[Recording]:
    """Return one recording or several as a list."""
    if isinstance(recordings, Iterable) and not isinstance(recordings, str):
        result = list(recordings)
    else:
        result = [recordings]
    for given in result:
        if isinstance(given, str | PathLike):
            path = str(given)
            raise RecordingError(f"got the path {path!r}; expected Recording.load({path!r})")
        if not isinstance(given, Recording):
            raise RecordingError(f"got a {type(given).__name__}; expected a Recording")
    return result


_PART = re.compile(r"(?P<path>.+)@(?P<start>[^:@/]*):(?P<end>[^:@/]*)")


def split_part(path: str | Path) -> tuple[Path, float | None, float | None]:
    """Return file and ends, s, of ``FILE@T0:T1``; open ends are None."""
    match = _PART.fullmatch(str(path))
    if match is None or Path(path).exists():
        return Path(path), None, None
    first, last = (_end(path, match[name]) for name in ("start", "end"))
    if first is not None and last is not None and not first < last:
        raise RecordingError(f"{path}: found {first:g} to {last:g} s, expected T0 < T1")
    return Path(match["path"]), first, last


def _part_ends(start: float | None, end: float | None, second: float = 1.0) -> tuple[float, float]:
    """Return the ends of a part; ``second`` is the unit of time in seconds."""
    return -np.inf if start is None else start / second, np.inf if end is None else end / second


def _end(path: str | Path, text: str) -> float | None:
    if not text.strip():
        return None
    try:
        end = float(text)
    except ValueError:
        end = np.nan
    if not np.isfinite(end):
        raise RecordingError(
            f"{path}: found {text!r} after @, expected FILE@T0:T1 with T0, T1 in seconds"
        )
    return end
