"""Exported C with numbers that may change at run time, and on ARM."""

import ctypes

import numpy as np
import pytest
from exporters.c_arms import ARMS, BUILDS, WARNINGS, library, made_fit, pointer, run, sample_type

import lieid_casadi as lieid
from lieid_casadi.cli.main import main
from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.export import export

SOURCES = ["arm.c", "arm_parameters.c", "arm_test.c"]
BOTH = ("payload", "parameters")
PAYLOAD = np.array([0.8, 0.01, -0.02, 0.03, 4e-3, 1e-4, 5e-3, -2e-4, 1e-4, 3e-3])


def self_test(folder, build, runner=()):
    run([*build, *WARNINGS, *SOURCES, "-lm", "-o", "selftest"], folder)
    return run([*runner, str(folder / "selftest")], folder)


CASES = [  # arm, run-time numbers, compiler
    ("presliding", BOTH, "gcc"),
    ("rigid", ("payload",), "g++"),
    *(
        pytest.param(*case, marks=pytest.mark.slow)
        for case in (
            ("presliding", BOTH, "sanitizers"),
            ("rigid", ("parameters",), "clang"),
            ("panda", BOTH, "gcc"),
        )
    ),
]


@pytest.mark.parametrize(("arm", "runtime", "build"), CASES)
def test_self_test_passes(arm, runtime, build, tmp_path):
    export(ARMS[arm](), tmp_path / "arm", runtime=runtime, to="c")
    shown = self_test(tmp_path / "arm", BUILDS[build])
    assert shown.endswith("0 of the above differ by more than 1e-12\n")
    assert "nominal" in shown


class Numbers:
    """Functions of an export with run-time numbers."""

    def __init__(self, fit, folder):
        export(fit, folder, runtime=BOTH, to="c")
        model = fit.model
        sizes = {
            "link_parameters": 10 * model.n,
            "effect_coefficients": len(model.columns),
            "shapes": len(model.shapes),
            "payload": 10,
        }
        fields = [(name, ctypes.c_double * size) for name, size in sizes.items() if size]
        self.type = type("Numbers", (ctypes.Structure,), {"_fields_": fields})
        self.c, self.sample, self.n = library(folder), sample_type(model.n), model.n

    def torque(self, numbers, q, dq, ddq):
        s, out = self.sample(), np.full(self.n, np.nan)
        s.q[:], s.dq[:], s.ddq[:] = q.tolist(), dq.tolist(), ddq.tolist()
        state = ctypes.create_string_buffer(4096)
        self.c.arm_torque(ctypes.byref(s), state, None, ctypes.byref(numbers), pointer(out))
        return out

    def acceleration(self, numbers, q, dq, tau):
        s, out = self.sample(), np.full(self.n, np.nan)
        s.q[:], s.dq[:] = q.tolist(), dq.tolist()
        self.c.arm_forward_dynamics(
            ctypes.byref(s), pointer(tau), None, None, ctypes.byref(numbers), pointer(out)
        )
        return out


def test_numbers_are_those_of_symbolic(tmp_path):
    """Nominal and changed link parameters, coefficients, shapes and payload in one build."""
    fit = made_fit(lieid.robots.two_link(), "coulomb,viscous,armature,stribeck:2")
    exported, dynamics = (
        Numbers(fit, tmp_path / "arm"),
        lieid.symbolic(fit.model, free=["payload"]),
    )
    numbers, random = exported.type(), np.random.default_rng(2)
    exported.c.arm_nominal(ctypes.byref(numbers))
    assert list(numbers.payload) == [0.0] * 10
    for scale, payload in ((1.0, np.zeros(10)), (1.3, PAYLOAD)):
        values = {
            "parameters": scale * fit.link_parameters,
            "effects": scale * fit.effect_coefficients,
            "shapes": scale * fit.shapes,
            "payload": payload,
        }
        for field, name in (
            ("link_parameters", "parameters"), ("effect_coefficients", "effects"),
            ("shapes", "shapes"), ("payload", "payload"),
        ):  # fmt: skip
            if scale != 1.0:
                getattr(numbers, field)[:] = values[name].tolist()
            np.testing.assert_array_equal(getattr(numbers, field), values[name])
        q, dq, ddq = random.uniform(-1.0, 1.0, (3, 2))
        tau = dynamics.inverse_dynamics(q=q, dq=dq, ddq=ddq, **values)["tau"].full()[:, 0]
        np.testing.assert_allclose(exported.torque(numbers, q, dq, ddq), tau, rtol=1e-11)
        np.testing.assert_allclose(exported.acceleration(numbers, q, dq, tau), ddq, atol=1e-9)


def test_a_payload_alone_leaves_the_other_numbers_constant(tmp_path):
    fit = ARMS["rigid"]()
    export(fit, tmp_path / "arm", runtime=["payload"], to="c")
    header = (tmp_path / "arm" / "arm.h").read_text()
    struct = header[header.index("typedef struct") : header.index("} arm_numbers;")]
    assert "payload[10]" in struct
    assert "link_parameters[" not in struct
    assert "arm_jacobian(const double q[ARM_JOINTS], double matrix" in header


def test_kinematics_alone_have_no_numbers(tmp_path):
    made = export(
        ARMS["rigid"](), tmp_path / "arm", functions=["jacobian"], runtime=["payload"], to="c"
    )
    assert any("payload: no function depends on it" in note for note in made.notes)
    assert "arm_numbers" not in (tmp_path / "arm" / "arm.h").read_text()
    assert "jacobian" in self_test(tmp_path / "arm", BUILDS["gcc"])


def test_an_unknown_name_is_refused(tmp_path, capsys):
    fit = ARMS["rigid"]()
    with pytest.raises(ExportError, match="runtime: got 'mass'; expected some of payload, param"):
        export(fit, tmp_path / "arm", runtime=["mass"], to="c")
    fit.save(tmp_path / "fit.json")
    command = ["export", str(tmp_path / "fit.json"), "-o", str(tmp_path / "out")]
    assert main([*command, "--to", "c", "--runtime", "mass"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "out").exists()
    assert main([*command, "--to", "c", "--runtime", "payload"]) == 0
    assert "arm_nominal" in (tmp_path / "out" / "arm.h").read_text()


ARM_BUILDS = {
    "aarch64 gcc": (("aarch64-linux-gnu-gcc", "-static"), "qemu-aarch64"),
    "aarch64 clang": (("clang", "--target=aarch64-linux-gnu", "-static"), "qemu-aarch64"),
    "32 bit gcc": (("arm-linux-gnueabihf-gcc", "-static"), "qemu-arm"),
}


@pytest.mark.parametrize(
    "build",
    [
        "32 bit gcc",
        *(pytest.param(build, marks=pytest.mark.slow) for build in list(ARM_BUILDS)[:2]),
    ],
)
def test_self_test_passes_on_arm(build, tmp_path):
    """Robot controllers often have ARM processors, whose compilers fuse products and sums."""
    (compiler, *options), machine = ARM_BUILDS[build]
    export(ARMS["presliding"](), tmp_path / "arm", to="c")
    shown = self_test(tmp_path / "arm", [compiler, "-std=gnu99", "-O2", *options], [machine])
    assert shown.splitlines()[-1].startswith("0 of the above differ")
