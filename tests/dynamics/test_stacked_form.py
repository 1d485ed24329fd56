"""The stacked matrices of Eqs. 4-5, against Pinocchio, the recursion and what is printed."""

import importlib.util
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from dynamics.test_against_pinocchio import assert_close, torques

from lieid_casadi.dynamics import recursion

SCRIPT = Path(__file__).parents[2] / "examples" / "paper" / "stacked_form.py"
spec = importlib.util.spec_from_file_location("paper_stacked_form", SCRIPT)
module = importlib.util.module_from_spec(spec)
sys.modules[spec.name] = module  # a dataclass looks its own module up
spec.loader.exec_module(module)
stacked_matrices = module.stacked_matrices

SOME = ["panda", "panda_luo2024", "two_link", "random_0_of_2", "random_3_of_5", "random_7_of_9"]
pytestmark = pytest.mark.parametrize("arm", SOME, indirect=True)


def test_equation_4_is_the_recursion(arm):
    def stacked(robot, motion, parameters):
        s = stacked_matrices(robot, motion, parameters)
        return (
            ca.mtimes(s.mass_matrix, motion.ddq)
            + ca.mtimes(s.velocity_matrix, motion.dq)
            + s.gravity
        )

    assert_close(arm.evaluate(stacked), arm.evaluate(recursion.inverse_dynamics), 1e-12)


def test_the_jacobian_is_that_of_the_tool_in_its_own_axes(arm):
    def turned(robot, motion, parameters):
        rotation = recursion.tool_in_base(robot, motion).rotation
        jacobian = stacked_matrices(robot, motion, parameters).jacobian
        return ca.mtimes(ca.diagcat(rotation, rotation), jacobian)

    assert_close(arm.evaluate(turned), arm.compiled.jacobian(arm.states[0]), 1e-12)


@pytest.mark.parametrize(
    ("sign", "inverse", "right"),
    [(-1, False, False), (1, False, False), (-1, True, False), (1, True, True)],
)
def test_equations_2_and_3_as_printed_need_both_corrections(arm, sign, inverse, right):
    """Printed: −ad_{Ad⁻¹V}(ξq̇) in Eq. 2, and Adᵀ without the inverse in Eq. 3."""

    def torque(robot, motion, parameters):
        return newton_euler(robot, motion, parameters, sign=sign, inverse=inverse)

    error = np.abs(arm.evaluate(torque)[:, :, 0] - torques(arm)).max()
    scale = np.abs(torques(arm)).max()
    assert (error < 1e-10 * scale) == right
    assert right or error > 1e-3 * scale


def newton_euler(robot, motion, parameters, *, sign, inverse):
    """Eqs. 2-3 on whole twists and wrenches."""
    from lieid_casadi.dynamics.closed_form import spatial_inertia
    from lieid_casadi.dynamics.lie import axes, inverse_adjoint_times, relative_poses, small_adjoint

    poses, xi = relative_poses(robot, motion), axes(robot)
    v, a = ca.SX(6, 1), ca.SX(np.concatenate([np.zeros(3), -robot.gravity]))
    twists, accelerations = [], []
    for i, g in enumerate(poses):
        back = inverse_adjoint_times(g, ca.SX(ca.DM.eye(6)))
        carried = ca.mtimes(back, v)
        turn = xi[i] * motion.dq[i]
        v = carried + turn
        a = ca.mtimes(back, a) + sign * ca.mtimes(small_adjoint(carried), turn)
        a += xi[i] * motion.ddq[i]
        twists.append(v)
        accelerations.append(a)
    wrench, torque = ca.SX(6, 1), [None] * robot.n
    for i in reversed(range(robot.n)):
        inertia = spatial_inertia(parameters[10 * i : 10 * i + 10])
        wrench += ca.mtimes(inertia, accelerations[i])
        wrench -= ca.mtimes([small_adjoint(twists[i]).T, inertia, twists[i]])
        torque[i] = ca.mtimes(xi[i].T, wrench)
        back = inverse_adjoint_times(poses[i], ca.SX(ca.DM.eye(6)))
        wrench = ca.mtimes(back.T, wrench) if inverse else ca.solve(back.T, wrench)
    return ca.vertcat(*torque)
