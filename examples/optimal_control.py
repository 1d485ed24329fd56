"""Minimum-time motion of a simulated Panda within its torque limits, friction included.

A model with friction is identified from one run of a simulated arm, `lieid.symbolic` gives it as
CasADi functions, and Ipopt finds the fastest motion between two poses (direct collocation, q̈ linear
between the nodes). The arm then tracks the motion, and the torque that its drives deliver is
compared with the plan and with the limits. Run this file:

    python examples/optimal_control.py [-o motion.png]
"""

import argparse
import time
from dataclasses import dataclass

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

import lieid_casadi as lieid
from lieid_casadi import plant

EFFECTS = "coulomb,viscous,offset,load_friction:2"
START = np.array([-0.6, 1.1, 0.0, -0.9, 0.0, 1.6, 0.0])  # arm stretched out to the side
GOAL = np.array([0.6, 0.2, 0.3, -0.7, 0.5, 2.2, 1.0])
INTERVALS = 40
MARGIN = 0.8  # share of the limits that the plan uses; the rest is left for the controller
SMOOTH = 0.02  # rad/s; friction is differentiable through zero velocity
SMOOTHNESS = 1e-6  # weight of changes of q̈ against the duration


@dataclass(frozen=True)
class Plan:
    """A motion with q̈ linear between equidistant nodes: t (N,), q, dq, ddq, tau (N, n)."""

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    tau: np.ndarray
    seconds: float  # that the solver took

    @property
    def duration(self) -> float:
        return float(self.t[-1])

    def at(self, t):
        """Position, velocity, acceleration (K, n) at times (K,), as the plant's controller asks."""
        t = np.clip(np.atleast_1d(t), 0.0, self.duration)
        step = self.t[1]
        k = np.minimum((t / step).astype(int), len(self.t) - 2)
        s = (t - self.t[k])[:, None]
        slope = (self.ddq[k + 1] - self.ddq[k]) / step
        ddq = self.ddq[k] + slope * s
        dq = self.dq[k] + self.ddq[k] * s + slope * s**2 / 2
        q = self.q[k] + self.dq[k] * s + self.ddq[k] * s**2 / 2 + slope * s**3 / 6
        return q, dq, ddq


def minimum_time(fit) -> Plan:
    """Return the fastest motion from START to GOAL within the margins of the limits."""
    robot, n = fit.model.robot, fit.model.n
    torque = lieid.symbolic(fit, smooth_velocity=SMOOTH).inverse_dynamics
    opti = ca.Opti()
    duration = opti.variable()
    q, dq, ddq = (opti.variable(n, INTERVALS + 1) for _ in range(3))
    tau = torque.map(INTERVALS + 1)(q, dq, ddq)
    h = duration / INTERVALS
    before, after = slice(None, -1), slice(1, None)
    opti.minimize(duration + SMOOTHNESS * ca.sumsqr(ddq[:, after] - ddq[:, before]))
    opti.subject_to(dq[:, after] == dq[:, before] + h / 2 * (ddq[:, before] + ddq[:, after]))
    cubic = h * dq[:, before] + h**2 / 6 * (2 * ddq[:, before] + ddq[:, after])
    opti.subject_to(q[:, after] == q[:, before] + cubic)
    for node, pose in ((0, START), (-1, GOAL)):
        opti.subject_to(q[:, node] == pose)
        opti.subject_to(dq[:, node] == 0)
        opti.subject_to(ddq[:, node] == 0)
    limits = {"velocity": dq, "torque": tau, "acceleration": ddq}
    for name, signal in limits.items():
        bound = np.tile(MARGIN * robot.limit(name)[:, None], INTERVALS + 1)
        opti.subject_to(opti.bounded(-bound, signal, bound))
    lower, upper = (
        np.tile(robot.limit(f"position_{side}")[:, None], INTERVALS + 1)
        for side in ("lower", "upper")
    )
    opti.subject_to(opti.bounded(lower, q, upper))
    opti.subject_to(duration >= 0.1)
    opti.set_initial(duration, 2.0)
    opti.set_initial(q, np.linspace(START, GOAL, INTERVALS + 1).T)
    opti.set_initial(dq, np.tile(((GOAL - START) / 2.0)[:, None], INTERVALS + 1))
    opti.solver("ipopt", {"print_time": False, "expand": True}, {"print_level": 0, "sb": "yes"})
    began = time.perf_counter()
    solution = opti.solve()
    seconds = time.perf_counter() - began
    signals = (np.array(solution.value(each)).T for each in (q, dq, ddq, tau))
    times = np.linspace(0.0, solution.value(duration), INTERVALS + 1)
    return Plan(times, *signals, seconds)


def picture(plan, run, robot, path):
    """Planned and delivered torque of each joint as a fraction of its limit."""
    limit = robot.limit("torque")
    figure, axes = plt.subplots(robot.n, 1, figsize=(7, 10), sharex=True, layout="constrained")
    for j, ax in enumerate(axes):
        ax.plot(run.t, run.tau[:, j] / limit[j], color="0.6", label="delivered by the drives")
        ax.plot(plan.t, plan.tau[:, j] / limit[j], "C0", label="planned")
        for bound in (-MARGIN, MARGIN):
            ax.axhline(bound, color="C3", linewidth=0.8, linestyle="--")
        ax.set_ylabel(f"joint {j + 1}")
    axes[0].set_title("Torque over its limit; dashed: bound of the plan")
    axes[0].legend(loc="upper right", fontsize="small")
    axes[-1].set_xlabel("time, s")
    figure.savefig(path, dpi=120)
    plt.close(figure)


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "-o", "--output", default="motion.png", help="picture (default: motion.png)"
    )
    args = parser.parse_args(argv)
    robot = lieid.robots.panda()
    arm = plant.demo_arm(robot, hidden="load_friction", joint=1)
    motion = plant.FourierTrajectory(robot, seed=1)
    training = plant.simulate(arm, motion, sensors=plant.demo_sensors(robot), seed=1)
    fit = lieid.identify(lieid.Model(robot, EFFECTS), training, method="feasible")
    plan = minimum_time(fit)
    run = plant.simulate(arm, plan)
    q, _, _ = plan.at(run.t)
    tracking = np.abs(run.q - q).max()
    planned = np.column_stack([np.interp(run.t, plan.t, tau) for tau in plan.tau.T])
    share = np.abs(run.tau / robot.limit("torque")).max()
    print(f"{plan.duration:.3f} s, found in {plan.seconds:.1f} s by Ipopt")
    print(f"largest torque over its limit: planned {MARGIN:.2f}, delivered {share:.2f}")
    print(f"largest tracking error {1e3 * tracking:.1f} mrad")
    rms = np.sqrt(np.mean((run.tau - planned) ** 2, axis=0))
    print("RMS of delivered minus planned torque, N·m:", np.array2string(rms, precision=2))
    picture(plan, run, robot, args.output)
    return plan, share, tracking


if __name__ == "__main__":
    main()
