"""The ros2_control plug-in of the examples, built against the stub of the interface."""

import ctypes
import importlib.util
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import yaml
from exporters.c_arms import ARMS as C_ARMS
from exporters.c_arms import WARNINGS, made_fit, pointer, run

import lieid_casadi as lieid
from lieid_casadi.codegen_files import codegen_folder
from lieid_casadi.exporters.export import export
from lieid_casadi.exporters.mjcf import mjcf_text

FOLDER = Path(__file__).parents[2] / "examples" / "ros2_control"
ARMS = {  # distribution of ROS 2 → effects, whether the payload is an argument
    "jazzy": ("coulomb,viscous,offset,armature,presliding:2", False),
    "rolling": ("coulomb,viscous,offset,armature", True),
}


@pytest.fixture(scope="module", params=ARMS)
def built(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("ros2_control")
    effects, payload = ARMS[request.param]
    fit = made_fit(lieid.robots.two_link(), effects)
    export(fit, folder / "arm", to="c", payload=payload)
    configure = ["cmake", "-S", str(FOLDER), "-B", "build", f"-DARM_DIR={folder / 'arm'}"]
    configure.append(f"-DSTUB_ROLLING={'ON' if request.param == 'rolling' else 'OFF'}")
    assert "no ROS 2: building against the stub" in run(configure, folder)
    run(["cmake", "--build", "build"], folder)
    return fit, folder / "build"


@pytest.mark.slow
def test_what_a_controller_must_withstand(built):
    """The cases are in test/abuse.cpp, which fails at the first that is wrong."""
    fit, folder = built
    shown = run([str(folder / "abuse")], folder)
    assert float(re.search(r"largest tracking error: (\S+)", shown)[1]) < 1e-3
    assert "allocations in update(): 0" in shown
    assert ("1 kg at the tool" in shown) == ("presliding:2" not in fit.model.effects)


@pytest.mark.slow
@pytest.mark.parametrize("built", ["rolling"], indirect=True)  # MuJoCo has no presliding
def test_it_moves_an_arm_of_mujoco(built):
    """Another dynamics engine, whose dry friction is not the controller's."""
    mujoco = pytest.importorskip("mujoco")
    fit, folder = built
    model = mujoco.MjModel.from_xml_string(mjcf_text(fit)[0])
    model.opt.timestep = 1e-3
    data, plug_in = mujoco.MjData(model), ctypes.CDLL(str(folder / "libidentified_arm_c.so"))
    limit = fit.model.robot.limit("torque")
    effort, zero = np.zeros(2), np.zeros(2)
    start = plug_in.controller_start
    start.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double]
    assert start(pointer(zero), pointer(zero), 0.1) == 0

    def follow(reference, seconds):
        errors = []
        for k in range(int(seconds * 1000)):
            q, dq, ddq = (np.ascontiguousarray(x, dtype=float) for x in reference(1e-3 * k))
            plug_in.controller_reference(pointer(q), pointer(dq), pointer(ddq))
            here = data.qpos.copy(), data.qvel.copy()
            assert plug_in.controller_update(*map(pointer, here), pointer(effort)) == 0
            assert np.all(np.abs(effort) <= limit)
            errors.append(np.abs(here[0] - q).max())
            data.ctrl[:] = effort
            mujoco.mj_step(model, data)
        return errors

    def swing(t):
        size, w = np.array([0.4, -0.6]), 2.0
        return size * (1 - np.cos(w * t)), size * w * np.sin(w * t), size * w**2 * np.cos(w * t)

    assert max(follow(swing, 3.0)) < 0.02
    jumped = follow(lambda t: (np.array([1.0, 0.5]), zero, zero), 2.0)
    assert jumped[-1] < 5e-3
    here, broken = data.qpos.copy(), np.array([np.nan, 0.0])
    assert plug_in.controller_update(pointer(here), pointer(broken), pointer(effort)) == 1
    gravity = lieid.symbolic(fit).gravity(here).full().ravel()
    np.testing.assert_allclose(effort, gravity, atol=1e-6)


def test_the_guide_lists_every_parameter():
    ((_, tree),) = yaml.safe_load(
        (FOLDER / "src" / "identified_arm_parameters.yaml").read_text()
    ).items()
    guide = (FOLDER.parents[1] / "docs" / "guides" / "ros2_control.md").read_text()
    for name, content in tree.items():
        for member in (name,) if "type" in content else (f"{name}.{x}" for x in content):
            assert f"`{member}`" in guide, member


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


@pytest.mark.parametrize("name", list(C_ARMS))
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_controller_builds_with_any_arm(tmp_path, name, compiler):
    export(C_ARMS[name](), tmp_path / "arm", to="c")
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
