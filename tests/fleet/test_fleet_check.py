"""``lieid fleet check``: implausible entries, shared and invisible recordings, wrong premises."""

import json
import shutil
from dataclasses import replace

import pytest
from fleet.simulated_fleet import healthy_arm, recorded

from lieid_casadi.cli.main import main
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
    assert "no file matches" in first.wrong[0]
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
