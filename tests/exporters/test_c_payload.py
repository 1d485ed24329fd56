"""Exported C with a payload that may change at run time, and on ARM."""

import ctypes

import numpy as np
import pytest
from exporters.c_arms import ARMS, BUILDS, WARNINGS, library, made_fit, pointer, run, sample_type

import lieid_casadi as lieid
from lieid_casadi.cli.main import main
from lieid_casadi.exporters.export import export

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


ARM_BUILDS = {
    "aarch64 gcc": ("aarch64-linux-gnu-gcc", "qemu-aarch64"),
    "32 bit gcc": ("arm-linux-gnueabihf-gcc", "qemu-arm"),
}


@pytest.mark.parametrize(
    "build", ["32 bit gcc", pytest.param("aarch64 gcc", marks=pytest.mark.slow)]
)
def test_self_test_passes_on_arm(build, tmp_path):
    """Robot controllers often have ARM processors, whose compilers fuse products and sums."""
    compiler, machine = ARM_BUILDS[build]
    export(ARMS["presliding"](), tmp_path / "arm", to="c")
    shown = self_test(tmp_path / "arm", [compiler, "-std=gnu99", "-O2", "-static"], [machine])
    assert shown.splitlines()[-1].startswith("0 of the above differ")
