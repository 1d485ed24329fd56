"""The solver, and designs end to end against Pinocchio."""

import numpy as np
import pinocchio as pin
import pytest

import lieid_casadi as lieid
from lieid_casadi.excitation import Torque, excite
from lieid_casadi.excitation.design import ExcitationProblem
from lieid_casadi.excitation.ipopt import Ipopt, ObjectiveValue
from lieid_casadi.excitation.search import Search
from lieid_casadi.excitation.trajectory import Fourier
from lieid_casadi.robot.pinocchio_model import build_pinocchio

PANDA = lieid.robots.panda()


def test_an_iteration_limit_ends_within_the_limits():
    """Four polishing rounds of 40 iterations may follow the limited search."""
    found = excite(lieid.Model(PANDA), starts=1, max_iterations=8, limits=[Torque()])
    assert found.max_violation == 0.0
    assert 8 <= found.starts[0].iterations <= 8 + 4 * 40


def test_the_solver_reads_no_clock(problem, monkeypatch):
    """Iterates of a machine on which every call of the clock takes an hour are the same."""
    import time

    quick = Search(problem, 0).solve()
    hours = iter(range(10**9))
    monkeypatch.setattr(time, "monotonic", lambda: 3600.0 * next(hours))
    slow = Search(problem, 0).solve()
    np.testing.assert_array_equal(quick.z, slow.z)


@pytest.fixture(scope="module")
def problem():
    robot = lieid.robots.two_link()
    return ExcitationProblem(
        lieid.Model(robot), basis=Fourier(duration=6.0), criterion="condition", limits=()
    )


def test_a_quadratic_objective_within_linear_limits(problem):
    """The optimum of a convex problem, by its optimality conditions from another program."""
    from scipy.optimize import minimize

    size = problem.parametrization.size
    target = np.random.default_rng(3).normal(size=size)

    def objective(z):
        away = z - target
        return ObjectiveValue(
            0.5 * float(away @ away), away, np.eye(1), np.zeros(0), np.zeros((0, size))
        )

    constraints = problem.constraints(1)
    made = Ipopt(constraints)
    z = np.zeros(size)
    for _ in range(8):
        z = made.minimize(objective, z, iterations=200, tolerance=1e-9)

    def slack(z):
        return -constraints.excess(constraints.sampled.motion(z)).ravel()

    held = minimize(
        lambda z: objective(z).value, np.zeros(size), jac=lambda z: objective(z).gradient,
        constraints={"type": "ineq", "fun": slack}, method="SLSQP",
        options={"maxiter": 500, "ftol": 1e-12},
    )  # fmt: skip
    assert held.success
    assert np.isclose(objective(z).value, held.fun, rtol=2e-3)
    assert slack(z).min() > -5e-3


@pytest.mark.parametrize("where", ["objective", "report"])
@pytest.mark.parametrize("failure", [KeyboardInterrupt(), ValueError("in a callback")])
def test_exceptions_of_callbacks_are_raised_after_ipopt(problem, failure, where, capfd):
    size, calls = problem.parametrization.size, []

    def fail(*_):
        calls.append(where)
        if len(calls) == 2:
            raise failure

    def objective(z):
        if where == "objective":
            fail()
        quartic = float((z**4).sum())
        return ObjectiveValue(quartic, 4.0 * z**3, np.eye(1), np.zeros(0), np.zeros((0, size)))

    report = fail if where == "report" else lambda *_: None
    with pytest.raises(type(failure)):
        Ipopt(problem.constraints(1), report).minimize(
            objective, np.full(size, 0.1), iterations=50, tolerance=1e-9
        )
    assert len(calls) == 2
    assert capfd.readouterr() == ("", "")


def test_condition_number_and_torque_match_pinocchio():
    """σ₁/σ_r of Pinocchio's own regressor, at the samples; its torque at 1 kHz."""
    found = excite(
        lieid.Model(PANDA), criterion="condition", limits=[Torque(0.9, dry=0.0, viscous=0.0)],
        acceleration=5.0, starts=1, max_iterations=60,
    )  # fmt: skip
    assert found.quality.rank == 43
    assert found.max_violation == 0.0
    model = build_pinocchio(PANDA)
    data = model.createData()
    motion = found.trajectory.at(0.2 * np.arange(100))
    stacked = np.vstack(
        [
            pin.computeJointTorqueRegressor(model, data, *signals)
            for signals in zip(motion.q, motion.dq, motion.ddq, strict=True)
        ]
    )
    sizes = np.linalg.svd(stacked, compute_uv=False)
    assert np.isclose(found.condition_number, sizes[0] / sizes[42], rtol=1e-8)
    assert sizes[43] < 1e-8 * sizes[0]
    base = stacked[:, found.model.base.kept]
    assert np.isclose(found.neg_log_det, -np.linalg.slogdet(base.T @ base)[1])
    motion = found.motion(1000.0)
    torques = [
        pin.rnea(model, data, *x).copy() for x in zip(motion.q, motion.dq, motion.ddq, strict=True)
    ]
    assert np.all(np.abs(torques) <= 0.9 * PANDA.limit("torque"))


def test_the_file_begins_and_ends_at_rest_at_the_rest_pose():
    """Position, velocity and acceleration are continuous."""
    found = excite(
        lieid.Model(lieid.robots.two_link()), duration=6.0, starts=1, rate=500.0,
        start_pose=[0.3, -0.4], limits=(), max_iterations=20,
    )  # fmt: skip
    motion = found.motion()
    np.testing.assert_allclose(motion.q[[0, -1]], [[0.3, -0.4]] * 2, atol=1e-9)
    np.testing.assert_allclose(motion.dq[[0, -1]], 0.0, atol=1e-9)
    np.testing.assert_allclose(motion.ddq[[0, -1]], 0.0, atol=1e-7)
    assert motion.t[-1] == pytest.approx(found.duration)
    for low, high in ((motion.q, motion.dq), (motion.dq, motion.ddq)):
        trapezoid = 0.5 * (high[1:] + high[:-1]) / 500.0
        np.testing.assert_allclose(np.diff(low, axis=0), trapezoid, atol=2e-4)
