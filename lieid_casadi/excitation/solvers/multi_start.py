"""Several random starts of one problem, here or on any executor."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from lieid_casadi.errors import NoSolution
from lieid_casadi.excitation.design_problem import Design, Problem
from lieid_casadi.excitation.solvers.staged_solve import Solution, solve

Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class Attempt:
    """What one start came to: a solution, or the reason why there is none."""

    seed: int
    seconds: float
    solution: Solution | None = None
    reason: str = ""
    interrupted: bool = False


def solve_all(
    problem: Problem,
    seeds: Sequence[int],
    *,
    progress: Progress = lambda stage, fraction: None,
    executor: Executor | None = None,
    time_limit: float = np.inf,
) -> list[Attempt]:
    """Return one attempt per seed; the result does not depend on the executor.

    Ctrl-C ends the search; attempts that are complete, and the best iterate of the current one,
    are kept.

    Raises
    ------
    KeyboardInterrupt
        Nothing feasible was found before it.
    """
    if executor is not None:
        jobs = [executor.submit(attempt_design, problem.design, seed, time_limit) for seed in seeds]
        attempts = []
        for k, job in enumerate(jobs):
            attempts.append(job.result())
            progress(f"start {k + 1} of {len(jobs)}", (k + 1) / len(jobs))
        return attempts
    attempts = []
    for k, seed in enumerate(seeds):

        def told(stage: str, fraction: float, k: int = k) -> None:
            progress(f"start {k + 1} of {len(seeds)}: {stage}", (k + fraction) / len(seeds))

        try:
            attempts.append(attempt(problem, seed, progress=told, time_limit=time_limit))
        except KeyboardInterrupt:
            if not any(a.solution for a in attempts):
                raise
            attempts[-1] = Attempt(
                attempts[-1].seed, attempts[-1].seconds, attempts[-1].solution,
                attempts[-1].reason, interrupted=True,
            )  # fmt: skip
            break
        if attempts[-1].interrupted:
            break
    return attempts


def attempt(
    problem: Problem,
    seed: int,
    *,
    progress: Progress = lambda stage, fraction: None,
    time_limit: float = np.inf,
) -> Attempt:
    """Solve from one start; a start without a solution is no error."""
    began = time.monotonic()
    try:
        solution = solve(problem, seed, progress=progress, time_limit=time_limit)
    except NoSolution as failure:
        return Attempt(seed, time.monotonic() - began, reason=str(failure))
    return Attempt(seed, time.monotonic() - began, solution, interrupted=solution.interrupted)


def attempt_design(design: Design, seed: int, time_limit: float) -> Attempt:
    """Solve from one start in another process; compiled code comes from the cache there."""
    return attempt(_problem(design), seed, time_limit=time_limit)


_last: list[tuple[Design, Problem]] = []  # the problem that this process solved last


def _problem(design: Design) -> Problem:
    key = repr_of(design)
    if _last and repr_of(_last[0][0]) == key:
        return _last[0][1]
    problem = Problem(design)
    _last[:] = [(design, problem)]
    return problem


def repr_of(design: Design) -> bytes:
    """Return bytes that two equal designs share."""
    import pickle

    return pickle.dumps(design)
