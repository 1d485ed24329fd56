"""The examples of optimal control with identified dynamics."""

import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi import plant

sys.path.insert(0, str(Path(__file__).parents[2] / "examples"))

import mpc
import mpc_acados
import optimal_control

PANDA = lieid.robots.panda()


@pytest.mark.slow
def test_the_fastest_motion_keeps_the_limits_on_the_simulated_arm(tmp_path):
    plan, share, tracking = optimal_control.main(["-o", str(tmp_path / "motion.png")])
    assert plan.duration < 1.0
    np.testing.assert_allclose(np.abs(plan.tau / PANDA.limit("torque")).max(), 0.8, atol=1e-4)
    assert share < 1.0
    assert tracking < 5e-3
    assert (tmp_path / "motion.png").stat().st_size > 10_000


def test_a_model_of_acados_has_the_identified_arms_dynamics():
    arm = plant.demo_arm(lieid.robots.two_link(), hidden=None)
    model = mpc_acados.fill(mpc_acados.ModelExpressions(), mpc_acados.identified(arm))
    explicit = ca.Function("f", [model.x, model.u, model.p], [model.f_expl_expr])
    symbols = [model.x, model.xdot, model.u, model.p]
    implicit = ca.Function("g", symbols, [model.f_impl_expr])
    q, dq, ddq = np.array([[[0.3, -0.2]], [[0.5, 0.4]], [[2.0, -3.0]]])
    u = plant.move_along(arm, np.zeros(1), q, dq, ddq).tau[0]  # friction changes ddq by more than 3
    x, body = np.concatenate([q[0], dq[0]]), np.array([2, 0.2, 0, 0, 0.01, 0, 0.01, 0, 0, 0.01])
    np.testing.assert_allclose(explicit(x, u, np.zeros(10)).full()[2:, 0], ddq[0], atol=0.3)
    xdot = explicit(x, u, body)
    assert np.abs(implicit(x, xdot, u, body).full()).max() < 1e-10
    assert np.abs((xdot - explicit(x, u, np.zeros(10))).full()).max() > 0.1


@pytest.mark.slow
def test_model_predictive_control_arrives_with_the_identified_dynamics():
    runs = mpc.main(["--seconds", "2.2"])
    assert runs["identified"].error < 0.02
    assert runs["nominal"].error > 3.0 * runs["identified"].error
    for found in runs.values():
        speed = np.gradient(found.q, found.t, axis=0)
        assert np.all(np.abs(found.tau) <= PANDA.limit("torque"))
        assert np.all(np.abs(speed) <= PANDA.limit("velocity"))
