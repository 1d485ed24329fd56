"""Every quantity against Pinocchio, which shares no code with the package."""

import casadi as ca
import numpy as np
import pinocchio as pin

from lieid_casadi.dynamics import closed_form, recursion

TOLERANCE = 1e-10  # relative to the largest entry


def assert_close(ours, theirs, tolerance=TOLERANCE):
    theirs = np.asarray(theirs)
    scale = np.abs(theirs).max()
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=tolerance * scale)


def per_state(arm, function):
    """Stack function(model, data, q, dq, ddq) over the states."""
    data = arm.pinocchio.createData()
    return np.array([function(arm.pinocchio, data, *state) for state in arm.moments])


def torques(arm):
    return per_state(arm, pin.rnea)


def test_compiled_torque(arm):
    ours = arm.compiled.inverse_dynamics(*arm.states, arm.robot.link_parameters)
    assert_close(ours, torques(arm))


def test_regressor_itself(arm):
    def theirs(model, data, q, dq, ddq):
        columns = pin.computeJointTorqueRegressor(model, data, q, dq, ddq)
        return np.reshape(columns, (model.nv, -1)) @ arm.shift

    assert_close(arm.compiled.regressor(*arm.states), per_state(arm, theirs))


def test_link_parameters(arm):
    """Link parameters, expressed in Pinocchio's frames, are those of its model."""
    theirs = np.concatenate([body.toDynamicParameters() for body in arm.pinocchio.inertias[1:]])
    assert_close(arm.shift @ arm.robot.link_parameters, theirs)


def jacobians(arm):
    def theirs(model, data, q, dq, ddq):
        frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        linear_first = pin.computeFrameJacobian(model, data, q, arm.tool, frame)
        return np.vstack([linear_first[3:], linear_first[:3]])

    return per_state(arm, theirs)


def test_jacobian(arm):
    assert_close(arm.compiled.jacobian(arm.states[0]), jacobians(arm))


def test_tool_pose(arm):
    def ours(robot, motion, parameters):
        pose = recursion.tool_in_base(robot, motion)
        return ca.horzcat(pose.rotation, pose.translation)

    def theirs(model, data, q, dq, ddq):
        pin.framesForwardKinematics(model, data, q)
        return data.oMf[arm.tool].homogeneous[:3]

    assert_close(arm.evaluate(ours), per_state(arm, theirs))


def test_mass_rate_minus_2c_is_skew(arm):
    """Ṁ by CasADi's directional derivative; `test_symbolic_functions` has C·q̇."""

    def rate(robot, motion, parameters):
        mass = closed_form.mass_matrix(robot, motion, parameters)
        return ca.reshape(ca.jtimes(ca.vec(mass), motion.q, motion.dq), mass.shape)

    def difference(robot, motion, parameters):
        coriolis = closed_form.coriolis_matrix(robot, motion, parameters)
        return rate(robot, motion, parameters) - 2 * coriolis

    values = arm.evaluate(difference)
    symmetric = values + values.transpose(0, 2, 1)
    assert np.abs(symmetric).max() < 1e-12 * np.abs(arm.evaluate(rate)).max()


def test_wrench_exerted_by_the_tool(arm):
    """τ grows by Jᵀ·F; Pinocchio takes the reaction, −F, on its last body."""
    rng = np.random.default_rng(5)
    wrench = rng.normal(size=6) * [3, 3, 3, 30, 30, 30]  # [m; f], base axes, tool's origin

    def theirs(model, data, q, dq, ddq):
        pin.framesForwardKinematics(model, data, q)
        at_tool = pin.SE3(np.eye(3), data.oMf[arm.tool].translation)
        in_base = at_tool.act(pin.Force(wrench[3:], wrench[:3]))
        forces = [pin.Force.Zero() for _ in range(model.njoints)]
        forces[-1] = -data.oMi[model.njoints - 1].actInv(in_base)
        return pin.rnea(model, data, q, dq, ddq, forces)

    added = np.einsum("kij,i->kj", arm.compiled.jacobian(arm.states[0]), wrench)
    assert_close(torques(arm) + added, per_state(arm, theirs))
