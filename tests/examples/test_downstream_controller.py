"""The downstream controller in C: the example's short run, and its build."""

import importlib.util
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from exporters.c_arms import ARMS, WARNINGS, run

from lieid_casadi.codegen_files import codegen_folder
from lieid_casadi.exporters.export import export

EXAMPLE = Path(__file__).parents[2] / "examples" / "downstream_controller.py"


@pytest.fixture(scope="module")
def example():
    specification = importlib.util.spec_from_file_location("downstream_controller", EXAMPLE)
    module = importlib.util.module_from_spec(specification)
    import sys

    sys.modules[specification.name] = module  # dataclasses look their module up
    specification.loader.exec_module(module)
    yield module
    del sys.modules[specification.name]


@pytest.fixture(scope="module")
def runs(example, tmp_path_factory):
    if shutil.which("cmake") is None:
        pytest.skip("no cmake")
    folder = tmp_path_factory.mktemp("plot") / "new"
    runs = example.main(["--robot", "two_link", "--seconds", "5", "-o", str(folder)])
    assert (folder / "tracking.png").stat().st_size > 1000
    return runs


@pytest.mark.slow
def test_identified_model_tracks_ten_times_better(runs):
    before, after = runs["computed torque, nominal"], runs["computed torque, identified"]
    assert np.abs(before.error[0]).max() < 1e-5  # both start on the path
    assert after.rms() < 0.1 * before.rms()


@pytest.mark.slow
def test_adaptive_control_converges(runs):
    adaptive, fixed = runs["Slotine-Li, from nominal"], runs["computed torque, nominal"]
    first, last = adaptive.rms(0.0, 5.0), adaptive.rms(10.0, 15.0)
    assert last < 0.5 * first < 0.5 * fixed.rms()
    assert last < 0.1 * fixed.rms()


@pytest.mark.parametrize("name", list(ARMS))
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_controller_builds_with_any_arm(tmp_path, name, compiler):
    export(ARMS[name](), tmp_path / "arm", to="c")
    for source in sorted((codegen_folder() / "controller").glob("*.c")):
        command = [compiler, "-std=c99", *WARNINGS, f"-I{tmp_path / 'arm'}", "-c", str(source)]
        run(command, tmp_path)


def test_missing_arm_is_reported(tmp_path):
    if shutil.which("cmake") is None:
        pytest.skip("no cmake")
    command = ["cmake", "-S", str(codegen_folder() / "controller"), "-B", str(tmp_path / "b")]
    done = subprocess.run([*command, "-DARM_DIR=nowhere"], capture_output=True, text=True)
    assert done.returncode != 0
    assert "no arm.h there" in done.stderr
