"""Bases, criteria, limits and starts of the user's."""

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.cli.main import main
from lieid_casadi.errors import ExcitationError
from lieid_casadi.excitation import ExpressionLimit, excite, jerk_limit
from lieid_casadi.excitation.criteria import ExpressionCriterion, LogDet
from lieid_casadi.excitation.sample_functions import FittedArm
from lieid_casadi.excitation.trajectory import MotionSamples
from lieid_casadi.plant.rigid import build_pinocchio

ROBOT = lieid.robots.two_link()
MODEL = lieid.Model(ROBOT, effects="coulomb,viscous")
QUICK = {"duration": 6.0, "starts": 1, "limits": ()}


@dataclass(frozen=True)
class Bumps:
    """1 and sin(kπt/T)."""

    duration: float = 6.0
    size: int = 11
    name = "bumps"

    def evaluate(self, t):
        k = np.arange(1, self.size)
        rate = np.pi * k / self.duration
        angle = np.outer(t, rate)
        zero, one = np.zeros((len(t), 1)), np.ones((len(t), 1))
        kinds = (np.sin(angle), rate * np.cos(angle), -(rate**2) * np.sin(angle),
                 -(rate**3) * np.cos(angle))  # fmt: skip
        return np.stack([np.hstack([one if i == 0 else zero, f]) for i, f in enumerate(kinds)])


class Flat(Bumps):
    name = "flat"

    def evaluate(self, t):
        return super().evaluate(t)[:, :, ::-1]


class Short(Bumps):
    def evaluate(self, t):
        return super().evaluate(t)[:3]


def everything(s):
    """An expression of every symbol."""
    return ca.vertcat(
        ca.dot(s.tau, s.dq), ca.sumsqr(s.tool), s.dddq[0] * s.ddq[1] + ca.sin(s.q[0]) * s.q[1]
    )


def power(s):
    return ca.dot(s.tau, s.dq)


def volume(information):
    return -2.0 * ca.sum1(ca.log(ca.diag(ca.chol(information)))) / information.size1()


@pytest.fixture(scope="module")
def fit():
    t = np.arange(0.0, 10.0, 0.005)
    motion = plant.FourierTrajectory(ROBOT, base_frequency=0.1, seed=2).at(t)
    recording = plant.measure_along(
        plant.demo_arm(ROBOT, hidden=None), t, *motion, sensors=plant.demo_sensors(ROBOT)
    )
    return lieid.identify(MODEL, recording)


def test_values_of_the_symbols(fit):
    """Torque and tool position by Pinocchio; with a fit its torque, friction included."""
    rng = np.random.default_rng(0)
    q, dq, ddq, dddq = (rng.uniform(0.2, 1.0, (20, 2)) for _ in range(4))
    motion = MotionSamples(np.zeros(20), q, dq, ddq, dddq)
    model = build_pinocchio(ROBOT)
    data, tool = model.createData(), model.getFrameId("tool")
    limit = ExpressionLimit("everything", everything, upper=1.0)
    plain, fitted = (
        limit.on(ROBOT).values(motion),
        limit.on(ROBOT, FittedArm.of(fit)).values(motion),
    )
    torque = fit.torque(q, dq, ddq)
    for k in range(20):
        rigid = pin.rnea(model, data, q[k], dq[k], ddq[k])
        pin.framesForwardKinematics(model, data, q[k])
        place = data.oMf[tool].translation
        third = dddq[k, 0] * ddq[k, 1] + np.sin(q[k, 0]) * q[k, 1]
        np.testing.assert_allclose(plain[:, k], [rigid @ dq[k], place @ place, third])
        assert np.isclose(fitted[0, k], torque[k] @ dq[k])


def test_own_limits_hold_and_are_listed():
    """Power by Pinocchio; jerk by differences of the acceleration."""
    limits = [ExpressionLimit("power", power, upper=8.0, unit="W"), jerk_limit(12.0)]
    found = excite(MODEL, basis="bspline", duration=6.0, starts=1, limits=limits)
    motion = found.motion(500.0)
    model = build_pinocchio(ROBOT)
    data = model.createData()
    signals = zip(motion.q, motion.dq, motion.ddq, strict=True)
    drawn = np.array([pin.rnea(model, data, q, dq, ddq) @ dq for q, dq, ddq in signals])
    assert 7.0 < drawn.max() <= 8.0
    jerk = np.diff(motion.ddq, axis=0) * 500.0
    assert 11.0 < np.abs(jerk).max() <= 12.0
    assert "power of at most 8 W" in found.checked
    assert "jerk of at least -12 and at most 12 rad/s³" in found.checked
    assert found.to_dict()["coefficients"]["family"] == "bspline"


def test_a_basis_of_the_users():
    found = excite(MODEL, basis=Bumps(), **{**QUICK, "duration": 99.0})
    assert found.trajectory.duration == 6.0
    ends = found.at(np.array([0.0, 6.0]))
    np.testing.assert_allclose([*ends.dq, *ends.ddq], 0.0, atol=1e-9)
    assert found.to_dict()["coefficients"]["family"] == "bumps"
    assert found.max_violation == 0.0
    assert found.condition_number < 50.0


def test_a_criterion_of_the_users():
    """−log det as an expression: value, derivative, and the optimum of the built-in criterion."""
    rows = np.random.default_rng(3).normal(size=(30, 6))
    value, slope = ExpressionCriterion(volume, 6).evaluate(rows.T @ rows)
    expected, expected_slope = LogDet().evaluate(rows.T @ rows)
    assert np.isclose(value, expected)
    np.testing.assert_allclose(slope, expected_slope, rtol=1e-9)
    own, named = (excite(MODEL, criterion=c, **QUICK) for c in (volume, "logdet"))
    assert own.criterion == "volume"
    assert np.isclose(own.neg_log_det, named.neg_log_det, atol=0.5)


def test_functions_of_a_module_go_to_an_executor():
    options = {**QUICK, "limits": [ExpressionLimit("power", power, upper=8.0)]}
    with ThreadPoolExecutor(1) as threads:
        there = excite(MODEL, criterion=volume, executor=threads, max_iterations=25, **options)
    here = excite(MODEL, criterion=volume, max_iterations=25, **options)
    np.testing.assert_array_equal(here.trajectory.coefficients, there.trajectory.coefficients)


def test_warm_start(tmp_path, capsys):
    """From a file the search begins at its trajectory, and does not end above it."""
    options = ["--duration", "6", "--rate", "100", "--unchecked-workspace", "--inertial-only"]
    first, second = tmp_path / "first", tmp_path / "second"
    assert main(["excite", "two_link", "-o", str(first), "--starts", "2", *options]) == 0
    before = json.loads((first / "excitation.json").read_text())
    file = first / "trajectory.csv"
    found = excite(lieid.Model(ROBOT), start=file, criterion="condition", **QUICK)
    assert found.starts[0].seed is None
    assert np.isclose(found.starts[0].first_condition_number, before["condition_number"], rtol=0.1)
    assert found.condition_number <= 1.02 * before["condition_number"]
    np.testing.assert_allclose(found.rest_pose, before["rest_pose"], atol=1e-9)
    capsys.readouterr()
    again = ["excite", "two_link", "-o", str(second), "--warm-start", str(file), *options]
    assert main([*again, "--starts", "2", "--max-iterations", "30"]) == 0
    assert "file" in capsys.readouterr().out
    seeds = [s["seed"] for s in json.loads((second / "excitation.json").read_text())["starts"]]
    assert seeds == [None, 0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,q1\n0,0\n", "no column q2"),
        ("", "no column t"),
        ("t,q1,q2\n0,0,0\n1,1,x\n2,0,0\n", "could not convert"),
        ("t,q1,q2\n0,0,0\n2,1,1\n1,0,0\n", "increasing times"),
    ],
)
def test_files_that_are_no_start(tmp_path, capsys, text, message):
    file = tmp_path / "start.csv"
    file.write_text(text)
    target = tmp_path / "out"
    assert main(["excite", "two_link", "-o", str(target), "--warm-start", str(file)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert message in error
    assert not target.exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"basis": "sines"}, "basis: 'sines'; expected one of"),
        ({"basis": Bumps(duration=-1.0)}, "basis bumps: duration -1 s"),
        ({"basis": Flat()}, "basis flat: column 0"),
        ({"basis": Short()}, r"shape \(3, 2, 11\); expected \(4, 2, 11\)"),
        ({"limits": ["torque"]}, "limits: 'torque'; expected limits"),
        ({"start": "nowhere.csv"}, "nowhere.csv cannot be read"),
        ({"criterion": lambda g: g}, "shape .*; expected a scalar"),
        ({"limits": [ExpressionLimit("two", lambda s: s.q.T)]}, "limit 'two': shape"),
        ({"limits": [ExpressionLimit("x", lambda s: s.q, upper=[1, 2, 3])]}, "one bound, or 2"),
        ({"limits": [ExpressionLimit("x", lambda s: s.q, lower=2.0, upper=1.0)]}, "not below"),
    ],
)
def test_bad_extensions(options, message):
    with pytest.raises(ExcitationError, match=message):
        excite(MODEL, **{**QUICK, **options})
