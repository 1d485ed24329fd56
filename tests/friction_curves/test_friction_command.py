"""``lieid friction``: tables, JSON, and one line for bad input."""

import json

import numpy as np
import pytest
from friction_curves.friction_plant import ROBOT, SPEEDS, excitation, measured
from plant.motions import constant_speeds

import lieid_casadi as lieid
from lieid_casadi.cli.main import main


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("friction")
    motion = constant_speeds(ROBOT, 0, speeds=SPEEDS[3:], pose=[0.0, 0.4])
    t = np.arange(0.0, motion.duration, 0.004)
    path = folder / "run.csv"
    measured(t, motion.at(t)).save(path)
    return str(path)


def lieid_friction(*words):
    return main(["friction", "two_link", *map(str, words)])


def test_the_model_is_printed_and_written(run, tmp_path, capsys):
    out = tmp_path / "f.json"
    assert lieid_friction(run, "--joint", 1, "--json", out) == 0
    assert "coulomb, viscous, stribeck, load_friction: RMS" in capsys.readouterr().out
    content = json.loads(out.read_text())
    assert content["joint"] == 1
    assert {"name", "joint", "value", "std", "unit"} == set(content["fit"]["parameters"][0])
    assert len(content["curve"]["points"]) == len(content["fit"]["predicted"])
    fit = lieid.identify(
        lieid.Model(ROBOT, "coulomb,viscous,offset,stribeck:1,load_friction:1"),
        excitation(0),
        processing=lieid.Processing(cutoff=10.0),
    )
    fit.save(tmp_path / "fit.json")
    words = [run, "--joint", 1, "--effects", "coulomb,viscous", "--cutoff", 10, "--json", out]
    assert lieid_friction(*words, "--fit", tmp_path / "fit.json") == 0
    content = json.loads(out.read_text())
    assert content["fit"]["effects"] == ["coulomb", "viscous"]
    assert content["curve"]["load_source"] == "model"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--joint", "3"], "--joint 3: two_link has joints 1 to 2"),
        (["--joint", "1", "--effects", "coulom"], "unknown effect 'coulom'"),
        (["--joint", "1", "--effects", "warm_up"], "is not friction of speed and load"),
    ],
)
def test_bad_input_is_one_line(run, tmp_path, refusal, words, message):
    out = tmp_path / "f.json"
    refusal(["friction", "two_link", run, *words, "--json", out], message)
    assert not out.exists()
