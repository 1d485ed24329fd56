"""The peer: SciPy's SLSQP with finite differences on Pinocchio's regressor.

It gets what an engineer would give it: the same trajectory family and end conditions, the linear
joint limits with their exact Jacobians at the same samples, and everything else by differences.
"""

import time

import numpy as np
from scipy.optimize import minimize

from lieid_casadi.robot.pinocchio_model import build_pinocchio


class Peer:
    """Condition number of [Y, friction columns] on Pinocchio, over the free variables z."""

    def __init__(self, problem, *, friction=False):
        self.problem = problem
        self.robot = problem.model.robot
        self.base = problem.model.base
        self.model = build_pinocchio(self.robot)
        self.data = self.model.createData()
        self.friction = friction
        self.width = problem.range.velocity * 0.02  # of the smooth sign, as in the design

    def rows(self, z):
        """The stacked base regressor in the metric of the full one (N n, p)."""
        import pinocchio as pin

        motion, n = self.problem.samples.motion(z), self.robot.n
        blocks = np.empty((len(motion), n, 10 * n))
        for k in range(len(motion)):
            blocks[k] = pin.computeJointTorqueRegressor(
                self.model, self.data, motion.q[k], motion.dq[k], motion.ddq[k]
            )
        full = blocks.reshape(-1, 10 * n)
        if self.friction:
            full = np.hstack([full, self.columns(motion.dq)])
        return full[:, self.base.kept] @ self.problem.metric

    def columns(self, dq):
        """Coulomb, viscous, offset columns (N n, 3 n)."""
        n = dq.shape[1]
        parts = [np.tanh(dq / self.width), dq, np.ones_like(dq)]
        return np.hstack([np.vstack([np.diag(row) for row in part]) for part in parts]).reshape(
            -1, 3 * n
        )

    def condition_number(self, z):
        sizes = np.linalg.svd(self.rows(z), compute_uv=False)
        return sizes[0] / sizes[-1]

    def log_condition(self, z):
        rows = self.rows(z)
        sizes = np.linalg.eigvalsh(rows.T @ rows)
        return 0.5 * np.log(sizes[-1] / sizes[0])

    def surrogate(self, z, power=4.0):
        rows = self.rows(z)
        sizes = np.linalg.eigvalsh(rows.T @ rows)
        return 0.5 / power * np.log(np.sum(sizes**power) * np.sum(sizes**-power))


def run_slsqp(peer, constraints, z, *, objective="log_condition", seconds=20.0, nonlinear=False):
    """Return [(seconds, condition number, scaled violation)], one per iteration.

    ``constraints`` are sampled without margin; linear ones have exact Jacobians.
    """
    matrix, offset = linear_rows(constraints, z)
    conditions = [{"type": "ineq", "fun": lambda z: offset - matrix @ z, "jac": lambda z: -matrix}]
    if nonlinear:
        first = np.arange(len(constraints.excess(constraints.sampled.motion(z))))
        nonlinear_rows = constraints.nonlinear(first * len(constraints.sampled.t))

        def margin(z):
            excess = constraints.excess(constraints.sampled.motion(z))
            return -np.maximum(excess[nonlinear_rows], -10.0).ravel()

        conditions.append({"type": "ineq", "fun": margin})
    began, log = time.perf_counter(), []

    def record(z):
        seconds_now = time.perf_counter() - began
        excess = constraints.excess(constraints.sampled.motion(z))
        log.append((seconds_now, peer.condition_number(z), excess.max()))
        if seconds_now > seconds:
            raise StopIteration

    minimize(
        getattr(peer, objective), z, method="SLSQP", constraints=conditions, callback=record,
        options={"maxiter": 1000, "ftol": 1e-9},
    )  # fmt: skip
    return log


def linear_rows(constraints, z):
    """Return A, b of the linear limits A·z ≤ b at every sample."""
    motion = constraints.sampled.motion(0.0 * z)
    excess = constraints.excess(motion)
    rows = np.flatnonzero(np.isfinite(excess))
    rows = rows[~constraints.nonlinear(rows)]
    return constraints.jacobian(motion, rows), -excess.ravel()[rows]


def first_time(log, level, *, tolerance=1e-6):
    """Return when a feasible iterate first came to a condition number, None if never."""
    good = (t for t, value, violation in log if value <= level and violation <= tolerance)
    return next(good, None)
