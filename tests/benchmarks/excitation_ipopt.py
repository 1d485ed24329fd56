"""The same problem by Ipopt: why the library's own sequential quadratic programming is used.

    python tests/benchmarks/excitation_ipopt.py

Exact gradients from the same compiled C, limits on q, q̇ and q̈ at 100 samples as sparse linear
rows, limited-memory Hessian, the same continuation. The Hessian is what makes the difference: a
dense BFGS matrix of 63 variables carries over from stage to stage, and an iteration's quadratic
program has some fifty rows near their limits in place of 2100.
"""

import sys
import time

import casadi as ca
import numpy as np
from excitation_peer import linear_rows

import lieid_casadi as lieid
from lieid_casadi.excitation.basis import make
from lieid_casadi.excitation.criteria import POWERS, Condition
from lieid_casadi.excitation.design import Problem
from lieid_casadi.excitation.excite import make_design
from lieid_casadi.excitation.solve import random_start, solve

ITERATIONS = 60  # per stage


class Objective(ca.Callback):
    """f(z) with its gradient, evaluated once per z."""

    def __init__(self, objective, size):
        ca.Callback.__init__(self)
        self.objective, self.size, self.last = objective, size, None
        self.construct("f", {})

    def at(self, z):
        z = z.full().ravel()
        if self.last is None or not np.array_equal(self.last[0], z):
            self.last = z, self.objective(z)
        return self.last[1]

    def get_n_in(self):
        return 1

    def get_n_out(self):
        return 1

    def get_sparsity_in(self, i):
        return ca.Sparsity.dense(self.size)

    def eval(self, arguments):
        return [self.at(arguments[0]).value]

    def has_jacobian(self):
        return True

    def get_jacobian(self, name, inputs, outputs, options):
        self.gradient = Gradient(self, name)
        return self.gradient


class Gradient(ca.Callback):
    def __init__(self, objective, name):
        ca.Callback.__init__(self)
        self.objective = objective
        self.construct(name, {})

    def get_n_in(self):
        return 2

    def get_n_out(self):
        return 1

    def get_sparsity_in(self, i):
        return ca.Sparsity.dense(self.objective.size) if i == 0 else ca.Sparsity(1, 1)

    def get_sparsity_out(self, i):
        return ca.Sparsity.dense(1, self.objective.size)

    def eval(self, arguments):
        return [self.objective.at(arguments[0]).gradient[None]]


def run_ipopt(problem, seed):
    """Return condition number, seconds and iterations from one start."""
    z, size = random_start(problem, seed), problem.parametrization.size
    matrix, limit = linear_rows(problem.constraints(1, margin=0.0), [0], z)
    half, count = len(limit) // 2, 0  # upper limits first, then the same rows' lower ones
    rows = ca.sparsify(ca.DM(matrix[:half]))
    began = time.perf_counter()
    for power in POWERS[:5]:
        objective = Objective(problem.objective(Condition(problem.metric, power)), size)
        x = ca.MX.sym("z", size)
        options = {
            "print_time": False,
            "ipopt": {
                "print_level": 0, "sb": "yes", "max_iter": ITERATIONS, "tol": 1e-4,
                "hessian_approximation": "limited-memory", "mu_oracle": "probing",
                "jac_d_constant": "yes",
            },
        }  # fmt: skip
        program = {"x": x, "f": objective(x), "g": ca.mtimes(rows, x)}
        solver = ca.nlpsol("s", "ipopt", program, options)
        z = solver(x0=z, lbg=-limit[half:], ubg=limit[:half])["x"].full().ravel()
        count += solver.stats()["iter_count"]
    return problem.condition_number(problem.gram(z)), time.perf_counter() - began, count


def main():
    design = make_design(
        lieid.Model(lieid.robots.panda()), basis=make(), criterion="condition", constraints=(),
        acceleration=5.0, free_start=True,
    )  # fmt: skip
    problem = Problem(design)
    for seed in range(5):
        number, seconds, count = run_ipopt(problem, seed)
        mine = solve(problem, seed)
        sys.stdout.write(
            f"seed {seed}: Ipopt cond {number:.2f} in {seconds:.2f} s, {count} iterations; "
            f"here cond {mine.condition_number:.2f} in {mine.seconds:.2f} s, "
            f"{len(mine.history)} iterations\n"
        )


if __name__ == "__main__":
    main()
