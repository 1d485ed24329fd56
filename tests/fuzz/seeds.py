"""Valid small files of every format, made by code: what the mutations start from."""

from __future__ import annotations

import tempfile
from functools import cache
from importlib.resources import files
from pathlib import Path

import pyarrow
import pyarrow.parquet
from drives import lerobot_files
from fuzz.container_mutations import zip_members, zipped
from recording import bag_files
from recording.planar_arm import measured

import lieid_casadi as lieid

URDF = """<?xml version="1.0"?>
<robot name="two_link">
  <link name="base"/>
  <link name="upper">
    <inertial>
      <origin xyz="0.25 0 0" rpy="0 0 0.1"/><mass value="2.0"/>
      <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.05" iyz="0" izz="0.05"/>
    </inertial>
  </link>
  <link name="lower">
    <inertial>
      <origin xyz="0.2 0 0"/><mass value="1.0"/>
      <inertia ixx="0.005" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/>
    </inertial>
  </link>
  <link name="tool"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.1" rpy="1.5708 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-2.5" upper="2.5" velocity="3" effort="40"/>
    <dynamics damping="0.1" friction="0.2"/>
  </joint>
  <joint name="elbow" type="revolute">
    <parent link="upper"/><child link="lower"/>
    <origin xyz="0.5 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-2.5" upper="2.5" velocity="3" effort="15"/>
  </joint>
  <joint name="flange" type="fixed">
    <parent link="lower"/><child link="tool"/><origin xyz="0.4 0 0"/>
  </joint>
</robot>
"""


@cache
def recording(rows: int = 80) -> lieid.Recording:
    """Return a short recording with every signal and a payload."""
    run = measured(duration=rows / 20, rate=20, noise=0.1)
    load = ["2 kg"] * rows
    return lieid.Recording.from_arrays(
        run.t, run.q, run.dq, run.tau, temperature=run.q + 30.0, current=run.tau / 10.0, load=load
    )


@cache
def plain_recording(rows: int = 80) -> lieid.Recording:
    """Return a short recording of time, position, velocity and torque."""
    return measured(duration=rows / 20, rate=20, noise=0.1)


def _saved(name: str, *, both: bool = True) -> list[bytes]:
    made = []
    with tempfile.TemporaryDirectory() as folder:
        for run in (plain_recording(), recording()) if both else (plain_recording(),):
            file = Path(folder) / name
            run.save(file)
            made.append(file.read_bytes())
    return made


@cache
def csv() -> list[bytes]:
    """CSV: all columns, only some of them, and quoted cells."""
    quoted = b't,"q1","load"\n0,"1","a, b"\n0.1,2,c\n0.2,3,c\n'
    return [*_saved("run.csv"), quoted]


@cache
def csv_gz() -> list[bytes]:
    """Gzipped CSV."""
    return _saved("run.csv.gz")


@cache
def npz() -> list[bytes]:
    """NumPy archives."""
    return [zipped(zip_members(data)) for data in _saved("run.npz")]


@cache
def parquet() -> list[bytes]:
    """Parquet: with dictionaries, without compression, and with columns of other types."""
    run = plain_recording()
    columns = {"t": run.t, "q1": run.q[:, 0], "tau1": run.tau[:, 0].astype("f4")}
    tables = [
        columns | {"load": pyarrow.array([None, "a"] * 40)},
        columns | {"dq1": pyarrow.array([[1.0]] * 80), "x": pyarrow.array([b"\xff"] * 80)},
        columns | {"dq1": pyarrow.array(range(80)), "temp1": pyarrow.array(range(80)).cast("u1")},
        columns | {"i1": pyarrow.array(range(80)).cast("timestamp[ns]")},
    ]
    made = _saved("run.parquet")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "run.parquet"
        for k, table in enumerate(tables):
            options = {"compression": ("none", "gzip", "zstd", "snappy")[k], "row_group_size": 16}
            pyarrow.parquet.write_table(pyarrow.table(table), file, **options)
            made.append(file.read_bytes())
    return made


@cache
def mcap() -> list[bytes]:
    """MCAP: plain chunks, compressed chunks, and no chunks."""
    messages = bag_files.arm_messages(plain_recording())
    made = []
    with tempfile.TemporaryDirectory() as folder:
        for name, mode in (("a", None), ("b", bag_files.CompressionMode.STORAGE)):
            bag = bag_files.write(Path(folder) / name, messages, bag_files.StoragePlugin.MCAP, mode)
            made += [file.read_bytes() for file in bag.glob("*.mcap")]
        file = bag_files.write_unchunked_mcap(Path(folder) / "c.mcap", messages)
        made.append(file.read_bytes())
    return made


@cache
def ros2_database() -> list[bytes]:
    """The SQLite database of a ROS 2 bag."""
    return [ros2_bag()["bag.db3"]]


@cache
def ros2_metadata() -> list[bytes]:
    """The file ``metadata.yaml`` of a ROS 2 bag."""
    return [ros2_bag()["metadata.yaml"]]


@cache
def ros2_bag() -> dict[str, bytes]:
    """The files of a ROS 2 bag."""
    with tempfile.TemporaryDirectory() as folder:
        bag = bag_files.write(Path(folder) / "bag", bag_files.arm_messages(plain_recording()))
        return {file.name: file.read_bytes() for file in bag.iterdir()}


@cache
def robot_yaml() -> list[bytes]:
    """Robots in YAML: the bundled planar arm and Panda."""
    data = files("lieid_casadi.robot") / "data"
    return [(data / f"{name}.yaml").read_bytes() for name in ("two_link", "panda")]


@cache
def urdf() -> list[bytes]:
    """A robot in URDF."""
    return [URDF.encode()]


@cache
def fit_json() -> list[bytes]:
    """Fits of the planar arm, with a robot in YAML and in URDF."""
    run = measured(duration=6.0, rate=100.0)
    made = []
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "arm.urdf"
        source.write_text(URDF)
        models = (
            lieid.Model(lieid.robots.two_link(), ["coulomb", "viscous", "offset", "stribeck:1"]),
            lieid.Model(lieid.Robot.from_urdf(source), ["coulomb", "viscous"]),
        )
        for model in models:
            file = Path(folder) / "fit.json"
            lieid.identify(model, run).save(file)
            made.append(file.read_bytes())
    return made


@cache
def lerobot_dataset() -> dict[str, bytes]:
    """The files of a LeRobot dataset."""
    with tempfile.TemporaryDirectory() as folder:
        made = lerobot_files.write(Path(folder) / "set")
        files = [file for file in made.rglob("*") if file.is_file()]
        return {str(file.relative_to(made)): file.read_bytes() for file in files}


@cache
def lerobot_info() -> list[bytes]:
    """The description of a LeRobot dataset."""
    return [lerobot_dataset()["meta/info.json"]]


@cache
def lerobot_data() -> list[bytes]:
    """The data file of a LeRobot dataset."""
    return [lerobot_dataset()["data/chunk-000/file-000.parquet"]]
