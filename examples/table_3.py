"""Table III of Luo et al. 2024 again: four criteria from five random starts each.

    python examples/table_3.py [--starts N]

Table II's Panda with the paper's settings: Fourier series of 5 harmonics at 0.05 Hz, at rest at
the zero pose at both ends, joint ranges and speeds of Table II; 100 samples. The paper states no
acceleration limit; Franka's own are used here. Once with the inertial columns, once with the
paper's five friction columns a joint (Eqs. 12-13).

C1 is the paper's (1/prod for the start, then the condition number with a bound on -log det), C2
the condition number, C3 1/prod of the column norms, C4 -log det. Condition numbers are those of
the full regressor in SI units, whatever base is chosen, so they do not compare with the paper's
65 ... 100, whose columns and scaling are not stated. -log det compares within one table only.
"""

import argparse
import time

import numpy as np

import lieid_casadi as lieid
from lieid_casadi.excitation.basis.families import make
from lieid_casadi.excitation.basis.trajectory import period_grid
from lieid_casadi.excitation.criteria.quality import quality
from lieid_casadi.excitation.design_problem import ExcitationProblem
from lieid_casadi.excitation.excite import make_design, verification
from lieid_casadi.excitation.solvers.staged_solve import solve

CRITERIA = {"C1": "combined", "C2": "condition", "C3": "hadamard", "C4": "logdet"}
FRICTION = "coulomb,viscous,offset,viscous_polynomial"
SAMPLES = 100


def run(effects, criterion, seeds):
    """Return one (condition number, -log det, seconds) per start."""
    robot = lieid.robots.panda_luo2024()
    model = lieid.Model(robot, effects=effects)
    basis = make("fourier", duration=20.0, harmonics=5)
    design = make_design(
        model, basis=basis, criterion=criterion, constraints=(), start_pose=np.zeros(7),
        samples=SAMPLES,
    )  # fmt: skip
    problem, rows = ExcitationProblem(design), []
    for seed in seeds:
        began = time.perf_counter()
        solution = solve(problem, seed)
        seconds = time.perf_counter() - began
        assert verification(problem, solution.z)[0] == 0.0
        motion = problem.parametrization.trajectory(solution.z).at(period_grid(20.0, SAMPLES))
        judged = quality(model, motion)
        rows.append((judged.condition_number, judged.neg_log_det, seconds))
    return np.array(rows)


def print_table(title, results):
    print(f"\n{title}")
    print("     " + "".join(f"{name:^30}" for name in results))
    print("     " + "".join(f"{'Cond':>10}{'-log det':>11}{'s':>9}" for _ in results))
    for k in range(len(next(iter(results.values())))):
        cells = [
            f"{c:10.2f}{d:11.1f}{s:9.2f}" for c, d, s in (rows[k] for rows in results.values())
        ]
        print(f"{k + 1:3}  " + "".join(cells))
    medians = [np.median(rows, axis=0) for rows in results.values()]
    print("med  " + "".join(f"{c:10.2f}{d:11.1f}{s:9.2f}" for c, d, s in medians))


def print_claims(results):
    """Say whether what the paper concludes from its Table III holds here (medians)."""
    c1, c2, c3 = (np.median(results[name], axis=0) for name in ("C1", "C2", "C3"))
    print(
        f"  C1 needs {100 * c1[2] / c2[2]:.0f} % of C2's time "
        f"(the paper: 30 %): {holds(c1[2] <= 0.4 * c2[2])}"
    )
    print(
        f"  C1's condition number is {c1[0] / c2[0]:.2f} of C2's "
        f"(the paper: close, 1.13): {holds(c1[0] <= 1.15 * c2[0])}"
    )
    print(f"  C1's -log det is {c1[1] - c2[1]:+.1f} from C2's (better): {holds(c1[1] < c2[1])}")
    print(
        f"  C1's -log det is {c1[1] - c3[1]:+.1f} from C3's, its condition number "
        f"{c1[0] / c3[0]:.2f} of C3's (close and better): {holds(c1[0] < c3[0])}"
    )


def holds(truth):
    return "holds" if truth else "does not hold"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=5)
    seeds = range(parser.parse_args().starts)
    for title, effects in (
        ("Inertial columns", ""),
        ("Inertial columns and five friction columns a joint", FRICTION),
    ):
        results = {name: run(effects, criterion, seeds) for name, criterion in CRITERIA.items()}
        print_table(title, results)
        print_claims(results)
