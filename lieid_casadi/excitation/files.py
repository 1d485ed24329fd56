"""Files of a design: trajectory as CSV and as a ROS 2 message, JSON, plot, text."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lieid_casadi.excitation.basis.trajectory import MotionSamples
from lieid_casadi.output_folder import write_folder

if TYPE_CHECKING:
    from lieid_casadi.excitation.excitation import Excitation

ROS_RATE = 100.0  # Hz; joint trajectory controllers interpolate with quintics between points


def save(excitation: Excitation, folder: Path, *, force: bool) -> tuple[Path, ...]:
    """Write all files of a design into a folder; see `write_folder`.

    Parameters
    ----------
    excitation : Excitation
    folder : Path
    force : bool
        Replace the files of an earlier design in the folder.
    """
    content = {"schema": 1} | excitation.to_dict()
    motion = excitation.motion()
    comments = limit_comments(excitation.checked, excitation.unchecked)
    ros = excitation.motion(min(ROS_RATE, excitation.rate))
    names = [joint.name for joint in excitation.model.robot.joints]
    figure = io.BytesIO()
    excitation.plot().savefig(figure, format="png", dpi=120)
    files = {
        "trajectory.csv": csv_text(motion, comments=comments).encode(),
        "excitation.json": json.dumps(content, indent=1, ensure_ascii=False).encode(),
        "joint_trajectory.yaml": joint_trajectory_yaml(ros, names).encode(),
        "excitation.png": figure.getvalue(),
        "summary.txt": (excitation.summary() + "\n").encode(),
    }
    return write_folder(folder, files, force=force)


def limit_comments(checked: Sequence[str], unchecked: Sequence[str]) -> tuple[str, ...]:
    """Return the comments of ``trajectory.csv``: limits that were checked, and that were not."""
    return tuple(
        f"{state}: {name}"
        for state, names in (("checked", checked), ("not checked", unchecked))
        for name in names
    )


def csv_text(motion: MotionSamples, *, comments: Sequence[str] = ()) -> str:
    """Return t, q1 … qn, dq1 … dqn, ddq1 … ddqn, one row per sample; 12 digits.

    Comments precede the header, each in a line that begins with ``#``.
    """
    n = motion.q.shape[1]
    names = [f"{kind}{j + 1}" for kind in ("q", "dq", "ddq") for j in range(n)]
    table = np.column_stack([motion.t, motion.q, motion.dq, motion.ddq])
    row = ",".join(["%.12g"] * table.shape[1]) + "\n"
    return (
        "".join(f"# {comment}\n" for comment in comments)
        + ",".join(["t", *names])
        + "\n"
        + "".join(row % tuple(values) for values in table.tolist())
    )


def joint_trajectory_yaml(motion: MotionSamples, names: list[str]) -> str:
    """Return a ``trajectory_msgs/msg/JointTrajectory`` as ``ros2 topic pub`` reads it."""
    lines = ["joint_names: [" + ", ".join(json.dumps(name) for name in names) + "]", "points:"]
    for k, t in enumerate(motion.t):
        seconds = int(np.floor(t + 5e-10))
        nanoseconds = max(0, round((t - seconds) * 1e9))
        lines += [
            f"- positions: {_numbers(motion.q[k])}",
            f"  velocities: {_numbers(motion.dq[k])}",
            f"  accelerations: {_numbers(motion.ddq[k])}",
            f"  time_from_start: {{sec: {seconds}, nanosec: {nanoseconds}}}",
        ]
    return "\n".join(lines) + "\n"


def _numbers(values: np.ndarray) -> str:
    # "1e-05" is text in YAML 1.1; with a point it is a number
    return "[" + ", ".join(f"{value:.9f}" for value in values.tolist()) + "]"
