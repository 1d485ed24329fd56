"""The design as one CasADi graph for ``nlpsol``, beside the solver of this library.

python tests/benchmarks/excitation_graph.py

Panda, 43 inertial columns, 5 harmonics, 100 samples, joint limits on all of them. The criterion is
−log det, which CasADi differentiates (eigenvalues, as in a condition number, it does not). The
graph maps a ``ca.Function`` of the base regressor over the samples; its Hessian is exact or
Ipopt's limited-memory approximation. Processor time on one core.
"""

import sys
import time

import casadi as ca
import numpy as np

import lieid_casadi as lieid
from lieid_casadi.excitation.design import ExcitationProblem
from lieid_casadi.excitation.search import Search
from lieid_casadi.excitation.trajectory import Fourier

STARTS = 5
ITERATIONS = 200


def make_problem():
    return ExcitationProblem(
        lieid.Model(lieid.robots.panda()), basis=Fourier(), criterion="logdet", limits=(),
        acceleration=5.0, margin=1.0,
    )  # fmt: skip


def graph(problem):
    """Return the NLP {x, f, g} and its bounds."""
    model, functions = problem.model, problem.samples.functions  # (n, 3, N, d)
    n, _, count, d = functions.shape
    z = ca.MX.sym("z", n * d)
    own = ca.vertsplit(z, d)
    signals = [
        ca.horzcat(*(ca.mtimes(ca.DM(functions[j, k]), own[j]) for j in range(n))) for k in range(3)
    ]
    signals[0] += ca.repmat(ca.DM(problem.pose).T, count, 1)
    rows = lieid.symbolic(model.robot).base_regressor.map(count)
    stacked = rows(*(signal.T for signal in signals))  # (n, p·N)
    p = model.base.count
    stacked = ca.vertcat(*ca.horzsplit(stacked, p))
    gram = ca.mtimes(stacked.T, stacked)
    volume = ca.log(ca.det(gram * 1e-3)) / p + np.log(1e3)
    limits = problem.range
    bounds = [limits.position, np.stack([-limits.velocity, limits.velocity], axis=1),
              np.stack([-limits.acceleration, limits.acceleration], axis=1)]  # fmt: skip
    g = ca.vertcat(*(ca.vec(signal) for signal in signals))
    lower, upper = (np.concatenate([np.repeat(b[:, s], count) for b in bounds]) for s in (0, 1))
    return {"x": z, "f": -volume, "g": g}, lower, upper


def run_graph(problem, hessian, starts=STARTS, iterations=ITERATIONS):
    nlp, lower, upper = graph(problem)
    began = time.process_time()
    options = {
        "print_time": False, "error_on_fail": False,
        "ipopt": {"print_level": 0, "sb": "yes", "max_iter": iterations, "tol": 1e-5,
                  "hessian_approximation": hessian},
    }  # fmt: skip
    solver = ca.nlpsol("design", "ipopt", nlp, options)
    built = time.process_time() - began
    numbers, seconds, counts = [], [], []
    for seed in range(starts):
        began = time.process_time()
        result = solver(x0=problem.random_start(seed), lbg=lower, ubg=upper)
        seconds.append(time.process_time() - began)
        counts.append(solver.stats()["iter_count"])
        numbers.append(float(result["f"]))
    report(f"graph, {hessian}", numbers, seconds, counts, built)


def run_own(problem):
    numbers, seconds, counts = [], [], []
    for seed in range(STARTS):
        began = time.process_time()
        solution = Search(problem, seed).solve()
        seconds.append(time.process_time() - began)
        counts.append(solution.iterations)
        numbers.append(solution.neg_log_det / problem.model.base.count)
    report("lieid-casadi", numbers, seconds, counts, 0.0)


def report(name, numbers, seconds, counts, built):
    sys.stdout.write(
        f"{name:24} −log det/p {np.median(numbers):7.3f} (best {min(numbers):7.3f}), "
        f"{np.median(seconds):6.2f} s a start, {np.median(counts):4.0f} iterations, "
        f"built in {built:5.1f} s\n"
    )
    sys.stdout.flush()


if __name__ == "__main__":
    problem = make_problem()
    run_own(problem)
    run_graph(problem, "limited-memory")
    run_graph(problem, "exact", starts=1, iterations=60)
