"""Recordings as ROS 2 bags and MCAP files of JointState (extra ``[ros]``)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import RecordingError, of_extra
from lieid_casadi.messages import names_text, shortened
from lieid_casadi.recording.measurement import Measurement
from lieid_casadi.recording.readers import registry

MESSAGE = "sensor_msgs/msg/JointState"
EXPECTED = "a bag that can be read"
SIGNALS = {"position": "q", "velocity": "dq", "effort": "tau"}


class _JointState(NamedTuple):
    """A message: times in ns, names, and (m,) values by signal."""

    header_time: int
    arrival_time: int
    names: tuple[str, ...]
    values: dict[str, Array]


def read_bag(file: Path, options: registry.ReadOptions) -> Measurement:
    """Read one JointState topic at the headers' times; messages of other joints are ignored."""
    wanted, others = options.joint_names, tuple[str, ...]()
    messages, orders = list[_JointState](), list[list[int]]()
    for message in _messages(file, options):
        wanted = wanted or message.names
        missing = [name for name in wanted if name not in message.names]
        if len(missing) == len(wanted):
            others = message.names
        elif missing:
            raise RecordingError(
                f"{file}: message {len(messages) + 1} has no joint {shortened(missing[0])} "
                f"(found {names_text(message.names)}), expected {names_text(wanted)}"
            )
        else:
            messages.append(message)
            orders.append([message.names.index(name) for name in wanted])
    if not messages or not wanted:
        joints = f" with the joints {names_text(wanted)}" if wanted else ""
        found = f" (found {names_text(others)})" if others else ""
        raise RecordingError(f"{file}: no JointState message{joints}{found}, expected some")
    if options.n is not None and options.n != len(wanted):
        raise RecordingError(
            f"{file}: found {len(wanted)} joints ({names_text(wanted)}), "
            f"expected {options.n}: choose them by their names"
        )
    signals: dict[str, Any] = {}
    for name, field in SIGNALS.items():
        rows = [
            message.values[name][order]
            for message, order in zip(messages, orders, strict=True)
            if message.values[name].size == len(message.names)
        ]
        if rows and len(rows) != len(messages):
            raise RecordingError(
                f"{file}: {len(messages) - len(rows)} of {len(messages)} messages "
                f"lack {name}, expected it in all or none"
            )
        if rows:
            signals[field] = np.array(rows)
    if "q" not in signals:
        raise RecordingError(f"{file}: no positions in the JointState messages")
    stamped = all(message.header_time for message in messages)
    times = [m.header_time if stamped else m.arrival_time for m in messages]
    t = np.array([(time - times[0]) * 1e-9 for time in times])
    return Measurement(t=t, name=file.name, source_hash=registry.hash_of_file(file), **signals)


FORMAT = registry.RecordingFormat(
    suffixes=(".mcap", ".db3"), read=read_bag, folder=lambda f: (f / "metadata.yaml").is_file()
)


def _messages(file: Path, options: registry.ReadOptions) -> Iterator[_JointState]:
    """Yield the messages of the topic."""
    with of_extra("ros", f"{file}: bags and MCAP need rosbags"):
        from rosbags.highlevel import AnyReader
    with (
        registry.library_errors(file, EXPECTED),
        AnyReader([file], default_typestore=_type_store()) as reader,
    ):
        chosen = _topic(file, reader, options.topic)
        connections = [
            c for c in reader.connections if str(c.topic) == chosen and c.msgtype == MESSAGE
        ]
        for connection, arrival, raw in reader.messages(connections=connections):
            yield _joint_state(arrival, reader.deserialize(raw, connection.msgtype))


@cache
def _type_store() -> Any:
    """Return the message types for bags that do not define their own."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.LATEST)


def _joint_state(arrival: int, message: Any) -> _JointState:
    """Return the fields of a message; the definition in the bag may lack any of them."""
    stamp = message.header.stamp
    names = tuple(str(name) for name in message.name)
    values = {name: np.asarray(getattr(message, name), dtype=np.float64) for name in SIGNALS}
    return _JointState(
        int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec), int(arrival), names, values
    )


def _topic(file: Path, reader: Any, topic: str | None) -> str:
    """Return the topic to read."""
    topics = sorted({str(c.topic) for c in reader.connections if c.msgtype == MESSAGE})
    if topic is not None:
        if topic not in topics:
            found = names_text(topics) or "none"
            raise RecordingError(f"{file}: JointState topics: {found}; expected {topic} among them")
        return topic
    if not topics:
        types = sorted({str(c.msgtype) for c in reader.connections})
        raise RecordingError(
            f"{file}: found {names_text(types) or 'no messages'}, expected {MESSAGE}"
        )
    if len(topics) > 1:
        raise RecordingError(
            f"{file}: found several JointState topics ({names_text(topics)}), expected one: "
            "choose it by topic="
        )
    return topics[0]
