"""`lieid.symbolic` of a robot against Pinocchio, with numbers, SX and MX."""

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from lieid_casadi.errors import ModelError
from lieid_casadi.expressions.symbolic import symbolic

TOLERANCE = 1e-12  # relative to the largest entry


def assert_close(ours, theirs, tolerance=TOLERANCE):
    theirs, ours = np.asarray(theirs), ca.DM(ours).full()
    np.testing.assert_allclose(
        np.reshape(ours, theirs.shape), theirs, rtol=0, atol=tolerance * np.abs(theirs).max()
    )


@pytest.fixture(scope="session")
def functions(arm):
    return symbolic(arm.robot)


def is_refused(arm, functions):
    """Whether the arm's mass matrix is singular; forward dynamics must then be refused."""
    mass = pin.crba(arm.pinocchio, arm.pinocchio.createData(), arm.moments[0][0])
    if np.linalg.eigvalsh(symmetric(mass))[0] > 1e-12:
        return False
    with pytest.raises(ModelError, match="correct the inertias"):  # the TX40's last Izz is 0
        _ = functions.forward_dynamics
    return True


def test_dynamics(arm, functions):
    model, data = arm.pinocchio, arm.pinocchio.createData()
    for q, dq, ddq in arm.moments[:3]:
        tau = pin.rnea(model, data, q, dq, ddq).copy()
        mass = np.array(pin.crba(model, data, q))
        assert_close(functions.inverse_dynamics(q, dq, ddq), tau)
        assert_close(functions.mass_matrix(q), np.triu(mass) + np.triu(mass, 1).T)
        assert_close(functions.gravity(q), pin.computeGeneralizedGravity(model, data, q))
        assert_close(
            ca.mtimes(functions.coriolis(q, dq), dq),
            pin.rnea(model, data, q, dq, 0 * q) - tau_at_rest(arm, q),
            1e-11,
        )
        parts = ca.mtimes(functions.mass_matrix(q), ddq) + ca.mtimes(functions.coriolis(q, dq), dq)
        assert_close(parts + functions.gravity(q) + functions.friction(q, dq), tau)


def tau_at_rest(arm, q):
    return pin.computeGeneralizedGravity(arm.pinocchio, arm.pinocchio.createData(), q)


def test_forward_dynamics_and_its_derivatives(arm, functions):
    """Largest error relative to the largest entry, times the mass matrix's condition number."""
    if is_refused(arm, functions):
        return
    model, data = arm.pinocchio, arm.pinocchio.createData()
    for q, dq, ddq in arm.moments[:3]:
        tau = pin.rnea(model, data, q, dq, ddq).copy()
        tolerance = TOLERANCE * np.linalg.cond(functions.mass_matrix(q).full())
        assert_close(functions.forward_dynamics(q, dq, tau), ddq, tolerance)
        pin.computeABADerivatives(model, data, q, dq, tau)
        ours = functions.forward_dynamics_derivatives(q, dq, tau, ddq)
        for block, theirs in zip(ours, (data.ddq_dq, data.ddq_dv, data.Minv), strict=True):
            assert_close(block, symmetric(theirs) if block is ours[2] else theirs, tolerance)


def symmetric(upper):
    return np.triu(upper) + np.triu(upper, 1).T


def test_casadi_differentiates_forward_dynamics_by_the_implicit_derivatives(arm, functions):
    if is_refused(arm, functions):
        return
    n = arm.robot.n
    symbols = [ca.MX.sym(name, n) for name in ("q", "dq", "tau")]
    ddq = functions.forward_dynamics(*symbols)
    jacobian = ca.Function("J", symbols, [ca.jacobian(ddq, each) for each in symbols])
    q, dq, tau = arm.moments[0]
    at = functions.forward_dynamics(q, dq, tau)
    expected = functions.forward_dynamics_derivatives(q, dq, tau, at)
    for ours, theirs in zip(jacobian(q, dq, tau), expected, strict=True):
        assert_close(ours, theirs.full())
    called = {f.name() for f in jacobian.find_functions()}
    assert "jac_forward_dynamics" in called


def test_frames_of_links(arm, functions):
    """The last link's frame, placed as its tool is, has the tool's pose and Jacobian."""
    last = functions.frame(f"link{arm.robot.n}")
    q = arm.moments[0][0]
    assert_close(
        last.forward_kinematics(q).full() @ arm.robot.tool, functions.forward_kinematics(q).full()
    )
    first = functions.frame("link1").jacobian(q).full()
    assert np.count_nonzero(first[:, 1:]) == 0
    assert functions.frame(arm.robot.joints[0].name).jacobian(q).shape == (6, arm.robot.n)


def test_an_unknown_frame_lists_those_that_exist(functions):
    with pytest.raises(ModelError, match="expected tool, link1 …"):
        functions.frame("link99")
