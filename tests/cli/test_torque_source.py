"""Torque from motor currents: default effects, and what a fit stores of how it was read."""

import json
from dataclasses import replace

import numpy as np
import pytest
from plant.recordings import recorded

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.cli.main import main
from lieid_casadi.robot.description import bundled_text

ROBOT = lieid.robots.two_link()
CONSTANTS = np.array([12.0, 8.0])
GIVEN = ["--torque-constants", "12,8"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Recordings of currents in degrees, and of torque in SI units."""
    path = tmp_path_factory.mktemp("currents")
    arm, sensors = plant.demo_arm(ROBOT, hidden=None), plant.Sensors(rate=100.0, torque_noise=0.05)
    for seed in (1, 2):
        run = recorded(arm, seed, seconds=8.0, step=0.01, sensors=sensors)
        run.save(path / f"torque{seed}.csv")
        degrees = 180.0 / np.pi
        replace(
            run, q=run.q * degrees, dq=run.dq * degrees, tau=None, temperature=None,
            current=run.tau / CONSTANTS,
        ).save(path / f"currents{seed}.csv")  # fmt: skip
    options = [*GIVEN, "--units", "deg", "-o", str(path / "fit.json"), "--json"]
    train = str(path / "currents1.csv")
    assert main(["identify", "two_link", train, *options, str(path / "out.json")]) == 0
    return path


def effects_of(folder, capsys, *args):
    out = folder / "identify.json"
    assert main(["identify", "two_link", *map(str, args), "--json", str(out)]) == 0
    return json.loads(out.read_text())["effects"], capsys.readouterr().out


def test_rotor_inertia_is_a_default_where_torque_comes_from_currents(folder, capsys):
    with_rotor = ["coulomb", "viscous", "offset", "armature"]
    assert json.loads((folder / "out.json").read_text())["effects"] == with_rotor
    effects, text = effects_of(folder, capsys, folder / "torque1.csv")
    assert effects == with_rotor[:3]
    assert "armature" not in text
    effects, text = effects_of(folder, capsys, folder / "torque1.csv", "--motor-side")
    assert effects == with_rotor
    assert "(armature) is among them because torque is measured at the motors" in text
    options = ("--motor-side", "--effects", "coulomb")
    assert effects_of(folder, capsys, folder / "torque1.csv", *options)[0] == ["coulomb"]


def test_a_robot_with_torque_constants_has_rotor_inertia(folder, capsys, tmp_path):
    described, lines = tmp_path / "arm.yaml", []
    for line in bundled_text("two_link").splitlines():
        lines.append(line)
        if line.strip().startswith("- name:"):
            lines.append(line[: line.index("-")] + "  torque_constant: 12.0")
    described.write_text("\n".join(lines))
    assert main(["diagnose", str(described), "--train", str(folder / "torque1.csv")]) == 0
    assert "the robot states torque constants" in capsys.readouterr().out


def test_a_fit_stores_constants_and_units_so_that_compare_needs_no_flag(folder, capsys):
    fit = lieid.Fit.load(folder / "fit.json")
    assert fit.provenance.torque_constants == (12.0, 8.0)
    assert fit.provenance.units == ("deg",)
    out = folder / "compare.json"
    run = str(folder / "currents2.csv")
    assert main(["compare", str(folder / "fit.json"), run, "--json", str(out)]) == 0
    content = json.loads(out.read_text())
    assert max(content["relative_rms"]) < 0.05
    assert "TorqueConstantsWarning" not in [w["name"] for w in content["warnings"]]
    capsys.readouterr()


def test_other_constants_than_those_of_the_fit_are_pointed_out(folder, capsys):
    run = str(folder / "currents2.csv")
    command = ["compare", str(folder / "fit.json"), run, "--torque-constants", "12,9"]
    assert main(command) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "differ from those of the fit: joint 2 9 (fit: 8)" in printed
