"""Recordings as ROS 2 bags, MCAP files and ROS 1 bags of JointState (extra ``[ros]``)."""

from __future__ import annotations

import hashlib
import sqlite3
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lieid_casadi.errors import MissingDependency, RecordingError
from lieid_casadi.recording.arrays import Array
from lieid_casadi.recording.recording import Recording

MESSAGE = "sensor_msgs/msg/JointState"


def load_bag(
    file: Path,
    *,
    n: int | None = None,
    joint_names: Sequence[str] | None = None,
    topic: str | None = None,
) -> Recording:
    """Read position, velocity and effort of one JointState topic.

    Time is that of the messages' headers (of their arrival where headers are unstamped),
    from 0 at the first message. Messages with none of the joints, such as a gripper's, are
    passed over.

    Parameters
    ----------
    file
        A ``.mcap``, ``.bag`` or ``.db3`` file, or the folder of a ROS 2 bag.
    n
        Number of joints that is expected.
    joint_names
        The joints in the robot's order; None takes the first message's order.
    topic
        Needed where the bag has several JointState topics.

    Raises
    ------
    RecordingError
        No bag, no such topic, several topics and none chosen, a joint missing.
    MissingDependency
        rosbags is not installed.
    """
    states = _States(tuple(joint_names) if joint_names is not None else None)
    for arrival, message in _messages(file, topic):
        states.add(file, arrival, message)
    return states.recording(file, n)


@dataclass
class _States:
    """Rows as they come in from the messages."""

    names: tuple[str, ...] | None
    stamps: list[tuple[int, int]] = field(default_factory=list)
    rows: dict[str, list[Array]] = field(
        default_factory=lambda: {"position": [], "velocity": [], "effort": []}
    )

    def add(self, file: Path, arrival: int, message: Any) -> None:
        if self.names is None:
            self.names = tuple(message.name)
        place = {name: index for index, name in enumerate(message.name)}
        missing = [name for name in self.names if name not in place]
        if len(missing) == len(self.names):
            return
        if missing:
            raise RecordingError(
                f"{file}: message {len(self.stamps) + 1} has no joint {missing[0]!r} "
                f"(found {', '.join(message.name)}), expected {', '.join(self.names)}"
            )
        order = [place[name] for name in self.names]
        for signal, rows in self.rows.items():
            values = np.asarray(getattr(message, signal), dtype=np.float64)
            if values.size == len(message.name):
                rows.append(values[order])
        stamp = message.header.stamp
        header = int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
        self.stamps.append((header, arrival))

    def recording(self, file: Path, n: int | None) -> Recording:
        if not self.stamps or self.names is None:
            wanted = f" with the joints {', '.join(self.names)}" if self.names else ""
            raise RecordingError(f"{file}: no JointState message{wanted}, expected some")
        if n is not None and n != len(self.names):
            raise RecordingError(
                f"{file}: found {len(self.names)} joints ({', '.join(self.names)}), "
                f"expected {n}: choose them by their names"
            )
        stamped = all(header for header, _ in self.stamps)
        nanoseconds = np.array([h if stamped else arrival for h, arrival in self.stamps])
        signals: dict[str, Array | None] = {}
        for signal, target in (("position", "q"), ("velocity", "dq"), ("effort", "tau")):
            rows = self.rows[signal]
            if rows and len(rows) != len(self.stamps):
                raise RecordingError(
                    f"{file}: {len(self.stamps) - len(rows)} of {len(self.stamps)} messages "
                    f"lack {signal}, expected it in all or none"
                )
            signals[target] = np.array(rows) if rows else None
        position = signals.pop("q")
        if position is None:
            raise RecordingError(f"{file}: no positions in the JointState messages")
        return Recording(
            t=(nanoseconds - nanoseconds[0]) * 1e-9,
            q=position,
            dq=signals["dq"],
            tau=signals["tau"],
            name=file.name,
            source_hash=_hash(file),
        )


def _messages(file: Path, topic: str | None) -> Iterator[tuple[int, Any]]:
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.rosbag2 import ReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise MissingDependency(
            f"{file}: bags and MCAP need rosbags: pip install 'lieid-casadi[ros]'"
        ) from error
    old = file.suffix.lower() == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if old else Stores.LATEST)
    damage: tuple[type[Exception], ...] = (AnyReaderError, ReaderError, ValueError, OSError)
    damage += _database_errors()
    try:
        with AnyReader([file], default_typestore=store) as reader:
            chosen = _choose(file, reader, topic)
            connections = [c for c in reader.connections if c.topic == chosen]
            for connection, arrival, raw in reader.messages(connections=connections):
                yield arrival, reader.deserialize(raw, connection.msgtype)
    except RecordingError:
        raise
    except damage as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise RecordingError(f"{file}: not a bag that can be read ({reason})") from error


def _database_errors() -> tuple[type[Exception], ...]:
    """What a damaged ``.db3`` raises, whichever SQLite binding rosbags came with."""
    try:
        import apsw
    except ImportError:
        return (sqlite3.Error,)
    return (sqlite3.Error, apsw.Error)


def _choose(file: Path, reader: Any, topic: str | None) -> str:
    topics = sorted({c.topic for c in reader.connections if c.msgtype == MESSAGE})
    if topic is not None:
        if topic not in topics:
            found = ", ".join(topics) or "none"
            raise RecordingError(f"{file}: JointState topics: {found}; expected {topic} among them")
        return topic
    if not topics:
        found = ", ".join(sorted({c.msgtype for c in reader.connections})) or "no messages"
        raise RecordingError(f"{file}: found {found}, expected {MESSAGE}")
    if len(topics) > 1:
        raise RecordingError(
            f"{file}: found several JointState topics ({', '.join(topics)}), expected one: "
            "choose it by topic="
        )
    return str(topics[0])


def _hash(file: Path) -> str:
    """sha256 of the file, or of a folder's files in the order of their names."""
    digest = hashlib.sha256()
    for part in sorted(p for p in file.rglob("*") if p.is_file()) if file.is_dir() else [file]:
        digest.update(part.read_bytes())
    return digest.hexdigest()
