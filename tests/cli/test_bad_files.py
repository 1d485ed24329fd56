"""Recordings and robots with faults: status 2 and one line that names the location."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cli.two_link_files import columns, refused, urdf, write


def without_torque(table):
    del table["tau2"]


def one_row(table):
    table |= {name: values[:1] for name, values in table.items()}


def missing_values(table):
    table["dq2"][20:60] = np.nan


def time_going_back(table):
    table["t"][30] = table["t"][10]


def degrees(table):
    table |= {name: np.degrees(x) if "q" in name else x for name, x in table.items()}


def no_length(table):
    table["t"] *= 1e-300


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (without_torque, ["tau2"]),
        (one_row, []),
        (missing_values, ["dq2"]),
        (time_going_back, ["t"]),
        (degrees, ["rad"]),
        (no_length, ["column t", "mean rate"]),
    ],
)
def test_tables(run, tmp_path, damage, words):
    table = {name: values.copy() for name, values in columns().items()}
    damage(table)
    data = write(tmp_path / "a.csv", table)
    refused(run("identify", "two_link", data, "-o", tmp_path / "fit.json"), "a.csv", *words)
    assert not (tmp_path / "fit.json").exists()


def test_files_of_recordings(run, tmp_path, good):
    path = tmp_path / "a.csv"
    refused(run("identify", "two_link", path), "a.csv", "no such file")
    lines = Path(good).read_text().splitlines()
    lines[10] = lines[10].replace(lines[10].split(",")[3], "fast", 1)
    for content, words in (
        (bytes(range(256)) * 20, []),
        (b"", ["empty"]),
        ("\n".join(lines).encode(), ["fast", "11"]),
    ):
        path.write_bytes(content)
        refused(run("identify", "two_link", path), "a.csv", *words)
    refused(run("identify", "panda", good), "run.csv", "2", "7")
    refused(run("identify", "two_link", good, "--cutoff", 400), "400", "Hz")


def test_small_damage_and_columns_of_other_names_are_read(run, tmp_path):
    table = columns()
    names = {name: f"my_{name}" for name in table}
    stated = ",".join(f"{name}={column}" for name, column in names.items())
    table["dq2"] = table["dq2"].copy()
    table["dq2"][20] = np.nan
    file = write(tmp_path / "a.csv", {names[name]: x for name, x in table.items()})
    status, out, err = run("identify", "two_link", file, "--columns", stated)
    assert status == 0, err
    assert "1 of" in out + err
    refused(run("identify", "two_link", file), "a.csv", "--columns")


def test_warnings_of_libraries_are_not_printed(tmp_path):
    table = columns()
    table["dq1"] = table["dq1"] * 1e-300  # overflows in SciPy's interpolation
    data = write(tmp_path / "run.csv", table)
    words = ["identify", "two_link", data, "--despite-check"]  # the check finds the velocity
    command = [sys.executable, "-m", "lieid_casadi.cli.main", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "The recorded velocity of joint 1 " in done.stdout


def test_a_urdf_without_inertias_identifies_all_the_same(run, tmp_path, good):
    path = tmp_path / "arm.urdf"
    path.write_text(urdf(inertial=""))  # its zero is another than that of the recorded arm
    options = ["--despite-check", "--json", tmp_path / "a.json"]
    status, _, err = run("identify", path, good, *options)
    assert status == 0, err
    assert json.loads((tmp_path / "a.json").read_text())["base_parameter_count"] == 12
