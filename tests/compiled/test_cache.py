"""Compiled libraries between runs, never half-written; the same results without a compiler."""

import os
import stat
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi.compiled import cache, compile, kernels
from lieid_casadi.compiled.batch_evaluation import CompiledEvaluation, MachineEvaluation
from lieid_casadi.compiled.kernels import available_targets, build, find_compiler

pytestmark = pytest.mark.usefixtures("compiler")

Q = np.linspace(-1.0, 1.0, 20).reshape(10, 2)
ROOT = Path(lieid.__file__).parents[1]


def two_link(**keywords):
    return compile(lieid.Model(lieid.robots.two_link()), **keywords)


def gravity(arm):
    return arm.gravity(Q, arm.model.robot.link_parameters)


def libraries(folder):
    return {path.name: path.read_bytes() for path in folder.glob("*.so")}


def forget(monkeypatch):
    """Continue as another process would."""
    monkeypatch.setattr(kernels, "_libraries", {})


def test_a_second_run_finds_what_the_first_one_compiled(fresh_process, monkeypatch):
    expected = gravity(two_link())
    assert len(libraries(fresh_process)) == 2  # the function, and the runtime
    forget(monkeypatch)
    monkeypatch.setattr(kernels, "build", None)  # a call of the compiler would fail
    monkeypatch.setattr(kernels, "kernel_source", None)  # nothing is derived either
    arm = two_link()
    np.testing.assert_array_equal(gravity(arm), expected)
    assert isinstance(arm._evaluation("gravity"), CompiledEvaluation)


def test_another_robot_or_instruction_set_is_another_library(fresh_process):
    expected = gravity(two_link())
    robot = lieid.robots.two_link()
    tilted = lieid.Robot(robot.name, robot.joints, np.array([1.0, 0.0, -9.0]), robot.tool)
    other = compile(lieid.Model(tilted))
    assert np.abs(gravity(other) - expected).max() > 0.1
    gravity(two_link(lanes=1))
    assert len(libraries(fresh_process)) >= 3


@pytest.mark.slow
def test_two_processes_may_compile_at_once(tmp_path):
    script = (
        "import numpy as np, lieid_casadi as lieid\n"
        "model = lieid.Model(lieid.robots.two_link(), effects=['coulomb', 'stribeck'])\n"
        "arm = lieid.compile(model)\n"
        "q = np.linspace(-1, 1, 20).reshape(10, 2)\n"
        "print(repr(float(arm.base_regressor(q, q, q).sum())),"
        " type(arm._evaluation('base_regressor')).__name__)\n"
    )
    environment = os.environ | {"LIEID_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(ROOT)}
    running = [
        subprocess.Popen(
            [sys.executable, "-c", script], env=environment, text=True, stdout=subprocess.PIPE
        )
        for _ in range(2)
    ]
    printed = [process.communicate()[0].split() for process in running]
    assert printed[0] == printed[1]
    assert printed[0][1] == "CompiledEvaluation"
    assert len(libraries(tmp_path)) == 3


def test_a_cache_that_cannot_be_written_gives_one_notice(fresh_process, caplog):
    fresh_process.write_text("a file where the folder should be")
    arm = two_link()
    gravity(arm)
    arm.jacobian(Q)
    assert isinstance(arm._evaluation("gravity"), CompiledEvaluation)
    (notice,) = [r.message for r in caplog.records if r.name == "lieid_casadi"]
    assert str(fresh_process) in notice
    assert "LIEID_CACHE_DIR" in notice
    assert fresh_process.read_text() == "a file where the folder should be"


def test_the_oldest_libraries_are_deleted(fresh_process, monkeypatch):
    monkeypatch.setattr(cache, "KEEP", 4)
    fresh_process.mkdir()
    for age in range(10):
        path = fresh_process / f"{age}.so"
        path.write_bytes(b"old")
        os.utime(path, (1000 - age, 1000 - age))
    path = cache.store("new", b"library")
    assert path.is_file()
    assert sorted(libraries(fresh_process)) == ["0.so", "new.so"]


@pytest.mark.parametrize(
    ("variables", "folder"),
    [
        ({"LIEID_CACHE_DIR": "/a/b", "XDG_CACHE_HOME": "/x"}, "/a/b"),
        ({"XDG_CACHE_HOME": "/x"}, "/x/lieid-casadi"),
        ({"HOME": "/home/me"}, "/home/me/.cache/lieid-casadi"),
        ({"XDG_CACHE_HOME": "x/y", "HOME": "/home/me"}, "/home/me/.cache/lieid-casadi"),
        ({"LIEID_CACHE_DIR": "."}, os.getcwd()),
        ({"HOME": "relative/home"}, f"/temporary/lieid-casadi-{os.geteuid()}"),
    ],
)
def test_where_the_cache_is(monkeypatch, variables, folder):
    monkeypatch.setattr(cache.tempfile, "tempdir", "/temporary")
    for name in ("LIEID_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert cache.cache_folder() == Path(folder)


def test_a_folder_that_others_may_write_to_is_not_used(fresh_process, monkeypatch, caplog):
    expected = gravity(two_link())
    forget(monkeypatch)
    fresh_process.chmod(0o770)
    loaded, load = [], kernels.load_kernel
    monkeypatch.setattr(kernels, "load_kernel", lambda path: loaded.append(path) or load(path))
    np.testing.assert_array_equal(gravity(two_link()), expected)
    assert len(loaded) == 1
    assert fresh_process not in loaded[0].parents
    assert "others may write to it" in caplog.text


def test_a_library_that_others_may_write_to_is_built_again(fresh_process, monkeypatch):
    expected = gravity(two_link())
    for path in fresh_process.glob("*.so"):
        path.chmod(0o702)
        assert cache.find(path.stem) is None
    forget(monkeypatch)
    np.testing.assert_array_equal(gravity(two_link()), expected)
    assert all(cache.find(path.stem) == path for path in fresh_process.glob("*.so"))


def test_files_of_another_user_are_not_loaded(fresh_process, monkeypatch, caplog):
    gravity(two_link())
    (path, *_) = fresh_process.glob("*.so")
    owner = os.geteuid()
    monkeypatch.setattr(cache.os, "geteuid", lambda: owner + 1)
    assert cache.find(path.stem) is None
    with pytest.raises(PermissionError):  # nor are the temporary files this user's
        cache.store(path.stem, b"library")
    assert f"it belongs to user {owner}" in caplog.text


def test_a_library_that_cannot_be_used_is_built_once(fresh_process, monkeypatch, tmp_path):
    expected = gravity(two_link())
    names = libraries(fresh_process)
    # another path: the system's loader returns a path that is open in this process again
    monkeypatch.setenv("LIEID_CACHE_DIR", str(tmp_path / "other-cache"))
    for name in names:
        cache.store(Path(name).stem, b"not a library")
    forget(monkeypatch)
    built, build = [], kernels.build
    monkeypatch.setattr(kernels, "build", lambda *a: built.append(a) or build(*a))
    for _ in range(2):  # the second time the new libraries are in the cache
        arm = two_link()
        np.testing.assert_array_equal(gravity(arm), expected)
        assert isinstance(arm._evaluation("gravity"), CompiledEvaluation)
        forget(monkeypatch)
    assert len(built) == len(names)


ANGLES = np.linspace(-1.0, 1.0, 40).reshape(20, 2)
FRICTION = lieid.Model(lieid.robots.two_link(), effects="coulomb,viscous")


def program(path, text):
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


def check_fallback(caplog, *expected):
    """The whole interface works, and one warning states why it is slow and what to do."""
    arm = compile(FRICTION)
    regressor = arm.regressor(ANGLES, ANGLES, ANGLES, out=np.full((20, 2, 20), np.nan), threads=2)
    links = FRICTION.robot.link_parameters
    torque = arm.inverse_dynamics(ANGLES, ANGLES, ANGLES, links)
    np.testing.assert_allclose(regressor @ links, torque, rtol=1e-12, atol=1e-12)
    whole = arm.base_regressor(ANGLES, ANGLES, ANGLES)
    blocks = arm.base_blocks(ANGLES, ANGLES, ANGLES, size=7)
    joints = blocks.evaluate(7, 12, blocks.buffer())
    np.testing.assert_array_equal(joints[0].T, whole[7:12, 0][:, whole[:, 0].any(axis=0)])
    assert isinstance(arm._evaluation("regressor"), MachineEvaluation)
    compile(lieid.Model(lieid.robots.two_link())).jacobian(ANGLES)
    notices = [r.getMessage() for r in caplog.records if r.name == "lieid_casadi"]
    assert len(notices) == 1
    for text in (*expected, "virtual machine", "Remedy: install a C compiler"):
        assert text in notices[0]


RUBBISH = 'while [ "$1" != -o ]; do shift; done; echo rubbish > "$2"'


@pytest.mark.parametrize(
    ("compiler", "script", "expected"),
    [
        (None, "", ["cc, gcc or clang is not on the path"]),
        ("no-such-compiler -m64", "", ["'no-such-compiler'"]),
        ("'gcc", "", ["$CC is"]),
        ("", "echo 'model.c:1: error: out of memory' >&2; exit 4", ["status 4", "out of memory"]),
        ("", RUBBISH, ["cannot be loaded"]),
    ],
)
def test_no_usable_compiler(
    fresh_process, monkeypatch, tmp_path, caplog, compiler, script, expected
):
    if compiler is None:
        monkeypatch.delenv("CC", raising=False)
        monkeypatch.setenv("PATH", str(tmp_path))
    else:
        monkeypatch.setenv("CC", program(tmp_path / "cc", script) if script else compiler)
    check_fallback(caplog, *expected)
    assert not list(fresh_process.glob("*.so"))


def test_a_hanging_compiler_ends_with_its_children(fresh_process, monkeypatch, tmp_path, caplog):
    child = tmp_path / "child"
    hanging = program(tmp_path / "cc", f"sleep 1000 & echo $! >> {child}; wait")
    monkeypatch.setenv("CC", hanging)
    monkeypatch.setattr(kernels, "TIMEOUT", 0.5)
    check_fallback(caplog, "did not finish within 0.5 s")
    for number in child.read_text().split():
        for _ in range(100):
            if not is_alive(int(number)):
                break
            time.sleep(0.02)
        assert not is_alive(int(number))


def is_alive(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    try:  # a zombie that nobody has collected yet is dead
        with open(f"/proc/{process}/stat") as status:
            return status.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_cc_chooses_the_compiler_with_its_options(monkeypatch, tmp_path, compiler):
    log = tmp_path / "log"
    real = compiler.command[0]
    monkeypatch.setenv("CC", program(tmp_path / "wrap", f'echo "$1" >> {log}; shift; {real} "$@"'))
    monkeypatch.setenv("CC", f"{os.environ['CC']} first-option")
    found = find_compiler()
    assert found.identity != compiler.identity
    source = tmp_path / "empty.c"
    source.write_text("int nothing;\n")
    build(found, available_targets()[-1], source, tmp_path / "empty.so", tmp_path)
    assert log.read_text() == "first-option\n"
