"""Exported C builds without warnings, on ARM too, and its self-test passes and finds errors."""

import ctypes
import dataclasses
import re
import shutil
import subprocess

import numpy as np
import pytest
from exporters.c_arms import (
    ARMS,
    BUILDS,
    WARNINGS,
    constants,
    library,
    made_fit,
    pointer,
    run,
    sample_type,
)
from real_arms import TX40, UR10E, needs

import lieid_casadi as lieid
from lieid_casadi.cli.main import main
from lieid_casadi.exporters.export import export


@pytest.fixture(scope="module", params=list(ARMS))
def exported(request, tmp_path_factory):
    fit, folder = ARMS[request.param](), tmp_path_factory.mktemp("c") / request.param
    export(fit, folder, to="c")
    return folder


def files(folder, prefix="arm"):
    return [f"{prefix}{ending}.c" for ending in ("", "_parameters", "_test")]


# the largest and the smallest arm, by further compilers: what they add is the compilers' own
SLOW_BUILDS = {
    "panda": set(BUILDS),
    "sliding": {"gcc", "g++", "clang++", "sanitizers"},
    "presliding": {"clang", "clang++"},
    "rigid": set(BUILDS),
}


ARM_BUILDS = [
    pytest.param(
        arm,
        build,
        marks=pytest.mark.slow if build in SLOW_BUILDS.get(arm, ()) else (),
        id=f"{arm}-{build}",
    )
    for arm in ARMS
    for build in BUILDS
]


@pytest.mark.parametrize(("exported", "build"), ARM_BUILDS, indirect=["exported"])
def test_strict_build_agrees_with_python(exported, build):
    command = [*BUILDS[build], *WARNINGS, *files(exported), "-lm", "-o", "selftest"]
    run(command, exported)
    shown = run([str(exported / "selftest")], exported)
    assert shown.endswith("0 of the above differ by more than 1e-12\n")
    assert shown.count("ok\n") == len(shown.splitlines()) - 1 >= 15


@pytest.mark.parametrize("exported", ["presliding"], indirect=True)
def test_cmake_builds_and_tests(exported):
    run(["cmake", "-S", ".", "-B", "build"], exported)
    run(["cmake", "--build", "build"], exported)
    shown = run(["ctest", "--test-dir", "build", "--output-on-failure"], exported)
    assert "100% tests passed" in shown


def test_the_self_test_finds_an_altered_statement(tmp_path):
    """A product is a sum, in one of five statements spread over all functions of the C file."""
    export(made_fit(lieid.robots.two_link(), "coulomb,viscous,presliding:1"), tmp_path, to="c")
    text = (tmp_path / "arm.c").read_text()
    statements = list(re.finditer(r"^ {4}[^;]* \* [^;]*;$", text, re.M))
    assert len(statements) > 100
    for k in range(5):
        one = statements[(2 * k + 1) * len(statements) // 10]
        other = one[0].replace(" * ", " + ", 1)
        (tmp_path / "arm.c").write_text(text[: one.start()] + other + text[one.end() :])
        run(["gcc", "-std=c99", *files(tmp_path), "-lm", "-o", "t"], tmp_path)
        done = subprocess.run([tmp_path / "t"], capture_output=True, text=True)
        assert done.returncode == 1, one[0]
        assert "DIFFERS" in done.stdout


def test_two_arms_in_one_program(tmp_path):
    for name, arm in (("left", "presliding"), ("right", "sliding")):
        export(ARMS[arm](), tmp_path / name, prefix=name, to="c")
        for file in (f"{name}.c", f"{name}_parameters.c", f"{name}.h", "lieid_runtime.h"):
            shutil.copy(tmp_path / name / file, tmp_path)
    (tmp_path / "main.c").write_text(
        '#include "left.h"\n#include "right.h"\n'
        "int main(void) { return LEFT_JOINTS == 2 && RIGHT_JOINTS == 4 ? 0 : 1; }\n"
    )
    sources = ["main.c", "left.c", "left_parameters.c", "right.c", "right_parameters.c"]
    run(["gcc", "-std=c99", *WARNINGS, *sources, "-lm", "-o", "both"], tmp_path)
    run([str(tmp_path / "both")], tmp_path)


def test_names_stay_inside_comments(tmp_path):
    evil = "*/ #error \\"
    robot = lieid.robots.two_link()
    joints = [dataclasses.replace(j, name=f"{evil}\n/* ??/ \u202e{j.name}") for j in robot.joints]
    robot = dataclasses.replace(robot, name=f"{evil}\r\nint x;", joints=tuple(joints))
    fit = made_fit(robot, "coulomb")
    sources = [dataclasses.replace(s, name=evil) for s in fit.provenance.recordings]
    own = dataclasses.replace(fit.provenance, recordings=tuple(sources))
    export(dataclasses.replace(fit, provenance=own), tmp_path / "arm", to="c")
    assert "\u202e" not in (tmp_path / "arm" / "arm.h").read_text()
    for build in ("gcc", "g++"):
        run([*BUILDS[build], *WARNINGS, *files(tmp_path), "-lm", "-o", "t"], tmp_path / "arm")


@pytest.mark.real
@pytest.mark.parametrize(
    "urdf",
    [
        pytest.param(UR10E / "ur10e.urdf", marks=needs(UR10E / "ur10e.urdf")),
        pytest.param(TX40 / "tx40.urdf", marks=[needs(TX40 / "tx40.urdf"), pytest.mark.slow]),
    ],
    ids=["ur10e", "tx40"],
)
def test_real_arms_geometry_with_its_rounding(urdf, tmp_path):
    """Where axes are parallel but for rounding, fewer parameters would give another torque."""
    robot = lieid.Robot.from_urdf(urdf)
    export(made_fit(robot, "coulomb,viscous,offset"), tmp_path / "arm", to="c")
    run(["gcc", "-std=c99", *files(tmp_path), "-lm", "-o", "t"], tmp_path / "arm")
    run([str(tmp_path / "arm" / "t")], tmp_path / "arm")


def test_names_and_limits_of_the_joints(tmp_path):
    """Also of a name that is no literal of C, and where the robot states no limit."""
    robot, name = lieid.robots.two_link(), 'a"\\é??/\n'
    unknown = dict.fromkeys(("torque", "position_lower", "position_upper"), np.nan)
    limits = dataclasses.replace(robot.joints[0].limits, **unknown)
    joints = [dataclasses.replace(robot.joints[0], name=name, limits=limits), robot.joints[1]]
    fit = made_fit(dataclasses.replace(robot, joints=tuple(joints)), "viscous")
    export(fit, tmp_path / "arm", to="c")
    loaded = library(tmp_path / "arm")
    size = len(name.encode()) + 1
    names = (ctypes.c_char * (2 * size)).in_dll(loaded, "arm_joint_names").raw
    assert [names[k : k + size].rstrip(b"\0").decode() for k in (0, size)] == [name, "elbow"]
    assert constants(loaded, "arm_torque_limit", 2).tolist() == [np.inf, 15.0]
    assert constants(loaded, "arm_position_lower", 2).tolist() == [-np.inf, -2.5]
    assert constants(loaded, "arm_position_upper", 2).tolist() == [np.inf, 2.5]
    assert constants(loaded, "arm_velocity_limit", 2).tolist() == [3.0, 3.0]


SOURCES = ["arm.c", "arm_parameters.c", "arm_test.c"]
PAYLOAD = np.array([0.8, 0.01, -0.02, 0.03, 4e-3, 1e-4, 5e-3, -2e-4, 1e-4, 3e-3])


def self_test(folder, build, runner=()):
    run([*build, *WARNINGS, *SOURCES, "-lm", "-o", "selftest"], folder)
    return run([*runner, str(folder / "selftest")], folder)


@pytest.mark.parametrize(
    ("arm", "build"),
    [
        ("presliding", "gcc"),
        pytest.param("rigid", "g++", marks=pytest.mark.slow),
        pytest.param("presliding", "sanitizers", marks=pytest.mark.slow),
    ],
)
def test_self_test_passes(arm, build, tmp_path):
    export(ARMS[arm](), tmp_path / "arm", payload=True, to="c")
    shown = self_test(tmp_path / "arm", BUILDS[build])
    assert shown.endswith("0 of the above differ by more than 1e-12\n")
    assert "nominal payload" in shown


class Numbers(ctypes.Structure):
    _fields_ = (("payload", ctypes.c_double * 10),)


def test_dynamics_with_a_payload_are_those_of_symbolic(tmp_path):
    """Inverse and forward dynamics, without and with a body at the tool, in one build."""
    fit = made_fit(lieid.robots.two_link(), "coulomb,viscous,armature,stribeck:2")
    fit.save(tmp_path / "fit.json")
    words = ["export", str(tmp_path / "fit.json"), "-o", str(tmp_path / "arm"), "--payload"]
    assert main([*words, "--to", "c"]) == 0
    c, dynamics = library(tmp_path / "arm"), lieid.symbolic(fit.model, free=["payload"])
    numbers, random = Numbers(), np.random.default_rng(2)
    c.arm_nominal(ctypes.byref(numbers))
    own = {"parameters": fit.link_parameters, "effects": fit.effect_coefficients}
    for payload in (np.zeros(10), PAYLOAD):
        if payload.any():
            numbers.payload[:] = payload.tolist()
        np.testing.assert_array_equal(numbers.payload, payload)
        q, dq, ddq = random.uniform(-1.0, 1.0, (3, 2))
        tau = dynamics.inverse_dynamics(
            q=q, dq=dq, ddq=ddq, **own, shapes=fit.shapes, payload=payload
        )["tau"].full()[:, 0]
        s, torque, found = sample_type(2)(), np.full(2, np.nan), np.full(2, np.nan)
        s.q[:], s.dq[:], s.ddq[:] = q.tolist(), dq.tolist(), ddq.tolist()
        given = ctypes.byref(s), None, None, ctypes.byref(numbers)
        c.arm_torque(*given, pointer(torque))
        np.testing.assert_allclose(torque, tau, rtol=1e-11)
        c.arm_forward_dynamics(given[0], pointer(tau), *given[1:], pointer(found))
        np.testing.assert_allclose(found, ddq, atol=1e-9)


PROCESSORS = {
    "aarch64 gcc": ("aarch64-linux-gnu-gcc", "qemu-aarch64"),
    "32 bit gcc": ("arm-linux-gnueabihf-gcc", "qemu-arm"),
}


@pytest.mark.parametrize(
    "build", ["32 bit gcc", pytest.param("aarch64 gcc", marks=pytest.mark.slow)]
)
def test_self_test_passes_on_arm(build, tmp_path):
    """Robot controllers often have ARM processors, whose compilers fuse products and sums."""
    compiler, machine = PROCESSORS[build]
    export(ARMS["presliding"](), tmp_path / "arm", to="c")
    shown = self_test(tmp_path / "arm", [compiler, "-std=gnu99", "-O2", "-static"], [machine])
    assert shown.splitlines()[-1].startswith("0 of the above differ")
