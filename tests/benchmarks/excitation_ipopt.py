"""The library's two solvers side by side: Ipopt, and sequential quadratic programming.

    python tests/benchmarks/excitation_ipopt.py [panda] [limits] [ur10e]

Criterion ``condition``, ten random starts, processor time on one core; all trajectories verified.
"""

import sys
import time

import numpy as np
from excitation_bars import limits_problem, panda_problem, say, ur10e_problem

from lieid_casadi.errors import NoSolution
from lieid_casadi.excitation.excite import verification
from lieid_casadi.excitation.solvers.staged_solve import SOLVERS, solve

PROBLEMS = {"panda": panda_problem, "limits": limits_problem, "ur10e": ur10e_problem}
STARTS = 10


def row(name, solver):
    problem = PROBLEMS[name](solver=solver)
    numbers, seconds, counts = [], [], []
    for seed in range(STARTS):
        began = time.process_time()
        try:
            solution = solve(problem, seed)
        except NoSolution as reason:
            say(f"{name}, {solver}, seed {seed}: {reason}")
            continue
        seconds.append(time.process_time() - began)
        assert verification(problem, solution.z)[0] == 0.0
        numbers.append(solution.condition_number)
        counts.append(len(solution.history))
    say(
        f"{name:8} {solver:6} cond {min(numbers):6.2f} ... {max(numbers):6.2f}, median "
        f"{np.median(numbers):6.2f}; {np.median(seconds):5.2f} s, at most {max(seconds):5.2f} s, "
        f"{np.median(counts):4.0f} iterations; {len(numbers)} of {STARTS} starts"
    )


if __name__ == "__main__":
    for name in sys.argv[1:] or PROBLEMS:
        for solver in SOLVERS:
            row(name, solver)
