"""Table III of Luo et al. 2024: four criteria from random starts, and the paper's conclusions.

    python examples/table_3.py [--starts N] [--core-types NAME ...]

The paper's problem (Eq. 20, Tables I and II): Panda with the zero pose of Table II, Fourier series
of 5 harmonics at 0.05 Hz, at rest at the zero pose at both ends, joint ranges and speeds of Table
II, a limit V_c of the Cartesian velocity, and the regressor of Eqs. 12-13 with five friction
columns per joint (78 base columns).

C2 is the condition number of the base columns scaled to unit norm, C3 1/prod of the norms of the
base columns, C4 -log det of their Gram matrix in SI units. C1 minimizes C3 first and then C2 with
C4 <= Delta_2, and ends at the first feasible trajectory with C2 <= Delta_1 = 100. Delta_2 is the
largest C4 that the runs of C3 reach, as in the paper (265 there). Delta_1 is the paper's number,
which it derives from its own runs of C2; those of this search reach smaller condition numbers. What
is concluded on C1's condition number and time therefore follows from Delta_1 = 100.

Assumptions, where the paper states nothing: the column scaling (it gives the paper's magnitudes),
100 samples per period, V_c = 1.7 m/s and Franka's acceleration limits (from its data sheet). C4
depends on units and sampling, so only its differences within this table have a meaning.

The rounding of the linear algebra depends on the processor, and the search amplifies it: all runs
are repeated with OpenBLAS kernels of several processors. A conclusion holds (does not hold) if it
does so for every start and every processor; otherwise the data do not decide it.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from functools import cached_property

import numpy as np

import lieid_casadi as lieid
from lieid_casadi.excitation import CartesianSpeed, Criterion
from lieid_casadi.excitation.design import ExcitationProblem
from lieid_casadi.excitation.search import Search
from lieid_casadi.excitation.trajectory import Fourier

CRITERIA = {"C1": "combined", "C2": "condition", "C3": "hadamard", "C4": "logdet"}
FRICTION = "coulomb,viscous,offset,viscous_polynomial"
DELTA_1 = 100.0
V_C = 1.7  # m/s
CORE_TYPES = ("Haswell", "SkylakeX", "Nehalem")  # OPENBLAS_CORETYPE: AVX2, AVX-512, SSE


def unit_norm_gram(gram):
    """Return the Gram matrix of the same columns, scaled to unit norm."""
    norms = np.sqrt(np.diag(gram))
    return gram / np.outer(norms, norms)


class UnitNormColumns(Criterion):
    """A criterion of the base regressor with columns scaled to unit norm.

    With R = D⁻¹GD⁻¹, D = diag(G)^½ and S = ∂f/∂R, the derivative is
    ∂f/∂G = D⁻¹SD⁻¹ − diag(SR)/diag(G).
    """

    def __init__(self, criterion):
        self.criterion, self.name = criterion, criterion.name

    def evaluate(self, gram):
        """Return value and derivative."""
        scaled = unit_norm_gram(gram)
        value, slope = self.criterion.evaluate(scaled)
        norms = np.sqrt(np.diag(gram))
        change = np.diag((slope * scaled).sum(axis=1) / norms**2)
        return value, slope / np.outer(norms, norms) - change


class PaperProblem(ExcitationProblem):
    """A design whose condition number is that of the base columns scaled to unit norm."""

    @cached_property
    def metric(self):
        """No change of coordinates."""
        return np.eye(self.model.base.count)

    @cached_property
    def stages(self):
        """The usual stages, with columns of unit norm in the condition number."""
        return tuple(
            replace(stage, criterion=UnitNormColumns(stage.criterion))
            if stage.criterion.name == "condition" else stage
            for stage in super().stages
        )  # fmt: skip

    def condition_number(self, gram):
        """Return the condition number of the scaled columns."""
        return super().condition_number(unit_norm_gram(gram))


def run(criterion, seeds, **thresholds):
    """Return one row (C2, C4, processor seconds, iterations) per start."""
    model = lieid.Model(lieid.robots.panda_luo2024(), effects=FRICTION)
    problem = PaperProblem(
        model, basis=Fourier(), criterion=criterion,
        limits=(CartesianSpeed(V_C),), start_pose=np.zeros(7),
        margin=1.0, **thresholds,
    )  # fmt: skip
    rows = []
    for seed in seeds:
        began = time.process_time()
        solution = Search(problem, seed).solve()
        seconds = time.process_time() - began
        assert problem.within_limits(solution.z)
        rows.append([solution.condition_number, solution.neg_log_det, seconds, solution.iterations])
    return np.array(rows)


def run_all(starts):
    """Return the rows of all criteria, with the thresholds of C1 from C3."""
    seeds = range(starts)
    results = {name: run(CRITERIA[name], seeds) for name in ("C2", "C3", "C4")}
    delta_2 = float(np.ceil(results["C3"][:, 1].max()))
    c1 = run("combined", seeds, condition_threshold=DELTA_1, neg_log_det_threshold=delta_2)
    return {"C1": c1, **results}


def run_core_types(starts, core_types=CORE_TYPES):
    """Return the rows (core types, starts, 4) of all criteria, each core type in a process."""
    each = []
    for name in core_types:
        environment = {**os.environ, "OPENBLAS_CORETYPE": name, "OPENBLAS_NUM_THREADS": "1"}
        command = [sys.executable, __file__, "--starts", str(starts), "--json"]
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        if done.returncode == 0:
            each.append(json.loads(done.stdout))
        else:  # this processor lacks the instructions
            print(f"OPENBLAS_CORETYPE={name} does not run here", file=sys.stderr)
    return {name: np.array([results[name] for results in each]) for name in CRITERIA}


def conclusions(results):
    """Return (conclusion of the paper, holds for each run, measured) per conclusion."""
    c1, c2, c3, c4 = (results[name].reshape(-1, 4).T for name in CRITERIA)
    closer = np.abs(c1[1] - c3[1]) / (c2[1] - c3[1])
    return [
        ("C1 takes about 30 % of the time of C2 (6.3)", c1[2] <= 0.4 * c2[2],
         f"{interval(100 * c1[2] / c2[2])} %"),
        ("C1's condition number is close to C2's (at most 1.15 of it)", c1[0] <= 1.15 * c2[0],
         f"{interval(c1[0] / c2[0])} of it"),
        ("C1's -log det is better than C2's", c1[1] < c2[1], interval(c1[1] - c2[1])),
        ("C1's -log det is close to C3's (a quarter of C2's difference)", closer <= 0.25,
         f"{interval(closer)} of C2's difference"),
        ("C1's condition number is better than C3's", c1[0] < c3[0],
         f"{interval(c1[0] / c3[0])} of it"),
        ("C3 can replace C4: its -log det is as good (within 1)", c3[1] <= c4[1] + 1.0,
         f"{interval(c3[1] - c4[1])}"),
        ("C3 takes less time than C4", c3[2] < c4[2], f"{interval(c3[2] / c4[2])} of it"),
    ]  # fmt: skip


def holds_in_all(runs):
    """Return whether a conclusion holds in every run or in none; None if the runs differ."""
    return bool(runs[0]) if runs.all() or not runs.any() else None


def interval(values):
    """Return the median and the range of values as text."""
    low, middle, high = np.min(values), np.median(values), np.max(values)
    return f"{middle:.3g} ({low:.3g} to {high:.3g})"


def print_table(results):
    """Print medians, and ranges over starts and core types."""
    heads = ("C2: condition", "C4: -log det", "seconds", "iterations")
    print("    " + "".join(f"{head:>26}" for head in heads) + f"{'change of C2':>16}")
    for name, rows in results.items():
        change = 100.0 * np.ptp(rows[:, :, 0], axis=0) / rows[0, :, 0]
        print(
            f"{name:4}"
            + "".join(f"{interval(column):>26}" for column in rows.reshape(-1, 4).T)
            + f"{np.median(change):9.2g} to {change.max():.2g} %"
        )
    print("change of C2: of one start between the core types, median to largest\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=5, help="random starts (default 5)")
    parser.add_argument("--core-types", nargs="+", default=CORE_TYPES, metavar="NAME")
    parser.add_argument("--json", action="store_true", help="rows on this processor as JSON")
    args = parser.parse_args()
    if args.json:
        print(json.dumps({name: rows.tolist() for name, rows in run_all(args.starts).items()}))
        return
    print(f"python examples/table_3.py --starts {args.starts}: median (range)\n")
    results = run_core_types(args.starts, args.core_types)
    print_table(results)
    verdicts = {True: "holds", False: "does not hold", None: "not decided"}
    for text, runs, measured in conclusions(results):
        print(f"  {text}: {verdicts[holds_in_all(runs)]}; {measured}")


if __name__ == "__main__":
    main()
