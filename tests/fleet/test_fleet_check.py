"""Fleet files, errors that name the line, and ``lieid fleet check``."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from fleet.simulated_fleet import healthy_arm, recorded

from lieid_casadi.cli.main import main
from lieid_casadi.errors import FleetError
from lieid_casadi.fleet.arm_night import run_arm_night
from lieid_casadi.fleet.config import read_fleet
from lieid_casadi.fleet.fleet_check import check_fleet
from lieid_casadi.fleet.night_result import ArmNight


def edit(folder, old, new):
    path = folder / "fleet.yaml"
    text = path.read_text("utf-8")
    assert old in text
    path.write_text(text.replace(old, new), "utf-8")


def reversed_torque(recording):
    """Return a recording whose torque has the other sign on every joint."""
    return replace(recording, tau=-recording.tau)


@pytest.fixture
def other_sign(fleet_folder):
    """Path of a night of A1 on which the torque has the other sign."""
    run = recorded("two_link", healthy_arm("two_link", 1), motion_seed=4, seed=9, duration=15.0)
    path = fleet_folder / "nights/A1/2026-01-05.csv"
    reversed_torque(run).save(path)
    return path


def test_a_plausible_fleet_is_sound(fleet_folder, tmp_path, capsys):
    out = tmp_path / "check.json"
    assert main(["fleet", "check", str(fleet_folder / "fleet.yaml"), "--json", str(out)]) == 0
    found = json.loads(out.read_text("utf-8"))
    assert found["verdict"] == "sound"
    assert [(a["serial"], a["recordings"], a["newest"]) for a in found["arms"]] == [
        ("A1", 4, "2026-01-04"), ("A2", 4, "2026-01-04"),
    ]  # fmt: skip
    assert "sound" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("payload: {mass: 1500, com: [0, 0, 0.1]}", "payload of 1500 kg; the arm itself has"),
        ("payload: {mass: 2.0, com: [0, 0, 80]}", "payload with com at 80 m from the tool"),
        ("torque_constants: [14900, 13300]", "torque constant of 14900 N·m/A"),
    ],
)
def test_entries_in_other_units_are_wrong(fleet_folder, capsys, entry, message):
    path = "recordings: nights/A1/*.csv"
    edit(fleet_folder, path, f"{path}\n    {entry}")
    assert main(["fleet", "check", str(fleet_folder / "fleet.yaml")]) == 4
    assert f"A1: !! {message}" in capsys.readouterr().out


def test_recordings_of_two_arms_are_wrong(fleet_folder):
    edit(fleet_folder, "nights/A2/*.csv", "nights/A1/*.csv")
    edit(fleet_folder, '"{serial}/', '"A1/')
    first, second = check_fleet(read_fleet(fleet_folder / "fleet.yaml"))
    assert first.verdict == second.verdict == "wrong"
    assert "is a recording of A2 as well" in first.wrong[0]
    assert "is a recording of A1 as well" in second.wrong[0]


def test_files_that_a_worker_cannot_see_are_wrong(fleet_folder, scheduler, monkeypatch, capsys):
    words = ["fleet", "check", str(fleet_folder / "fleet.yaml"), "--scheduler", scheduler]
    assert main(words) == 0
    monkeypatch.setattr("lieid_casadi.fleet.fleet_check.missing_files", lambda paths: paths[:1])
    capsys.readouterr()
    assert main(words) == 4
    assert "cannot see" in capsys.readouterr().out.partition("A2:")[0]


def test_an_arm_without_usable_recordings(fleet_folder):
    shutil.rmtree(fleet_folder / "nights/A1")
    (fleet_folder / "fits/A2.json").write_text("{", "utf-8")
    first, second = check_fleet(read_fleet(fleet_folder / "fleet.yaml"))
    assert "A1/*.csv: no recording to judge" in first.wrong[0]
    assert "A2.json" in second.wrong[0]


def test_the_premises_are_tested_on_the_newest_recording(fleet_folder, other_sign, capsys):
    assert main(["fleet", "check", str(fleet_folder / "fleet.yaml")]) == 4
    (line,) = [x for x in capsys.readouterr().out.splitlines() if x.startswith("A1: ")]
    assert "!!" in line
    assert "sign" in line


def test_a_night_with_a_wrong_premise_is_refused_with_its_sentence(fleet_folder, other_sign):
    content = (fleet_folder / "fits/A1.json").read_bytes()
    result = run_arm_night(ArmNight("A1", "2026-01-05", str(other_sign), "", "f"), content)
    assert result.status == "refused"
    assert "do not belong together (torque_sign)" in result.reason


ARM = """arms:
  - serial: A17
    fit: fits/a17.json
    recordings: nights/a17/*.csv
"""


def fleet_of(tmp_path, text):
    path = tmp_path / "fleet.yaml"
    path.write_text(text, encoding="utf-8")
    return read_fleet(path)


def test_an_arm_with_all_that_is_known_of_it(tmp_path):
    text = (
        ARM
        + """    torque_constants: [14.9, 13.3]
    tool: {xyz: [0, 0, 0.1]}
    payload:
      - {mass: 2.0, com: [0, 0, 0.05], inertia: {ixx: 0.01, iyy: 0.01, izz: 0.02}, label: crate}
      - {mass: 0.5, com: [0.01, 0, 0]}
    limits: {coulomb: [5.0, 3.0], viscous: 2.0}
  - serial: B2
    robot: panda
    train: [one.csv, "s3://bucket/two.csv"]
    recordings: ["s3://bucket/b2/*.parquet", later/*.mcap]
night: "{serial}/(?P<date>\\\\d{4}-\\\\d{2}-\\\\d{2})"
"""
    )
    fleet = fleet_of(tmp_path, text)
    first, second = fleet.arms
    assert [f.value for f in first.fits] == [str(tmp_path / "fits/a17.json")]
    assert [k.value for k in first.torque_constants] == [(14.9, 13.3)]
    np.testing.assert_allclose(first.tools[0].value[:3, 3], [0.0, 0.0, 0.1])
    assert [p.value.label for p in first.payloads] == ["crate", ""]
    np.testing.assert_allclose(
        first.payloads[0].value.parameters, [2, 0, 0, 0.1, 0.015, 0, 0.015, 0, 0, 0.02]
    )
    assert first.limits == {"coulomb": (5.0, 3.0), "viscous": (2.0,)}
    assert second.robot == "panda"
    assert second.train == (str(tmp_path / "one.csv"), "s3://bucket/two.csv")
    assert second.recordings[0] == "s3://bucket/b2/*.parquet"
    match = fleet.night_pattern("A17").search("x/A17/2026-01-02.csv")
    assert match["date"] == "2026-01-02"
    assert fleet.night_pattern("A17").search("x/B2/2026-01-02.csv") is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("arms: []", "line 1: arms: Expected 'array' of length >= 1"),
        ("arms:\n  - serial: A\n    fit: f\n", "line 2: .*missing required field 'recordings'"),
        (ARM + "    colour: red\n", "line 2: .*unknown field 'colour'"),
        (ARM.replace("A17", "17"), "line 2: arms\\[0\\].serial: Expected 'str', got 'int'"),
        (ARM + ARM.partition("\n")[2], "line 5: arms\\[1\\].serial: found 'A17' twice"),
        (
            ARM + "    robot: panda\n",
            "line 2: arms\\[0\\]: expected either fit, or robot",
        ),
        (ARM + "night: '(\\d+)'\n", "line 5: night: .*\\(\\?P<date>"),
        (ARM + "night: '(?P<date'\n", "line 5: night: .*regular expression"),
        (ARM + "    limits: {coulomb: -1}\n", "line 5: arms\\[0\\].limits: .*> 0"),
        (ARM + "    payload: {mass: 1}\n", "line 5: .*missing required field 'com'"),
        (ARM + "    torque_constants: [1, 0]\n", "line 5: .*other than 0"),
        ("arms:\n  - [", "line 3, column"),
        ("arms: !!python/object:os.system x", "tag"),
    ],
)
def test_errors_are_one_line_with_the_line_in_the_file(tmp_path, text, message):
    with pytest.raises(FleetError, match=message) as caught:
        fleet_of(tmp_path, text)
    assert str(caught.value).startswith(str(tmp_path / "fleet.yaml"))
    assert "\n" not in str(caught.value)
