"""Acceleration of an arm from its torque, its derivatives, and state equations for solvers."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.expressions.torque import TorqueExpressions, named_function
from lieid_casadi.robot.robot import Robot

NEWTON_STEPS = 4  # of the unrolled solution; tests/expressions bounds its residual by 1e-9
SINGULAR = 1e-14  # smallest over largest eigenvalue of a mass matrix that is singular
RESIDUAL = 1e-9  # of the torque, at a solution
POSES = 1000  # at which the mass matrix is tried


def acceleration(torque: TorqueExpressions) -> ca.SX:
    """Return q̈ (n,) that the torque ``tau`` gives.

    For a given load L the torque is affine in q̈: τ = A·q̈ + b(L). Without friction that depends on
    the load, A is the mass matrix and is factorized as L·D·Lᵀ. Otherwise the load depends on q̈,
    and the equation r(q̈) = ID(q, q̇, q̈) − τ = 0 is solved by Newton's method from the solution of
    the arm without that dependence. It is piecewise linear in q̈ for friction in proportion to
    |L|, where the method ends after as many steps as pieces are crossed. A solution exists and is
    unique if friction changes by less than the load does, as it does for any drive that moves.
    """
    m = torque.motion
    rigid = torque.mass_matrix
    at_zero = ca.substitute(torque.inverse_dynamics, m.ddq, ca.SX.zeros(torque.n))
    if not _is_nonlinear(torque):
        return _solve_symmetric(rigid, torque.tau - at_zero)
    ddq = _solve_symmetric(rigid, torque.tau - at_zero)
    slope = inertia(torque)
    for _ in range(NEWTON_STEPS):
        residual, matrix = ca.substitute(
            [torque.inverse_dynamics - torque.tau, slope], [m.ddq], [ddq]
        )
        ddq = ddq - ca.solve(matrix, residual)
    return ca.densify(ddq)


def _is_nonlinear(torque: TorqueExpressions) -> bool:
    """Whether the torque depends on the acceleration by more than the mass matrix."""
    m = torque.motion
    varies = ca.depends_on(torque.armature, ca.vertcat(m.dq, m.ddq))
    by = ca.vertcat(torque.load, m.ddq)
    return torque.uses_load or varies or bool(ca.depends_on(torque.measurement_torque, by))


def inertia(torque: TorqueExpressions) -> ca.SX:
    """Return ∂ID/∂q̈ (n, n): the mass matrix, with the share that friction adds by the load."""
    if not _is_nonlinear(torque):
        return torque.mass_matrix
    effects = torque.joint_torque + torque.measurement_torque
    by_load = ca.mtimes(ca.jacobian(effects, torque.load), torque.link_mass_matrix)
    direct = ca.jacobian(torque.measurement_torque, torque.motion.ddq)
    added = ca.substitute(by_load + direct, torque.load, torque.rigid_torque)
    return torque.rigid_mass_matrix + torque.armature + added


def derivatives(torque: TorqueExpressions, symbols: Sequence[ca.SX]) -> list[ca.SX]:
    """Return ∂q̈/∂x = −(∂ID/∂q̈)⁻¹·∂ID/∂x for each symbol x, then ∂q̈/∂τ, at a solution ``ddq``."""
    matrix = inertia(torque)
    slopes = [ca.jacobian(torque.inverse_dynamics, symbol) for symbol in symbols]
    right = ca.horzcat(*(-slope for slope in slopes), ca.SX.eye(torque.n))
    if _is_nonlinear(torque):
        solution = ca.solve(matrix, ca.densify(right))
    else:
        solution = _solve_symmetric(matrix, ca.densify(right))
    edges = np.cumsum([0, *(symbol.size1() for symbol in symbols), torque.n])
    return list(ca.horzsplit(solution, [int(edge) for edge in edges]))


def _solve_symmetric(matrix: ca.SX, right: ca.SX) -> ca.SX:
    """Return M⁻¹·b by M = L·D·Lᵀ without pivoting."""
    diagonal, lower, order = ca.ldl(ca.densify(matrix), False)
    return ca.ldl_solve(right, diagonal, lower, order)


def obstacle(torque: TorqueExpressions, *, remedy: str) -> str:
    """Return why numbers have no forward dynamics within the joint limits; empty if they have."""
    if not torque.values.numeric:
        return ""
    share = indefinite_share(torque)
    if share > 0.0:
        return (
            f"the mass matrix is not positive definite in {100.0 * share:.1f} % of the poses "
            f"within the joint limits, so that forward dynamics are not defined there; {remedy}"
        )
    share = unsolved_share(torque)
    if share > 0.0:
        return (
            "friction that depends on the load, or a smooth function of the acceleration, changes "
            "by more than the load, so that the "
            f"acceleration is not determined in {100.0 * share:.1f} % of motions within the "
            "limits; expected smaller coefficients of load friction and smooth functions"
        )
    return ""


def indefinite_share(torque: TorqueExpressions) -> float:
    """Return the share of poses (Sobol points) whose mass matrix is not positive definite."""
    robot = torque.model.robot
    q = _poses(robot)
    expression = torque.mass_matrix
    if torque.payload is not None:
        expression = ca.substitute(expression, torque.payload, ca.SX.zeros(10))
    mass = ca.Function("mass_matrix", [torque.motion.q], [ca.densify(expression)])
    matrices = mass(q.T).full().reshape(robot.n, len(q), robot.n).transpose(1, 0, 2)
    sizes = np.linalg.eigvalsh(matrices)
    return float(np.mean(sizes[:, 0] <= SINGULAR * sizes[:, -1]))


def unsolved_share(torque: TorqueExpressions) -> float:
    """Return the share of motions whose acceleration leaves a residual above 1e-9 of the torque."""
    if not _is_nonlinear(torque):
        return 0.0
    robot, m = torque.model.robot, torque.motion
    fast = robot.limit("velocity")
    fast = np.where(np.isfinite(fast), fast, 1.0)
    q = _poses(robot)[::8]
    reach = [[fast], [np.full(robot.n, 10.0)]]
    dq, ddq = np.random.default_rng(0).uniform(-1.0, 1.0, (2, *q.shape)) * reach
    signals = [torque.states, torque.temperature, torque.time]
    states, warm = ca.DM(torque.model.initial_states), ca.DM(1e3)  # s
    now = [states, ca.DM.zeros(robot.n), warm]
    tau = ca.Function("tau", [m.q, m.dq, m.ddq, *signals], [torque.inverse_dynamics])
    ddq_of = ca.Function("ddq", [m.q, m.dq, torque.tau, *signals], [acceleration(torque)])
    motion = [ca.DM(q.T), ca.DM(dq.T)]
    wanted = tau(*motion, ca.DM(ddq.T), *now)
    solved = tau(*motion, ddq_of(*motion, wanted, *now), *now)
    left = np.abs((solved - wanted).full()).max(axis=0) / np.abs(wanted.full()).max(axis=0)
    return float(np.mean(~(left <= RESIDUAL)))


def _poses(robot: Robot) -> Array:
    """Return poses (K, n) that are spread evenly over the joints' ranges (Sobol points)."""
    from scipy.stats import qmc

    revolute = np.array([joint.revolute for joint in robot.joints])
    limits = np.stack([robot.limit("position_lower"), robot.limit("position_upper")], axis=1)
    reach = np.where(revolute, np.pi, 1.0)[:, None] * np.array([-1.0, 1.0])
    limits = np.where(np.isfinite(limits), limits, reach)
    points = qmc.Sobol(robot.n, seed=0).random(POSES + (-POSES) % 1024)
    return np.asarray(limits[:, 0] + points * (limits[:, 1] - limits[:, 0]))


def explicit(torque: TorqueExpressions) -> ca.Function:
    """Return ``(x, u) -> xdot`` with x = [q; dq; states] and u the torque."""
    m, n = torque.motion, torque.n
    x, u = ca.SX.sym("x", 2 * n + torque.states.size1()), ca.SX.sym("u", n)
    q, dq, states = ca.vertsplit(x, [0, n, 2 * n, x.size1()])
    ddq, rates = ca.substitute(
        [acceleration(torque), torque.state_rates],
        [m.q, m.dq, torque.tau, torque.states],
        [q, dq, u, states],
    )
    inputs = {"x": x, "u": u} | _further_inputs(torque)
    return named_function("f_explicit", inputs, {"xdot": ca.vertcat(dq, ddq, rates)})


def implicit(torque: TorqueExpressions) -> ca.Function:
    """Return ``(x, xdot, u) -> residual``, zero along a motion."""
    m, n = torque.motion, torque.n
    size = 2 * n + torque.states.size1()
    x, xdot, u = ca.SX.sym("x", size), ca.SX.sym("xdot", size), ca.SX.sym("u", n)
    q, dq, states = ca.vertsplit(x, [0, n, 2 * n, size])
    q_rate, ddq, state_rate = ca.vertsplit(xdot, [0, n, 2 * n, size])
    tau, rates = ca.substitute(
        [torque.inverse_dynamics, torque.state_rates],
        [m.q, m.dq, m.ddq, torque.states],
        [q, dq, ddq, states],
    )
    inputs = {"x": x, "xdot": xdot, "u": u} | _further_inputs(torque)
    residual = ca.vertcat(q_rate - dq, tau - u, state_rate - rates)
    return named_function("f_implicit", inputs, {"residual": residual})


def _further_inputs(torque: TorqueExpressions) -> dict[str, ca.SX]:
    """Return the inputs that the model adds; the states are part of x."""
    return {name: symbol for name, symbol in torque.further_inputs().items() if name != "states"}
