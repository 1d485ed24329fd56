"""Files around the code: version, C side, the README's commands, layers, fit files of 0.1.0."""

import itertools
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi.codegen_files import codegen_folder
from lieid_casadi.robot import Robot, yaml_file

ROOT = Path(__file__).parents[2]


def test_version_is_in_one_place_and_is_semantic():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert "version" in project["dynamic"]
    assert re.fullmatch(r"\d+\.\d+\.\d+", lieid.__version__)
    assert f"\nversion: {lieid.__version__}\n" in (ROOT / "CITATION.cff").read_text()


def test_installed_codegen_folder_goes_first(monkeypatch, tmp_path):
    for folder in (tmp_path / "codegen", tmp_path / "lieid_casadi" / "codegen"):
        folder.mkdir(parents=True)
        (folder / "README.md").touch()
    monkeypatch.setattr("lieid_casadi.codegen_files._PACKAGE", tmp_path / "lieid_casadi")
    assert codegen_folder() == tmp_path / "lieid_casadi" / "codegen"


@pytest.mark.slow
@pytest.mark.parametrize(
    "script",
    [
        p
        for p in sorted((ROOT / "tests/benchmarks").glob("*.py"))
        if "parse_args()" in p.read_text()
    ],
    ids=lambda path: path.stem,
)
def test_benchmarks_start_as_documented(script, tmp_path):
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    command = [sys.executable, script, "--help"]
    done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_readme_has_the_two_commands_that_ci_runs():
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    commands = [line for line in lines if line.startswith("python3 -m venv .venv && ")]
    assert sum(line.endswith("lieid demo") for line in commands) == 1
    assert sum(line.endswith("pytest") for line in commands) == 1


def test_readme_links_exist():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    links = re.findall(r"\]\((?!https?:)([^)#]+)", text)
    assert links
    assert [link for link in links if not (ROOT / link).exists()] == []


def test_contributing_has_the_layers_that_import_linter_checks():
    """Same packages, and no row of the table imports from a later one."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = next(c["layers"] for c in contracts["contracts"] if c["name"] == "Layers")
    checked = [re.findall(r"\w+", layer) for layer in layers if not layer.startswith("(")]
    rank = {name: -k for k, names in enumerate(checked) for name in names}
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    rows = [
        re.findall(r"`(\w+)`", cells) for cells in re.findall(r"^\| \d \| (.*?) \|", text, re.M)
    ]
    assert {name for row in rows for name in row} == set(rank)
    for before, after in itertools.pairwise(rows):
        assert max(rank[name] for name in before) < min(rank[name] for name in after)


def test_documentation_shows_a_robot_that_is_read():
    page = ROOT / "docs" / "start" / "own_data.md"
    block = re.search(r"```yaml\n(.*?)```", page.read_text("utf-8"), re.DOTALL)
    robot = Robot.parse_yaml(block[1])
    assert [joint.revolute for joint in robot.joints] == [True, False]


def test_yaml_in_the_reference_is_read():
    block = re.search(r"code-block:: yaml\n\n(.*?)\n\n``name``", yaml_file.__doc__, re.DOTALL)
    assert Robot.parse_yaml(block[1]).joints[0].torque_constant == 11.0


FITS = Path(__file__).parent / "data" / "fits_0_1_0"
EFFECTS = {
    "joints": "coulomb,viscous,offset,stribeck:1,load_friction:2,presliding:2",
    "arm": "coulomb,viscous,offset,base_tilt,armature:2,torque_delay:2",
    "feasible": "coulomb,viscous,offset,viscous_polynomial:1",
}


@pytest.fixture(scope="module")
def motion():
    return lieid.Recording.load(FITS / "motion.csv")


@pytest.mark.parametrize("name", EFFECTS)
def test_fit_of_0_1_0_predicts_identically(motion, name):
    fit = lieid.Fit.load(FITS / f"fit_{name}.json")
    assert ",".join(fit.model.effects) == EFFECTS[name]
    expected = np.loadtxt(FITS / f"predicted_{name}.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(fit.predict(motion), expected, rtol=1e-9, atol=1e-9)
