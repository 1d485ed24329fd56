"""The identified dynamics of an arm as an acados model, the payload being a run-time parameter.

A simulated arm with friction is identified; its friction is smooth within SMOOTH, and stiff there,
so that the integrator is implicit. acados is installed from its sources
(https://docs.acados.org), not from PyPI. Where it is installed, the solver of a small tracking
problem is generated and run once; where it is not, the model is printed. Run this file:

    python examples/mpc_acados.py
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

import lieid_casadi as lieid
from lieid_casadi import plant

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
    arm = lieid.symbolic(source, smooth_velocity=SMOOTH, free=["payload"])
    size, n = arm.f_explicit.size1_in("x"), arm.f_explicit.size1_in("u")
    model.name = name
    model.x, model.xdot = ca.SX.sym("x", size), ca.SX.sym("xdot", size)
    model.u, model.p = ca.SX.sym("u", n), ca.SX.sym("p", 10)
    model.f_expl_expr = arm.f_explicit(model.x, model.u, model.p)
    model.f_impl_expr = arm.f_implicit(model.x, model.xdot, model.u, model.p)
    return model


def identified(arm):
    """Return the fit to a recording of a simulated arm."""
    motion = plant.FourierTrajectory(arm.robot, base_frequency=0.05, seed=1)
    t = np.arange(0.0, 20.0, 0.002)
    sensors = plant.demo_sensors(arm.robot)
    run = plant.measure_along(arm, t, *motion.at(t), sensors=sensors, seed=1)
    model = lieid.Model(arm.robot, "coulomb,viscous,offset")
    return lieid.identify(model, run, method="feasible")


def solve(fit, goal):
    """Generate acados' solver of a motion to a goal pose (n,) and return the first torque."""
    from acados_template import AcadosModel, AcadosOcp, AcadosOcpSolver

    ocp, robot, n = AcadosOcp(), fit.model.robot, fit.model.n
    ocp.model = fill(AcadosModel(), fit)
    ocp.solver_options.N_horizon, ocp.solver_options.tf = INTERVALS, HORIZON
    ocp.solver_options.integrator_type = "IRK"  # any step
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
    fit = identified(plant.demo_arm(lieid.robots.two_link(), hidden=None))
    try:
        print("first torque, N·m:", solve(fit, np.array([0.5, -0.3])))
    except ImportError:
        model = fill(ModelExpressions(), fit)
        print("acados_template is not installed; the model that it would be given:")
        for name, value in vars(model).items():
            print(f"  {name}: {value if isinstance(value, str) else value.shape}")


if __name__ == "__main__":
    main()
