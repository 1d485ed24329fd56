"""The example of an experiment, whose robot is an arm in MuJoCo."""

import json
import sys

import pytest

from lieid_casadi.cli.main import main

pytest.importorskip("mujoco")


@pytest.mark.slow
def test_finds_the_friction_of_the_arm(request, tmp_path):
    program = request.config.rootpath / "examples" / "experiment_mujoco.py"
    record = f"'{sys.executable}' '{program}' {{trajectory}} {{recording}}"
    out = tmp_path / "out"
    assert main(["experiment", "two_link", "--yes", "-o", str(out), "--record", record]) == 0
    content = json.loads((out / "experiment.json").read_text())
    assert content["stopped"] == "all_named"
    (step,) = content["steps"]
    assert step["label"] == "stribeck:1"
    assert step["parameters"]["f_s-f_c"] == pytest.approx(1.5, rel=0.05)
    assert step["parameters"]["v_s"] == pytest.approx(0.25, rel=0.05)
