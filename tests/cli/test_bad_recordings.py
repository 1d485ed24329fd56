"""Recordings with faults: status 2 and one line that names the location."""

import subprocess
import sys
from pathlib import Path

import numpy as np
from cli.two_link_files import columns, refused, write


def test_missing_file(run, tmp_path):
    refused(run("identify", "two_link", tmp_path / "no.csv"), "no.csv", "no such file")


def test_not_a_csv(run, tmp_path):
    path = tmp_path / "picture.csv"
    path.write_bytes(bytes(range(256)) * 20)
    refused(run("identify", "two_link", path), "picture.csv")


def test_header_without_a_torque(run, tmp_path):
    table = columns()
    del table["tau2"]
    refused(run("identify", "two_link", write(tmp_path / "a.csv", table)), "a.csv", "tau2")


def test_wrong_number_of_joints(run, good):
    refused(run("identify", "panda", good), "run.csv", "2", "7")


def test_text_in_a_number(run, tmp_path, good):
    path = tmp_path / "a.csv"
    lines = Path(good).read_text().splitlines()
    lines[10] = lines[10].replace(lines[10].split(",")[3], "fast", 1)
    path.write_text("\n".join(lines))
    refused(run("identify", "two_link", path), "a.csv", "fast", "11")


def test_empty_file(run, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("")
    refused(run("identify", "two_link", path), "a.csv", "empty")


def test_one_row(run, tmp_path):
    table = {k: v[:1] for k, v in columns().items()}
    refused(run("identify", "two_link", write(tmp_path / "a.csv", table)), "a.csv")


def test_nan(run, tmp_path):
    table = columns()
    table["dq2"] = table["dq2"].copy()
    table["dq2"][20:60] = np.nan
    refused(run("identify", "two_link", write(tmp_path / "a.csv", table)), "a.csv", "dq2")


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


def test_time_going_back(run, tmp_path):
    table = columns()
    table["t"] = table["t"].copy()
    table["t"][30] = table["t"][10]
    refused(run("identify", "two_link", write(tmp_path / "a.csv", table)), "a.csv", "t")


def test_degrees(run, tmp_path):
    table = {k: np.degrees(v) if "q" in k else v for k, v in columns().items()}
    refused(run("identify", "two_link", write(tmp_path / "a.csv", table)), "a.csv", "rad")


def test_stamps_of_almost_zero_length_are_refused_before_they_are_used(run, tmp_path):
    table = columns()
    table["t"] = table["t"] * 1e-300
    data = write(tmp_path / "run.csv", table)
    refused(run("identify", "two_link", data, "-o", tmp_path / "fit.json"), "column t", "mean rate")


def test_warnings_of_libraries_are_not_printed(tmp_path):
    table = columns()
    table["dq1"] = table["dq1"] * 1e-300  # overflows in SciPy's interpolation
    data = write(tmp_path / "run.csv", table)
    command = [sys.executable, "-m", "lieid_casadi.cli.main", "identify", "two_link", data]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "VelocityMismatch" in done.stdout


def test_cutoff_beyond_the_rate(run, good):
    refused(run("identify", "two_link", good, "--cutoff", 400), "400", "Hz")
