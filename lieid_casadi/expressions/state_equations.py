"""State equations of an arm in the form that integrators and solvers of optimal control take."""

from __future__ import annotations

import casadi as ca

from lieid_casadi.expressions import forward_dynamics
from lieid_casadi.expressions.torque import TorqueExpressions


def explicit(torque: TorqueExpressions) -> ca.Function:
    """Return ``(x, u) -> xdot`` with x = [q; dq; states] and u the torque."""
    m, n = torque.motion, torque.n
    x, u = ca.SX.sym("x", 2 * n + torque.states.size1()), ca.SX.sym("u", n)
    q, dq, states = ca.vertsplit(x, [0, n, 2 * n, x.size1()])
    ddq, rates = ca.substitute(
        [forward_dynamics.acceleration(torque), torque.state_rates],
        [m.q, m.dq, torque.tau, torque.states],
        [q, dq, u, states],
    )
    inputs = {"x": x, "u": u} | _further_inputs(torque)
    return _function("f_explicit", inputs, "xdot", ca.vertcat(dq, ddq, rates))


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
    return _function("f_implicit", inputs, "residual", residual)


def _further_inputs(torque: TorqueExpressions) -> dict[str, ca.SX]:
    """Return the inputs that the model adds; the states are part of x."""
    return {name: symbol for name, symbol in torque.further_inputs().items() if name != "states"}


def _function(name: str, inputs: dict[str, ca.SX], output: str, value: ca.SX) -> ca.Function:
    symbols = list(inputs.values())
    return ca.Function(name, symbols, [ca.densify(value)], list(inputs), [output], {"cse": True})
