"""Small LeRobot datasets of the SO-101."""

import json

import numpy as np
import pyarrow
import pyarrow.parquet

import lieid_casadi as lieid

SO101 = lieid.robots.so101()
JOINTS = [joint.name for joint in SO101.joints]
LENGTHS = (40, 30, 50)


def frames(length, start=0.0):
    """Return normalised positions and commands (length, 6)."""
    t = start + np.arange(length) / 30.0
    state = np.column_stack([40.0 * np.sin(t * (1 + k)) + 10.0 * k for k in range(6)])
    state[:, 5] = 50.0 + 20.0 * np.sin(t)
    return state.astype(np.float32), (state + 2.0).astype(np.float32)


def write(folder, version="v3.0", names=None, positions=frames):
    """Write a dataset of three episodes."""
    names = names or [f"{joint}.pos" for joint in JOINTS]
    (folder / "meta").mkdir(parents=True)
    feature = {"dtype": "float32", "shape": [len(names)], "names": names}
    info = {
        "codebase_version": version, "fps": 30, "robot_type": "so101_follower",
        "features": {"observation.state": feature, "action": feature},
    }  # fmt: skip
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    tables = []
    for episode, length in enumerate(LENGTHS):
        state, action = positions(length, float(episode))
        tables.append(
            pyarrow.table(
                {
                    "observation.state": list(state),
                    "action": list(action),
                    "timestamp": (np.arange(length) / 30.0).astype(np.float32),
                    "frame_index": np.arange(length),
                    "episode_index": np.full(length, episode),
                }
            )
        )
    data = folder / "data" / "chunk-000"
    data.mkdir(parents=True)
    if version == "v3.0":
        pyarrow.parquet.write_table(pyarrow.concat_tables(tables), data / "file-000.parquet")
    else:
        for episode, table in enumerate(tables):
            pyarrow.parquet.write_table(table, data / f"episode_{episode:06d}.parquet")
    return folder
