"""``lieid discriminate``: files, exit statuses, one line on stderr."""

import json

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.cli.main import main

QUICK = ["--evaluations", "130"]


@pytest.fixture(scope="module")
def paths(tmp_path_factory):
    """Return the paths of a fit and of its recording."""
    folder = tmp_path_factory.mktemp("fit")
    robot = lieid.robots.two_link()
    t = np.arange(0.0, 10.0, 0.005)
    motion = plant.FourierTrajectory(robot, base_frequency=0.1, seed=2)
    arm, sensors = plant.demo_arm(robot, hidden=None), plant.demo_sensors(robot)
    recording = plant.measure_along(arm, t, *motion.at(t), sensors=sensors, seed=2)
    recording.save(folder / "train.csv")
    fit = lieid.identify(lieid.Model(robot, ["coulomb", "viscous", "offset"]), recording)
    fit.save(folder / "fit.json")
    return str(folder / "fit.json"), str(folder / "train.csv")


def test_writes_the_trajectory_and_prints_its_duration(paths, tmp_path, capsys):
    fit, _ = paths
    out, result = tmp_path / "out", tmp_path / "result.json"
    words = ["discriminate", fit, "stribeck:1", "viscous_polynomial:1", "-o", str(out), *QUICK]
    assert main([*words, "--json", str(result)]) == 0
    shown = capsys.readouterr()
    content = json.loads(result.read_text())
    assert f"{content['seconds']:.4g} s of this motion" in shown.out
    # within the default limits: the tool stays above the base plane
    assert {"floor", "self-collision", "tool speed"}.isdisjoint(content["unchecked"])
    assert "Not checked: " in shown.out
    lines = (out / "trajectory.csv").read_text().splitlines()
    assert any(line.startswith("# not checked: ") for line in lines)
    table = np.genfromtxt([line for line in lines if line[0] != "#"], delimiter=",", names=True)
    height = 0.5 * np.sin(table["q1"]) + 0.4 * np.sin(table["q1"] + table["q2"])
    assert height.min() > 0.0
    assert shown.err == ""
    assert {p.name for p in out.iterdir()} == {
        "trajectory.csv", "discriminate.json", "discriminate.png", "lieid-manifest.json"
    }  # fmt: skip
    assert json.loads((out / "discriminate.json").read_text()) == content
    # a folder with content stays as it is, unless forced
    assert main(words) == 2
    assert "--force" in capsys.readouterr().err
    assert main([*words, "--force", "--size", "stribeck:1=0.3,0.08"]) == 0
    again = json.loads((out / "discriminate.json").read_text())
    assert again["sizes"]["stribeck:1"] == [0.3, 0.08]


@pytest.mark.parametrize(
    ("words", "status", "message"),
    [
        (["stribeck:1", "stribeck:1"], 2, "twice"),
        (["stribeck:1"], 2, "at least two"),
        (["stribeck:1", "striebeck:2"], 2, "striebeck"),
        (["stribeck:1", "viscous_polynomial:1", "--size", "stribeck:1=much"], 2, "--size"),
        (["stribeck:1", "viscous_polynomial:1", "--size", "stribeck:2=1"], 2, "stribeck:2"),
        (["stribeck:1", "viscous_polynomial:1", "--start-pose", "9", "0"], 2, "start pose"),
        (["stribeck:1", "viscous_polynomial:1", "--level", "2"], 2, "level"),
        (["armature:1", "stribeck:1"], 3, "no data"),
    ],
)
def test_invalid_requests_are_one_line_and_no_file(paths, tmp_path, capsys, words, status, message):
    out = tmp_path / "out"
    assert main(["discriminate", paths[0], *words, "-o", str(out), *QUICK]) == status
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not out.exists()
