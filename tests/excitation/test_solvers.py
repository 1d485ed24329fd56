"""The solver: optima, limits between samples, interrupts, determinism."""

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi.excitation import Torque, excite
from lieid_casadi.excitation.design import ExcitationProblem
from lieid_casadi.excitation.ipopt import Ipopt, ObjectiveValue
from lieid_casadi.excitation.search import Search
from lieid_casadi.excitation.trajectory import Fourier

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
