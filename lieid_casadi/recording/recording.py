"""Recording: what was measured on an arm, and nothing derived from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.errors import LieidWarning, RecordingError
from lieid_casadi.recording.arrays import Array, hash_of_arrays, read_only
from lieid_casadi.recording.checks.faults import require_sound
from lieid_casadi.recording.processing.sample_timing import gap_limit, sample_period
from lieid_casadi.recording.readers.formats import reader_of, split_part, writer_of

_SIGNALS = ("dq", "tau", "ddq", "temperature", "current")


@dataclass(frozen=True, eq=False)
class Recording:
    """Signals of an arm with n joints at N instants, SI units; arrays are read-only.

    Attributes
    ----------
    t
        (N,) time, s, strictly increasing; stamps may be irregular.
    q, dq, ddq
        (N, n) position, velocity, acceleration, rad or m. None where not measured:
        derived in :func:`lieid_casadi.recording.process`, never on loading.
    tau
        (N, n) joint torque, N·m or N.
    temperature
        (N, n) °C.
    current
        (N, n) motor current, A.
    payload_label
        Label of the payload for each row (column ``load``).
    name
        Where it comes from, for messages and tables.
    source_hash
        sha256 of the file's bytes, or of the arrays.
    warnings
        What was suspicious on loading.
    """

    t: Array
    q: Array
    dq: Array | None = None
    tau: Array | None = None
    ddq: Array | None = None
    temperature: Array | None = None
    current: Array | None = None
    payload_label: tuple[str, ...] | None = None
    name: str = ""
    source_hash: str = ""
    warnings: tuple[LieidWarning, ...] = ()

    def __post_init__(self) -> None:
        title = self.name or "recording"
        t = read_only(self.t)
        if t.ndim != 1:
            raise RecordingError(f"{title}: t has shape {t.shape}, expected (N,)")
        object.__setattr__(self, "t", t)
        q = read_only(self.q)
        if q.ndim != 2 or q.shape[0] != t.size or q.shape[1] == 0:
            raise RecordingError(f"{title}: q has shape {q.shape}, expected ({t.size}, n)")
        object.__setattr__(self, "q", q)
        for field in _SIGNALS:
            values = getattr(self, field)
            if values is None:
                continue
            array = read_only(values)
            if array.shape != q.shape:
                raise RecordingError(
                    f"{title}: {field} has shape {array.shape}, expected {q.shape} as q"
                )
            object.__setattr__(self, field, array)
        if self.payload_label is not None:
            labels = tuple(str(label) for label in self.payload_label)
            if len(labels) != t.size:
                raise RecordingError(f"{title}: {len(labels)} load labels for {t.size} rows")
            object.__setattr__(self, "payload_label", labels)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    @property
    def duration(self) -> float:
        """Time from the first row to the last, s."""
        return float(self.t[-1] - self.t[0]) if self.t.size else 0.0

    @property
    def rate(self) -> float:
        """Samples per second: one over the median time between rows, Hz."""
        return 1.0 / sample_period(self.t)

    def __len__(self) -> int:
        return int(self.t.size)

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
        load: Sequence[str] | None = None,
        name: str = "",
        torque_constants: ArrayLike | None = None,
    ) -> Self:
        """Recording from arrays: t (N,), the others (N, n), load one label per row.

        With ``torque_constants`` (n,), N·m/A, currents become torques where there is no
        ``tau``.

        Raises
        ------
        RecordingError
            Shapes that do not fit, fewer than two rows, NaN or Inf, time that does not
            increase.
        """
        signals = {
            "q": q, "dq": dq, "tau": tau, "ddq": ddq,
            "temperature": temperature, "current": current,
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
        return made._with_constants_where_needed(torque_constants)

    @classmethod
    def from_dataframe(
        cls, frame: Any, *, name: str = "", torque_constants: ArrayLike | None = None
    ) -> Self:
        """Recording from a pandas (or polars) data frame with the columns of a CSV."""
        from lieid_casadi.recording.readers.tables import recording_from_columns

        title = name or "data frame"
        columns = {str(column): np.asarray(frame[column]) for column in frame.columns}
        made = recording_from_columns(columns, title)
        arrays = [made.t, made.q, *(getattr(made, f) for f in _SIGNALS), made.payload_label]
        made = replace(made, name=name, source_hash=hash_of_arrays(arrays))
        require_sound(made)
        return cls._adopt(made)._with_constants_where_needed(torque_constants)

    @classmethod
    def load(
        cls,
        path: str | Path,
        *,
        torque_constants: ArrayLike | None = None,
        n: int | None = None,
        joint_names: Sequence[str] | None = None,
        topic: str | None = None,
    ) -> Self:
        """Read ``.csv``, ``.csv.gz``, ``.npz``, ``.parquet``, ``.mcap``, ``.bag`` or a ROS 2 bag.

        Parameters
        ----------
        path
            File or bag folder; ``FILE@T0:T1`` is the part with T0 ≤ t < T1 seconds on the
            recording's own clock, either end may be left out.
        torque_constants
            (n,) N·m/A: columns ``i*`` become torques where there are no ``tau*``.
        n
            Number of joints that is expected.
        joint_names, topic
            For bags: the joints in the robot's order, and which topic.

        Raises
        ------
        RecordingError
            In one line: file, line and column, what was found and what was expected.
        MissingDependency
            The format needs an extra that is not installed.
        """
        file, start, end = split_part(path)
        read = reader_of(file)
        if not file.exists():
            raise RecordingError(f"{file}: no such file, expected a recording")
        try:
            made = read(file, n=n, joint_names=joint_names, topic=topic)
        except OSError as error:
            raise RecordingError(f"{file}: cannot be read ({error.strerror or error})") from error
        require_sound(made)
        recording = cls._adopt(made)._with_constants_where_needed(torque_constants)
        return recording if start is None and end is None else recording.cut(start, end)

    @classmethod
    def join(cls, recordings: Sequence[Recording]) -> Self:
        """One recording of several with the same joints; each keeps its own segments.

        The clock of a recording is kept where it comes from the same source and follows
        its predecessor; otherwise it is shifted so that a gap separates the two.
        Signals that one of them lacks are left out.

        Raises
        ------
        RecordingError
            No recording, or different numbers of joints.
        """
        if not recordings:
            raise RecordingError("join: no recordings, expected at least one")
        first = recordings[0]
        for other in recordings[1:]:
            if other.n != first.n:
                raise RecordingError(
                    f"join: {other.name or 'a recording'} has {other.n} joints, "
                    f"expected {first.n} as {first.name or 'the first'}"
                )
        times = [first.t]
        pause = 2.0 * max(gap_limit(r.t) for r in recordings)
        for previous, following in pairwise(recordings):
            continues = previous.source_hash == following.source_hash
            earliest = times[-1][-1] + (0.0 if continues else pause)
            follows = following.t[0] > earliest
            times.append(following.t if follows else following.t - following.t[0]
                         + times[-1][-1] + pause)  # fmt: skip
        signals = {
            field: np.concatenate([getattr(r, field) for r in recordings])
            for field in ("q", *_SIGNALS)
            if all(getattr(r, field) is not None for r in recordings)
        }
        labels: list[str] | None = None
        if any(r.payload_label is not None for r in recordings):
            labels = [label for r in recordings for label in r.payload_label or [""] * len(r)]
        return cls(
            t=np.concatenate(times),
            payload_label=None if labels is None else tuple(labels),
            name="+".join(r.name for r in recordings if r.name),
            source_hash=hash_of_arrays([tuple(r.source_hash for r in recordings)]),
            warnings=tuple(w for r in recordings for w in r.warnings),
            **signals,
        )

    def cut(self, start: float | None = None, end: float | None = None) -> Self:
        """Part with start ≤ t < end, s, on the recording's own clock.

        Raises
        ------
        RecordingError
            Fewer than two rows are left.
        """
        low = -np.inf if start is None else float(start)
        high = np.inf if end is None else float(end)
        first, last = np.searchsorted(self.t, [low, high], side="left")
        part = f"@{'' if start is None else format(start, 'g')}:" + (
            "" if end is None else format(end, "g")
        )
        if last - first < 2:
            raise RecordingError(
                f"{self.name or 'recording'}{part}: {max(last - first, 0)} rows in that part, "
                f"expected some of {self.t[0]:g} to {self.t[-1]:g} s"
            )
        return replace(self.rows(int(first), int(last)), name=self.name + part)

    def segments(self) -> list[Self]:
        """Stretches without a gap and with one payload label; nothing joins them.

        A gap is a step in time above five median steps and 0.05 s.
        """
        breaks = np.diff(self.t) > gap_limit(self.t)
        if self.payload_label is not None:
            labels = np.asarray(self.payload_label)
            breaks |= labels[1:] != labels[:-1]
        edges = [0, *(np.nonzero(breaks)[0] + 1).tolist(), len(self)]
        return [self.rows(a, b) for a, b in pairwise(edges)]

    def with_torque_constants(self, constants: ArrayLike) -> Self:
        """The same recording with tau = constants · current; constants (n,), N·m/A.

        Raises
        ------
        RecordingError
            No currents, or not one finite constant per joint.
        """
        k = np.atleast_1d(np.asarray(constants, dtype=np.float64))
        title = self.name or "recording"
        if self.current is None:
            raise RecordingError(f"{title}: no motor currents (columns i1…i{self.n})")
        if k.shape != (self.n,):
            raise RecordingError(
                f"{title}: {k.size} torque constants, expected {self.n}, one per joint"
            )
        if not np.all(np.isfinite(k)) or np.any(k == 0.0):
            joint = int(np.nonzero(~np.isfinite(k) | (k == 0.0))[0][0])
            raise RecordingError(
                f"{title}: torque constant of joint {joint + 1} is {k[joint]:g}, "
                "expected N·m/A other than 0"
            )
        return replace(self, tau=self.current * k)

    def save(self, path: str | Path) -> None:
        """Write ``.csv``, ``.csv.gz``, ``.npz`` or ``.parquet``, atomically, values exact.

        Raises
        ------
        RecordingError
            Another suffix.
        OutputError
            The file cannot be written.
        """
        file = Path(path)
        write = writer_of(file)
        write(self, file)

    def rows(self, first: int, last: int) -> Self:
        """Rows first … last − 1 (from 0)."""
        rows = slice(first, last)
        fields = ("t", "q", *_SIGNALS, "payload_label")
        signals: dict[str, Any] = {field: getattr(self, field) for field in fields}
        for field, values in signals.items():
            signals[field] = None if values is None else values[rows]
        return replace(self, **signals)

    def _with_constants_where_needed(self, constants: ArrayLike | None) -> Self:
        if constants is None or self.tau is not None:
            return self
        return self.with_torque_constants(constants)

    @classmethod
    def _adopt(cls, made: Recording) -> Self:
        if isinstance(made, cls):
            return made
        return cls(**{field: getattr(made, field) for field in cls.__dataclass_fields__})


def join(recordings: Sequence[Recording]) -> Recording:
    """:meth:`Recording.join` as a function."""
    return Recording.join(recordings)
