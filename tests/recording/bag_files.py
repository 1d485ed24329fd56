"""ROS bags of a JointState topic, written by rosbags."""

from pathlib import Path

import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
NAMES = ["shoulder", "elbow"]
START = 1_700_000_000_000_000_000
MESSAGE = "sensor_msgs/msg/JointState"


def joint_state(store, time, names, q, dq, tau, stamped):
    """A JointState message of a type store."""
    sec, nanosec = divmod(time if stamped else 0, 1_000_000_000)
    empty = np.zeros(0)
    return store.types[MESSAGE](
        header=store.types["std_msgs/msg/Header"](
            stamp=store.types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec),
            frame_id="",
        ),
        name=list(names),
        position=np.asarray(q, dtype=float),
        velocity=empty if dq is None else np.asarray(dq, dtype=float),
        effort=empty if tau is None else np.asarray(tau, dtype=float),
    )


def write(path: Path, messages, plugin=StoragePlugin.SQLITE3, compression=None):
    """Bag folder with messages (topic, nanoseconds, names, q, dq, tau, stamped)."""
    writer = Writer(path, version=9, storage_plugin=plugin)
    if compression is not None:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connections = {
            topic: writer.add_connection(topic, MESSAGE, typestore=STORE)
            for topic in sorted({m[0] for m in messages})
        }
        for topic, time, *rest in messages:
            raw = STORE.serialize_cdr(joint_state(STORE, time, *rest), MESSAGE)
            writer.write(connections[topic], time, raw)
    return path


def write_unchunked_mcap(path: Path, messages):
    """MCAP file without chunks, by the mcap library."""
    with path.open("wb") as file:
        writer = McapWriter(file, compression=CompressionType.NONE, use_chunking=False)
        writer.start("ros2")
        definition, _ = STORE.generate_msgdef(MESSAGE, ros_version=2)
        schema = writer.register_schema(MESSAGE, "ros2msg", definition.encode())
        channel = writer.register_channel(messages[0][0], "cdr", schema)
        for _, time, *rest in messages:
            raw = bytes(STORE.serialize_cdr(joint_state(STORE, time, *rest), MESSAGE))
            writer.add_message(channel, time, raw, time)
        writer.finish()
    return path


def arm_messages(recording, *, names=NAMES, topic="/joint_states", stamped=True):
    """Messages of a recording of two joints, in the order of `names`."""
    order = [NAMES.index(name) for name in names]
    return [
        (topic, START + round(t * 1e9), names, q[order], dq[order], tau[order], stamped)
        for t, q, dq, tau in zip(recording.t, recording.q, recording.dq, recording.tau, strict=True)
    ]


__all__ = [
    "NAMES",
    "START",
    "CompressionMode",
    "StoragePlugin",
    "arm_messages",
    "write",
    "write_unchunked_mcap",
]
