"""Model predictive control of a simulated Panda with its identified dynamics, in closed loop.

Every 10 ms an optimal motion over the next 0.4 s is computed from the measured state: double
integrators as dynamics, and the identified torque, friction included, as a constraint. The
solution of one cycle is applied in the next, so that the time of computation is part of the loop.
Between the cycles the torque follows from the planned acceleration and the measured state at 1 kHz.
The arm goes to a pose, and to another one before it has arrived. The same with the nominal model,
without friction, shows what identification is for. hpipm takes one SQP step a cycle, with the
curvature of the objective alone; fatrop and Ipopt solve each problem. Run this file:

    python examples/mpc.py [--solver hpipm|fatrop|ipopt]
"""

import argparse
import time
from dataclasses import dataclass

import casadi as ca
import numpy as np

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.plant.simulate import DriveCommand, Stepper

EFFECTS = "coulomb,viscous,offset"
PERIOD, INNER = 0.01, 1e-3  # s, of the optimization and of the torque
STEP, INTERVALS = 0.02, 20  # s
FREE = 1  # node whose speed is not limited: it is measured
SMOOTH = 0.02  # rad/s
MARGIN = 0.6  # of the limits of torque and velocity
START = np.array([0.0, 0.3, 0.0, -1.8, 0.0, 2.1, 0.0])
GOALS = ((0.0, [0.6, 0.7, 0.2, -1.2, 0.3, 1.7, 0.5]), (0.5, [-0.4, 0.5, -0.2, -1.6, 0.0, 2.0, 0.0]))
WEIGHTS = {"position": 20.0, "velocity": 0.1, "acceleration": 1e-3, "end": 200.0}
SOLVERS = ("hpipm", "fatrop", "ipopt")


@dataclass(frozen=True)
class Run:
    """Results: t (N,), q, tau (N, n), processor time of each cycle (M,) in s, final goal (n,)."""

    t: np.ndarray
    q: np.ndarray
    tau: np.ndarray
    seconds: np.ndarray
    goal: np.ndarray

    @property
    def error(self):
        """Distance from the goal in the last 0.2 s, rad, of the worst joint."""
        return float(np.abs(self.q[self.t > self.t[-1] - 0.2] - self.goal).max())


def problem(robot, torque):
    """Return the optimal control problem, and its parameters: the state and the goal.

    Variables are ddq and the state after it, interval by interval, as structured solvers expect.
    """
    n, opti = robot.n, ca.Opti()
    now, goal = opti.parameter(2 * n), opti.parameter(n)
    states, inputs = [now], []
    for _ in range(INTERVALS):
        inputs.append(opti.variable(n))
        states.append(opti.variable(2 * n))
    limit = MARGIN * robot.limit("torque")
    fastest = MARGIN * robot.limit("velocity")
    cost = 0.0
    for k, (x, ddq) in enumerate(zip(states, inputs)):  # noqa: B905  # one state more
        q, dq = x[:n], x[n:]
        after = ca.vertcat(q + STEP * dq + STEP**2 / 2 * ddq, dq + STEP * ddq)
        opti.subject_to(states[k + 1] == after)
        opti.subject_to(opti.bounded(-limit, torque(q, dq, ddq), limit))
        if k >= FREE:
            opti.subject_to(opti.bounded(-fastest, dq, fastest))
        cost += WEIGHTS["position"] * ca.sumsqr(q - goal) + WEIGHTS["velocity"] * ca.sumsqr(dq)
        cost += WEIGHTS["acceleration"] * ca.sumsqr(ddq)
    last = states[-1]
    opti.minimize(cost + WEIGHTS["end"] * (ca.sumsqr(last[:n] - goal) + ca.sumsqr(last[n:])))
    return opti, now, goal


def controller(robot, torque, solver="hpipm"):
    """Return ``(state, goal, variables, multipliers) -> (variables, multipliers)``."""
    opti, now, goal = problem(robot, torque)
    name, options = options_of(solver, opti, robot.n)
    opti.solver(name, {"expand": True, "print_time": False, "error_on_fail": False, **options})
    return opti.to_function("mpc", [now, goal, opti.x, opti.lam_g], [opti.x, opti.lam_g])


def options_of(solver, opti, n):
    """Return CasADi's solver and its options: one SQP step a cycle, or a solution."""
    if solver == "fatrop":
        inner = {"print_level": 0, "max_iter": 30}
        return "fatrop", {"structure_detection": "auto", "fatrop": inner}
    if solver == "ipopt":
        return "ipopt", {"ipopt": {"print_level": 0, "sb": "yes", "max_iter": 30}}
    x, p, scale, lam = opti.x, opti.p, ca.MX.sym("scale"), ca.MX.sym("lam", opti.ng)
    # the objective is quadratic; the curvature of the torque is neglected
    hessian = ca.triu(scale * ca.hessian(opti.f, x)[0])
    stages = {
        "N": INTERVALS, "nx": [0] + [2 * n] * INTERVALS, "nu": [n] * INTERVALS + [0],
        "ng": [n] * FREE + [2 * n] * (INTERVALS - FREE) + [0], "error_on_fail": False,
        # with the default accuracy each step with active limits takes five times as long
        "hpipm": {"iter_max": 25, "mu0": 1e3, "res_g_max": 1e-3, "res_b_max": 1e-6,
                  "res_d_max": 1e-6, "res_m_max": 1e-3},
    }  # fmt: skip
    quiet = dict.fromkeys(("print_header", "print_iteration", "print_status"), False)
    return "sqpmethod", {
        "qpsol": "hpipm", "qpsol_options": stages, "max_iter": 1, "max_iter_ls": 0,
        "hess_lag": ca.Function("hess_lag", [x, p, scale, lam], [hessian]), **quiet,
    }  # fmt: skip


def run(arm, source, *, seconds=2.5, solver="hpipm"):
    """Return the run of a simulated arm under control with the dynamics of a fit or a robot."""
    robot, n = arm.robot, arm.n
    torque = lieid.symbolic(source, smooth_velocity=SMOOTH).inverse_dynamics
    mpc = controller(robot, torque, solver)
    stepper, still = Stepper(arm, INNER, START), np.zeros(n)
    limit, ratio = robot.limit("torque"), round(PERIOD / INNER)
    steps = round(seconds / INNER)
    t, temperature = INNER * np.arange(steps), arm.thermal.at(INNER * np.arange(steps), n)
    variables = np.tile(np.concatenate([still, START, still]), INTERVALS)
    multipliers, planned, times = np.zeros(mpc.size1_in(3)), (still, still), []
    q, tau = np.empty((steps, n)), np.empty((steps, n))
    for k in range(steps):
        goal = np.array([pose for since, pose in GOALS if t[k] >= since][-1])
        if k % ratio == 0:
            dq, ddq = planned  # of the cycle before
            ahead = stepper.q + PERIOD * stepper.dq + PERIOD**2 / 2 * ddq
            state = np.concatenate([ahead, stepper.dq + PERIOD * ddq])
            began = time.process_time()
            solution = mpc(state, goal, variables, multipliers)
            times.append(time.process_time() - began)
            variables, multipliers = (np.array(x).ravel() for x in solution)
            # the velocity of the next node: at rest friction is that of the motion to come
            planned = variables[2 * n : 3 * n], variables[:n]
        q[k] = stepper.q
        tau[k] = np.clip(np.array(torque(stepper.q, dq, ddq)).ravel(), -limit, limit)
        stepper.step(t[k], DriveCommand(tau[k], still, limit), temperature[k])
    return Run(t, q, tau, np.array(times), np.array(GOALS[-1][1]))


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--solver", choices=SOLVERS, default="hpipm")
    parser.add_argument("--seconds", type=float, default=2.5)
    args = parser.parse_args(argv)
    robot = lieid.robots.panda()
    arm = plant.demo_arm(robot, hidden=None, seed=2)
    motion = plant.FourierTrajectory(robot, seed=1)
    training = plant.simulate(arm, motion, sensors=plant.demo_sensors(robot), seed=1)
    fit = lieid.identify(lieid.Model(robot, EFFECTS), training, method="feasible")
    runs = {}
    for name, source in (("identified", fit), ("nominal", robot)):
        found = runs[name] = run(arm, source, seconds=args.seconds, solver=args.solver)
        share = np.abs(found.tau / robot.limit("torque")).max()
        milliseconds = 1e3 * np.quantile(found.seconds[1:], [0.5, 0.95, 1.0])
        print(
            f"{name}: {1e3 * found.error:.1f} mrad from the goal, torque up to {share:.2f} of its "
            f"limit; processor time of {args.solver}: {milliseconds[0]:.1f} ms (median), "
            f"{milliseconds[1]:.1f} ms (95 %), {milliseconds[2]:.1f} ms (largest) of "
            f"{1e3 * PERIOD:.0f} ms"
        )
    return runs


if __name__ == "__main__":
    main()
