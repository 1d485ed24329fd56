"""No compiler, a failing one, a hanging one: the same results, and one notice."""

import os
import stat
import time

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi.compiled import compile
from lieid_casadi.compiled import compiler as compiler_module
from lieid_casadi.compiled.batch_evaluation import MachineEvaluation
from lieid_casadi.compiled.compiler import available_targets, build, find_compiler

Q = np.linspace(-1.0, 1.0, 40).reshape(20, 2)
MODEL = lieid.Model(lieid.robots.two_link(), effects="coulomb,viscous")


def program(path, text):
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


def check_fallback(caplog, *expected):
    """The whole interface works, and one warning states why it is slow and what to do."""
    arm = compile(MODEL)
    regressor = arm.regressor(Q, Q, Q, out=np.full((20, 2, 20), np.nan), threads=2)
    links = MODEL.robot.link_parameters
    torque = arm.inverse_dynamics(Q, Q, Q, links)
    np.testing.assert_allclose(regressor @ links, torque, rtol=1e-12, atol=1e-12)
    whole = arm.base_regressor(Q, Q, Q)
    blocks = arm.base_blocks(Q, Q, Q, size=7)
    joints = blocks.evaluate(7, 12, blocks.buffer())
    np.testing.assert_array_equal(joints[0].T, whole[7:12, 0][:, whole[:, 0].any(axis=0)])
    assert isinstance(arm._evaluation("regressor"), MachineEvaluation)
    compile(lieid.Model(lieid.robots.two_link())).jacobian(Q)
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
    monkeypatch.setattr(compiler_module, "TIMEOUT", 0.5)
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
