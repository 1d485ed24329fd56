"""The formats that the package reads: their seeds, their mutations, and what is done with them."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from fuzz import container_mutations, seeds, text_mutations
from fuzz.parquet_mutations import mutate_parquet
from fuzz.text_mutations import mutate_bytes

#: Bytes of the longest input.
LONGEST = 4 << 20

Mutation = Callable[[bytes, random.Random], bytes]


@dataclass(frozen=True)
class Format:
    """One format.

    Attributes
    ----------
    name
        Of the format, for tables and ``--format``.
    file_name
        Name that a file of this format has.
    seeds
        Returns valid files.
    mutate
        Structure-aware mutation.
    use
        Loads a file and does with it what every command does.
    folder
        Returns the other files of a format whose recordings are folders; ``file_name`` is inside.
    """

    name: str
    file_name: str
    seeds: Callable[[], list[bytes]]
    mutate: Mutation
    use: Callable[[Path], None]
    folder: Callable[[], dict[str, bytes]] | None = None

    def mutation(self, index: int, seed: int) -> bytes:
        """Return the mutation of a number; the same for the same seed on any machine."""
        rng = random.Random(f"{self.name}/{seed}/{index}")
        files = self.seeds()
        data = rng.choice(files)
        for _ in range(rng.choice((1, 1, 1, 2, 3))):
            if rng.random() < 0.6:
                data = self.mutate(data, rng)
            else:
                data = mutate_bytes(data, rng, rng.choice(files))
        return data[:LONGEST]

    def write(self, data: bytes, folder: Path) -> Path:
        """Write a file of this format into a folder; return what is loaded."""
        if self.folder is None:
            file = folder / self.file_name
            file.write_bytes(data)
            return file
        whole = folder / "recording"
        for name, content in (self.folder() | {self.file_name: data}).items():
            (whole / name).parent.mkdir(parents=True, exist_ok=True)
            (whole / name).write_bytes(content)
        return whole


def _use_recording(path: Path) -> None:
    from lieid_casadi.recording import Recording, check, process

    recording = Recording.load(path)
    check(recording)
    process(recording)


def _use_dataset(path: Path) -> None:
    from drives.lerobot_files import JOINTS, SO101

    from lieid_casadi.recording import Recording, check, process

    limits = np.column_stack([SO101.limit("position_lower"), SO101.limit("position_upper")])
    recording = Recording.load(
        path, joint_names=JOINTS, calibration="limits", position_limits=limits
    )
    check(recording)
    process(recording)


def _use_robot(path: Path) -> None:
    import lieid_casadi as lieid

    robot = lieid.Robot.load(path)
    lieid.Model(robot, ["coulomb", "viscous", "offset"])


def _use_fit(path: Path) -> None:
    import lieid_casadi as lieid

    fit = lieid.Fit.load(path)
    if fit.model.robot.n == 2:
        fit.predict(_two_joint_recording())


@cache
def _two_joint_recording() -> Any:
    from recording.planar_arm import measured

    return measured(duration=1.0, rate=50.0)


FORMATS = {
    made.name: made
    for made in (
        Format("csv", "run.csv", seeds.csv, text_mutations.mutate_csv, _use_recording),
        Format("csv.gz", "run.csv.gz", seeds.csv_gz, container_mutations.mutate_gzip,
               _use_recording),
        Format("npz", "run.npz", seeds.npz, container_mutations.mutate_npz, _use_recording),
        Format("parquet", "run.parquet", seeds.parquet, mutate_parquet, _use_recording),
        Format("mcap", "run.mcap", seeds.mcap, container_mutations.mutate_mcap, _use_recording),
        Format("db3", "run.db3", seeds.ros2_database, container_mutations.mutate_sqlite,
               _use_recording),
        Format("ros2", "metadata.yaml", seeds.ros2_metadata, text_mutations.mutate_yaml,
               _use_recording, seeds.ros2_bag),
        Format("lerobot", "meta/info.json", seeds.lerobot_info, text_mutations.mutate_json,
               _use_dataset, seeds.lerobot_dataset),
        Format("episodes", "data/chunk-000/file-000.parquet", seeds.lerobot_data, mutate_parquet,
               _use_dataset, seeds.lerobot_dataset),
        Format("yaml", "robot.yaml", seeds.robot_yaml, text_mutations.mutate_yaml, _use_robot),
        Format("urdf", "robot.urdf", seeds.urdf, text_mutations.mutate_xml, _use_robot),
        Format("fit", "fit.json", seeds.fit_json, text_mutations.mutate_json, _use_fit),
    )
}  # fmt: skip
