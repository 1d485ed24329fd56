"""The identified dynamics of an arm as an acados model, the payload being a run-time parameter.

acados is installed from its sources (https://docs.acados.org), not from PyPI. Where it is
installed, the solver of a small tracking problem is generated and run once; where it is not, the
model is printed. Run this file:

    python examples/mpc_acados.py
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

import lieid_casadi as lieid

HORIZON, INTERVALS = 0.5, 20  # s
SMOOTH = 0.02  # rad/s


@dataclass
class ModelExpressions:
    """The attributes of ``acados_template.AcadosModel`` that a solver needs."""

    name: str = ""
    x: Any = None
    xdot: Any = None
    u: Any = None
    p: Any = None
    f_expl_expr: Any = None
    f_impl_expr: Any = None


def fill(model, source, *, name="arm"):
    """Fill an AcadosModel with the dynamics of a robot, a model with numbers or a fit.

    x = [q; dq], u = torque of the drives, p = link parameters (10,) of a body at the tool.
    """
    arm = lieid.symbolic(source, smooth_velocity=SMOOTH, payload=True)
    size, n = arm.f_explicit.size1_in("x"), arm.f_explicit.size1_in("u")
    model.name = name
    model.x, model.xdot = ca.SX.sym("x", size), ca.SX.sym("xdot", size)
    model.u, model.p = ca.SX.sym("u", n), ca.SX.sym("p", 10)
    model.f_expl_expr = arm.f_explicit(model.x, model.u, model.p)
    model.f_impl_expr = arm.f_implicit(model.x, model.xdot, model.u, model.p)
    return model


def solve(robot, goal):
    """Generate acados' solver of a motion to a goal pose (n,) and return the first torque."""
    from acados_template import AcadosModel, AcadosOcp, AcadosOcpSolver

    ocp, n = AcadosOcp(), robot.n
    ocp.model = fill(AcadosModel(), robot)
    ocp.solver_options.N_horizon, ocp.solver_options.tf = INTERVALS, HORIZON
    ocp.solver_options.integrator_type = "ERK"
    target = np.concatenate([goal, np.zeros(n)])
    ocp.cost.cost_type = ocp.cost.cost_type_e = "EXTERNAL"
    error = ocp.model.x - target
    ocp.model.cost_expr_ext_cost_e = 100.0 * ca.sumsqr(error)
    ocp.model.cost_expr_ext_cost = ca.sumsqr(error) + 1e-4 * ca.sumsqr(ocp.model.u)
    limit = 0.8 * robot.limit("torque")
    ocp.constraints.idxbu, ocp.constraints.lbu, ocp.constraints.ubu = np.arange(n), -limit, limit
    ocp.constraints.x0 = np.zeros(2 * n)
    ocp.parameter_values = np.zeros(10)  # no payload; set for each stage at run time
    solver = AcadosOcpSolver(ocp)
    solver.solve()
    return solver.get(0, "u")


def main():
    robot = lieid.robots.two_link()
    try:
        print("first torque, N·m:", solve(robot, np.array([0.5, -0.3])))
    except ImportError:
        model = fill(ModelExpressions(), robot)
        print("acados_template is not installed; the model that it would be given:")
        for name, value in vars(model).items():
            print(f"  {name}: {value if isinstance(value, str) else value.shape}")


if __name__ == "__main__":
    main()
