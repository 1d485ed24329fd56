"""Several random starts of one problem, in this process or on an executor."""

from __future__ import annotations

import pickle
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

from lieid_casadi.blas_threads import blas_on_one_thread
from lieid_casadi.errors import NoSolution
from lieid_casadi.excitation.design_problem import ExcitationDesign, ExcitationProblem
from lieid_casadi.excitation.solvers.staged_solve import OptimizedStart, solve

Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class StartAttempt:
    """Result of one random start: a solution, or the reason why there is none."""

    seed: int
    seconds: float
    solution: OptimizedStart | None = None
    reason: str = ""
    interrupted: bool = False


def solve_all(
    problem: ExcitationProblem,
    seeds: Sequence[int],
    *,
    progress: Progress = lambda stage, fraction: None,
    executor: Executor | None = None,
    max_iterations: int | None = None,
) -> list[StartAttempt]:
    """Return one attempt per seed; the result does not depend on the executor.

    An interrupt (Ctrl-C) ends the search; complete attempts and the best iterate of the current
    one are kept.

    Parameters
    ----------
    problem : ExcitationProblem
    seeds : sequence of int
        One per start.
    progress : callable, optional
        Called with what is done and the fraction that is done.
    executor : Executor, optional
        Of `concurrent.futures`; without one the starts run one after the other.
    max_iterations : int, optional
        Of each start.

    Raises
    ------
    KeyboardInterrupt
        Before a feasible trajectory was found.
    """
    if executor is not None:
        jobs = [
            executor.submit(attempt_design, problem.design, seed, max_iterations) for seed in seeds
        ]
        attempts = []
        for k, job in enumerate(jobs):
            attempts.append(job.result())
            progress(f"start {k + 1} of {len(jobs)}", (k + 1) / len(jobs))
        return attempts
    attempts = []
    for k, seed in enumerate(seeds):

        def report(stage: str, fraction: float, k: int = k) -> None:
            progress(f"start {k + 1} of {len(seeds)}: {stage}", (k + fraction) / len(seeds))

        try:
            attempts.append(attempt(problem, seed, progress=report, max_iterations=max_iterations))
        except KeyboardInterrupt:
            if not any(a.solution for a in attempts):
                raise
            attempts[-1] = replace(attempts[-1], interrupted=True)
            break
        if attempts[-1].interrupted:
            break
    return attempts


def attempt(
    problem: ExcitationProblem,
    seed: int,
    *,
    progress: Progress = lambda stage, fraction: None,
    max_iterations: int | None = None,
) -> StartAttempt:
    """Solve from one start; a start without a solution does not raise.

    Parameters
    ----------
    problem : ExcitationProblem
    seed : int
        Of the start.
    progress : callable
        Called with a stage's name and the fraction done.
    max_iterations : int, optional
        Of the solver; no limit if left out.
    """
    began = time.monotonic()
    try:
        solution = solve(problem, seed, progress=progress, max_iterations=max_iterations)
    except NoSolution as failure:
        return StartAttempt(seed, time.monotonic() - began, reason=str(failure))
    return StartAttempt(seed, time.monotonic() - began, solution, interrupted=solution.interrupted)


@blas_on_one_thread
def attempt_design(design: ExcitationDesign, seed: int, max_iterations: int | None) -> StartAttempt:
    """Solve from one start on an executor; compiled code comes from the cache there.

    Parameters
    ----------
    design : ExcitationDesign
    seed : int
        Of the start.
    max_iterations : int or None
        Of the solver.
    """
    return attempt(_problem(design), seed, max_iterations=max_iterations)


_last = threading.local()  # the last problem of each thread; threads share none


def _problem(design: ExcitationDesign) -> ExcitationProblem:
    key = pickle.dumps(design)
    if getattr(_last, "key", None) != key:
        _last.key, _last.problem = key, ExcitationProblem(design)
    problem: ExcitationProblem = _last.problem
    return problem
