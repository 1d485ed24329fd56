"""Exported C against Pinocchio, the compiled batches and NumPy: nothing of its own making."""

import ctypes
import dataclasses
import re

import numpy as np
import pinocchio as pin
import pytest
from exporters.c_arms import ARMS, constants, library, made_fit, pointer, run, sample_type
from robot.random_arms import random_arm

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.cli.main import main
from lieid_casadi.codegen_files import codegen_folder
from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.export import export
from lieid_casadi.plant import build_pinocchio

ROWS = 30


class Exported:
    """Functions of an exported arm, on arrays."""

    def __init__(self, fit, folder):
        export(fit, folder, to="c")
        self.fit, self.n, self.folder, self.c = fit, fit.model.n, folder, library(folder)
        self.sample = sample_type(self.n)
        self.state = ctypes.create_string_buffer(4096)

    def rigid(self, name, columns, *arrays):
        result = np.full((len(arrays[0]), self.n, columns), np.nan)
        for k, out in enumerate(result):
            getattr(self.c, f"arm_{name}")(*(pointer(a[k]) for a in arrays), pointer(out))
        return result

    def along(self, motion, columns, *, smooth_velocity=None, load=None):
        """Results (N, n, columns[name]) along a motion, one cycle after the other."""
        smooth_velocity = None if smooth_velocity is None else pointer(smooth_velocity)
        self.c.arm_begin(self.state)
        results = {name: [] for name in columns}
        for k in range(len(motion["q"])):
            row = {name: values[k] for name, values in motion.items()}
            s = self.sample()
            for name in ("q", "dq", "ddq", "temperature"):
                getattr(s, name)[:] = row[name].tolist()
            s.time = float(row["time"])
            self.c.arm_advance(self.state, ctypes.byref(s), smooth_velocity)
            for name, width in columns.items():
                out = np.full((self.n, width), np.nan)
                given = [] if name == "torque" else [pointer(load[k])]
                function = getattr(self.c, f"arm_{name}")
                function(ctypes.byref(s), *given, self.state, smooth_velocity, pointer(out))
                results[name].append(out)
        return {name: np.array(values) for name, values in results.items()}


@pytest.fixture(scope="module", params=["panda", "sliding", "presliding"])
def arm(request, tmp_path_factory):
    return Exported(ARMS[request.param](), tmp_path_factory.mktemp("values") / "arm")


LIBM = {"sin", "cos", "exp", "tanh", "fabs", "sqrt"}
COPIES = {"memcpy", "memset"}  # of structs and small arrays; no part of libm


def test_symbols_are_functions_and_constants_and_few_of_libm(arm):
    for name in ("arm", "arm_parameters"):
        command = ["gcc", "-std=c99", "-O0", "-fno-builtin", "-c", f"{name}.c", "-o", f"{name}.o"]
        run(command, arm.folder)
        kinds = set(re.findall(r"^[0-9a-f]+ (\w) ", run(["nm", f"{name}.o"], arm.folder), re.M))
        assert kinds <= set("TtRr")
    needed = set(re.findall(r"U (\w+)", run(["nm", "-u", "arm.o"], arm.folder)))
    assert needed - COPIES <= LIBM
    assert {"sin", "cos"} <= needed


@pytest.fixture
def motion(arm):
    random, n = np.random.default_rng(5), arm.n
    time = np.cumsum(random.uniform(1e-3, 5e-2, ROWS))
    angle = 6.0 * time[:, None] + random.uniform(-3, 3, n)
    return {
        "q": 0.3 * np.sin(angle),
        "dq": 1.8 * np.cos(angle),
        "ddq": -10.8 * np.sin(angle),
        "temperature": random.uniform(20.0, 50.0, (ROWS, n)),
        "time": time - time[0],
    }


def close(a, b, tolerance=1e-12):
    np.testing.assert_allclose(a, b, rtol=0.0, atol=tolerance * max(1.0, np.abs(b).max()))


def with_parameters(fit):
    return build_pinocchio(fit.model.robot, fit.link_parameters)


def test_rigid_body_is_pinocchios(arm, motion):
    model = with_parameters(arm.fit)
    data, (q, dq, ddq) = model.createData(), (motion[k] for k in ("q", "dq", "ddq"))
    torque = arm.rigid("rigid_torque", 1, q, dq, ddq)[:, :, 0]
    gravity = arm.rigid("gravity", 1, q)[:, :, 0]
    links, mass = (arm.rigid(name, arm.n, q) for name in ("link_mass_matrix", "mass_matrix"))
    motors = np.zeros(arm.n)
    for c, value in zip(arm.fit.model.columns, arm.fit.effect_coefficients, strict=True):
        motors[c.joint] += value * (c.name == "armature.I_a")
    for k in range(ROWS):
        close(torque[k], pin.rnea(model, data, q[k], dq[k], ddq[k]), 1e-11)
        close(gravity[k], pin.computeGeneralizedGravity(model, data, q[k]), 1e-11)
        upper = np.triu(pin.crba(model, data, q[k]))
        close(links[k], upper + np.triu(upper, 1).T, 1e-11)
        close(mass[k], links[k] + np.diag(motors), 1e-11)


def test_coriolis_matrix_and_kinematics_are_pinocchios(arm, motion):
    model = with_parameters(arm.fit)
    data, (q, dq) = model.createData(), (motion[k] for k in ("q", "dq"))
    coriolis = arm.rigid("coriolis", arm.n, q, dq)
    pose = arm.rigid("forward_kinematics", 16, q)[:, 0].reshape(-1, 4, 4)  # one row of 16 numbers
    twists = arm.rigid("jacobian", 6, q).reshape(-1, 6, arm.n)
    tool = pin.SE3(arm.fit.model.robot.tool)
    for k in range(ROWS):
        close(
            coriolis[k] @ dq[k],
            pin.nle(model, data, q[k], dq[k]) - pin.computeGeneralizedGravity(model, data, q[k]),
            1e-11,
        )
        close(coriolis[k], pin.computeCoriolisMatrix(model, data, q[k], dq[k]), 1e-11)
        pin.computeJointJacobians(model, data, q[k])
        frame = data.oMi[arm.n] * tool
        close(pose[k], frame.homogeneous)
        linear, angular = np.split(
            data.oMi[arm.n].action @ pin.getJointJacobian(model, data, arm.n, pin.LOCAL), 2
        )
        at_tool = linear + np.cross(angular, frame.translation, axis=0)
        close(twists[k], np.vstack([angular, at_tool]))


def test_forward_dynamics_invert_the_torque(arm, motion):
    """Along a motion, with the states of effects with memory."""
    load = arm.rigid("rigid_torque", 1, *(motion[k] for k in ("q", "dq", "ddq")))[:, :, 0]
    torque = arm.along(motion, {"torque": 1})["torque"][:, :, 0]
    found = arm.along(motion, {"forward_dynamics": 1}, load=torque)["forward_dynamics"]
    assert load.shape == torque.shape
    np.testing.assert_allclose(found[:, :, 0], motion["ddq"], rtol=0.0, atol=1e-8)


def test_regressors_times_parameters_are_torques(arm, motion):
    model, links = with_parameters(arm.fit), constants(arm.c, "arm_link_parameters", 10 * arm.n)
    data, (q, dq, ddq) = model.createData(), (motion[k] for k in ("q", "dq", "ddq"))
    dq_r, ddq_r = np.random.default_rng(2).normal(size=(2, ROWS, arm.n))
    full = arm.rigid("regressor", 10 * arm.n, q, dq, ddq) @ links
    adaptive = arm.rigid("slotine_li_regressor", 10 * arm.n, q, dq, dq_r, ddq_r) @ links
    for k in range(ROWS):
        close(full[k], pin.rnea(model, data, q[k], dq[k], ddq[k]), 1e-11)
        upper = np.triu(pin.crba(model, data, q[k]))
        m = upper + np.triu(upper, 1).T
        c = pin.computeCoriolisMatrix(model, data, q[k], dq[k])
        g = pin.computeGeneralizedGravity(model, data, q[k])
        close(adaptive[k], m @ ddq_r[k] + c @ dq_r[k] + g, 1e-11)


def test_effects_are_those_of_the_batches(arm, motion):
    fit, compiled = arm.fit, lieid.compile(arm.fit.model)
    m, p = len(fit.model.columns), fit.model.base.count
    q, dq, ddq = (motion[k] for k in ("q", "dq", "ddq"))
    load = compiled.inverse_dynamics(q, dq, ddq, fit.link_parameters)
    mean = 0.0 if fit.temperature_mean is None else fit.temperature_mean
    signals = {
        "load": load,
        "temperature": motion["temperature"] - mean,
        "time": motion["time"],
        "shapes": fit.shapes,
    }
    widths = {"effect_torque": 1, "torque": 1, "effect_columns": m, "base_regressor": p}
    got = arm.along(motion, widths, load=load)
    columns = compiled.effect_columns(q, dq, ddq, **signals)
    close(got["effect_columns"], columns)
    close(got["base_regressor"], compiled.base_regressor(q, dq, ddq, **signals))
    close(got["effect_torque"][:, :, 0], columns @ fit.effect_coefficients)
    whole = load + columns @ fit.effect_coefficients
    close(got["torque"][:, :, 0], whole)
    # and the constants belong to the columns
    close(got["base_regressor"] @ constants(arm.c, "arm_base_parameters", p), whole, 1e-11)


def test_functions_and_their_sum_are_those_of_symbolic(arm, motion):
    """mass_matrix·q̈ + coriolis·q̇ + gravity + friction, also with the smooth sign."""
    width = np.full(arm.n, 0.5)
    q, dq, ddq = (motion[k] for k in ("q", "dq", "ddq"))
    load = arm.rigid("rigid_torque", 1, q, dq, ddq)[:, :, 0]
    widths = {"friction": 1, "torque": 1}
    mass, coriolis = arm.rigid("mass_matrix", arm.n, q), arm.rigid("coriolis", arm.n, q, dq)
    for smooth in (None, width):
        python = lieid.symbolic(arm.fit, smooth_velocity=smooth, allow_indefinite=True)
        got = arm.along(motion, widths, load=load, smooth_velocity=smooth)
        if python.model.states:
            continue  # the states of the C code are its own
        signals = {"temperature": motion["temperature"].T, "time": motion["time"][None]}
        further = [signals[name] for name in python.friction.name_in() if name in signals]
        given = [load.T] if "load" in python.friction.name_in() else []
        close(got["friction"][:, :, 0], python.friction(q.T, dq.T, *given, *further).full().T)
        close(arm.rigid("gravity", 1, q)[:, :, 0], python.gravity(q.T).full().T)
        for k in range(ROWS):
            parts = mass[k] @ ddq[k] + coriolis[k] @ dq[k] + python.gravity(q[k]).full().ravel()
            close(parts + got["friction"][k, :, 0], got["torque"][k, :, 0], 1e-11)
            close(mass[k], python.mass_matrix(q[k]).full())


def test_a_result_array_may_be_an_argument(arm, motion):
    apart = arm.rigid("rigid_torque", 1, motion["q"], motion["dq"], motion["ddq"])[0, :, 0]
    q, dq, ddq = (motion[k][0].copy() for k in ("q", "dq", "ddq"))
    arm.c.arm_rigid_torque(pointer(q), pointer(dq), pointer(ddq), pointer(q))
    assert (q == apart).all()


RUNTIME = {
    "lieid_expm1": (np.expm1, [-700.0, -3.0, -1.0, -0.5, -1e-9, 0.0, 1e-300, 1e-5, 0.7, 1.0, 30.0]),
    "lieid_log": (np.log, [5e-324, 1e-310, 1e-20, 0.3, 0.7071, 1.0, 1.0000001, 1.5, 4e9, 1e308]),
    "lieid_log1p": (np.log1p, [-0.999, -0.3, -1e-12, 0.0, 1e-17, 1e-8, 0.4, 1e5]),
    "lieid_tan": (np.tan, [-1.5, -0.1, 0.0, 1e-9, 0.8, 3.0]),
    "lieid_sinh": (np.sinh, [-5.0, -0.3, 0.0, 1e-12, 0.9, 20.0]),
    "lieid_cosh": (np.cosh, [-5.0, 0.0, 0.9, 20.0]),
    "lieid_atan": (np.arctan, [-1e300, -3.0, -1.3, -0.9, -0.5, -0.1, 0.0, 1e-9, 0.44, 0.69, 2.5]),
    "lieid_asin": (np.arcsin, [-1.0, -0.999999, -0.4, 0.0, 1e-9, 0.7, 1.0]),
    "lieid_acos": (np.arccos, [-1.0, -0.999999, -0.4, 0.0, 0.7, 0.99999]),
    "lieid_floor": (np.floor, [-2.5, -2.0, -0.1, 0.0, 0.9, 3.0, 1e300, -1e17]),
    "lieid_ceil": (np.ceil, [-2.5, -2.0, 0.0, 0.1, 0.9, 3.0, 1e300]),
    "lieid_sign": (np.sign, [-1e-300, -2.0, 0.0, 3.0]),
}
RUNTIME_PAIRS = {
    "lieid_pow": (np.power, [(0.3, 0.7), (2.0, -3.0), (-1.5, 3.0), (1e-6, 1.1), (7.0, 0.5),
                             (0.0, 0.4), (0.0, 0.0), (3.0, 100.0)]),
    "lieid_atan2": (np.arctan2, [(1.0, 2.0), (-1.0, -2.0), (1.0, 0.0), (-1.0, 0.0), (0.0, -1.0),
                                 (0.0, 0.0), (1e-9, -1.0), (3.0, 1e-300)]),
    "lieid_hypot": (np.hypot, [(3.0, 4.0), (1e200, 1e200), (0.0, 0.0), (1e-200, -2e-200)]),
    "lieid_fmin": (np.fmin, [(1.0, 2.0), (2.0, 1.0), (np.nan, 1.0), (1.0, np.nan)]),
    "lieid_fmax": (np.fmax, [(1.0, 2.0), (2.0, 1.0), (np.nan, 1.0), (1.0, np.nan)]),
    "lieid_copysign": (np.copysign, [(1.0, -0.0), (-2.0, 3.0), (2.0, -3.0)]),
}  # fmt: skip


@pytest.fixture(scope="module")
def runtime(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runtime")
    lines = ['#include "lieid_runtime.h"']
    lines += [f"double of_{f}(double x) {{ return {f}(x); }}" for f in RUNTIME]
    lines += [f"double of_{f}(double x, double y) {{ return {f}(x, y); }}" for f in RUNTIME_PAIRS]
    (folder / "r.c").write_text("\n".join(lines) + "\n")
    include = f"-I{codegen_folder() / 'export'}"
    run(["gcc", "-std=c99", "-O1", include, "-shared", "-fPIC", "r.c", "-lm", "-o", "r.so"], folder)
    return ctypes.CDLL(str(folder / "r.so"))


@pytest.mark.parametrize("name", [*RUNTIME, *RUNTIME_PAIRS])
def test_runtime_functions_are_numpys(runtime, name):
    function = getattr(runtime, f"of_{name}")
    function.restype = ctypes.c_double
    expected, points = (RUNTIME | RUNTIME_PAIRS)[name]
    function.argtypes = [ctypes.c_double] * (2 if name in RUNTIME_PAIRS else 1)
    for point in points:
        given = point if isinstance(point, tuple) else (point,)
        np.testing.assert_allclose(function(*given), expected(*given), rtol=1e-14, atol=0.0)


SMALL = random_arm(np.random.default_rng(6), 3, mixed=False)
FRICTION = "coulomb,viscous,offset,load_friction:2"
EFFECTS = "base_tilt,payload,external_wrench,encoder_offset:2,torque_gain:3,bias_drift:1"
SHORT = 4  # samples of a recording that is predicted as it was measured, not filtered
RUNS = 8


def short_recordings(n):
    random = np.random.default_rng(3)
    for _ in range(RUNS):
        q, dq, ddq, tau = random.uniform(-1.5, 1.5, (4, SHORT, n))
        yield lieid.Recording.from_arrays(0.01 * np.arange(SHORT), q, dq, tau, ddq=ddq)


class OneSample:
    """Exported functions on one sample."""

    def __init__(self, fit, folder):
        export(fit, folder, to="c")
        self.n, self.c = fit.model.n, library(folder)
        self.state = ctypes.create_string_buffer(4096)

    def torque(self, recording):
        """The whole torque (K, n)."""
        return np.array([self.at(recording, k, "torque") for k in range(len(recording.t))])

    def at(self, recording, k, name, *given, width=1):
        s = sample_type(self.n)()
        for signal in ("q", "dq", "ddq"):
            getattr(s, signal)[:] = getattr(recording, signal)[k].tolist()
        out = np.full(self.n * width, np.nan)
        getattr(self.c, f"arm_{name}")(ctypes.byref(s), *given, self.state, None, pointer(out))
        return out


def test_torque_is_that_of_predict(tmp_path):
    """The tool is neither at the last link's origin nor along its axes."""
    fit = made_fit(SMALL, f"{FRICTION},{EFFECTS}")
    exported = OneSample(fit, tmp_path / "arm")
    for recording in short_recordings(fit.model.n):
        expected = fit.predict(recording)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(
            exported.torque(recording), expected, rtol=0.0, atol=1e-10 * scale
        )


def test_torque_is_that_of_a_simulated_arm_with_the_effect(tmp_path):
    """Compared with simulated arms, not with columns of this package."""
    robot = SMALL
    cases = {
        # a point at the tool: of another body the effect neglects the inertia about it
        "payload,external_wrench": (
            (
                plant.Payload(1.5, (0.0, 0.0, 0.0), 1e-9),
                plant.ExternalWrench((1.0, -2.0, 0.5), (10.0, 5.0, -8.0)),
            ),
            [1.5, 0.0, 0.0, 0.0, 1.0, -2.0, 0.5, 10.0, 5.0, -8.0],
        ),
        "base_tilt": ((plant.BaseTilt(0.06, -0.04),), [0.06, -0.04]),
        "encoder_offset:3": ((plant.EncoderOffset(2, 0.05),), [0.05]),
        "torque_gain:3": ((plant.TorqueGain(2, 0.1),), [0.1]),
    }
    t = np.arange(0.0, 2.0, 0.05)
    motion = plant.FourierTrajectory(robot, base_frequency=0.1, seed=4).at(t)
    for number, (label, (effects, coefficients)) in enumerate(cases.items()):
        hidden = plant.Arm(robot, robot.link_parameters, plant.JointFriction.none(robot.n), effects)
        recording = plant.measure_along(hidden, t, *motion)
        fit = made_fit(robot, label)
        fit = dataclasses.replace(
            fit, parameters=np.concatenate([robot.link_parameters, coefficients])
        )
        exported = OneSample(fit, tmp_path / f"{number}")
        exact = lieid.Recording.from_arrays(t, recording.q, motion[1], recording.tau, ddq=motion[2])
        error = exported.torque(exact) - recording.tau
        assert np.abs(error).max() < 1e-6, label


def test_notes_name_what_is_not_exported(tmp_path):
    robot = lieid.robots.two_link()
    fit = made_fit(robot, "coulomb,torque_delay:2,bias_drift:1,payload")
    notes = export(fit, tmp_path / "arm", to="c").notes
    text = (tmp_path / "arm" / "arm.h").read_text()
    for label, words in (
        ("torque_delay:2", "without the delay"),
        ("bias_drift:1", "does not carry over"),
        ("payload", "part of effect_torque, not of rigid_torque"),
    ):
        assert any(note.startswith(label) and words in note for note in notes)
        assert f"{label}: " in text
    undelayed = made_fit(robot, "coulomb")
    undelayed = dataclasses.replace(undelayed, parameters=fit.parameters[: 10 * 2 + 2])
    delayed = made_fit(robot, "coulomb,torque_delay:2")
    delayed = dataclasses.replace(delayed, parameters=fit.parameters[: 10 * 2 + 3])
    recording = next(short_recordings(2))
    a, b = (
        OneSample(f, tmp_path / n).torque(recording) for f, n in ((undelayed, "u"), (delayed, "d"))
    )
    np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-12 * np.abs(b).max())


def test_elasticity_is_refused(tmp_path, capsys):
    fit = made_fit(lieid.robots.two_link(), "coulomb,joint_elasticity:2")
    with pytest.raises(ExportError, match="joint_elasticity:2 needs the motion over time"):
        export(fit, tmp_path / "arm", to="c")
    assert not (tmp_path / "arm").exists()
    fit.save(tmp_path / "fit.json")
    folder = str(tmp_path / "out")
    assert main(["export", str(tmp_path / "fit.json"), "--to", "c", "-o", folder]) == 2
    assert capsys.readouterr().err.count("\n") == 1
