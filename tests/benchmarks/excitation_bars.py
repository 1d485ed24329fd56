"""Excitation against its bars: the Panda beside SLSQP, with all limits, the UR10e, the command.

python tests/benchmarks/excitation_bars.py [panda] [limits] [ur10e] [command]
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from excitation_peer import Peer, first_time, run_slsqp

import lieid_casadi as lieid
from lieid_casadi.errors import NoSolution
from lieid_casadi.excitation import CartesianSpeed, SelfCollision, Torque, capsules_of, floor
from lieid_casadi.excitation.design import FINE, ExcitationProblem
from lieid_casadi.excitation.search import Search
from lieid_casadi.excitation.trajectory import Fourier

UR10E = Path(__file__).parents[3] / "shared" / "recordings" / "ur10e" / "ur10e.urdf"
SPEED = 1.0  # m/s
LEVEL = 12.75


def panda_problem():
    """43 inertial columns, 5 harmonics at 0.05 Hz, 5 rad/s², 100 samples."""
    return ExcitationProblem(
        lieid.Model(lieid.robots.panda()), basis=Fourier(), criterion="condition", limits=(),
        acceleration=5.0, margin=1.0,
    )  # fmt: skip


class TimedSearch(Search):
    """A search that records when an iterate within the limits first reaches the level."""

    first = None

    def _record(self, stage, number, state):
        super()._record(stage, number, state)
        reached = self.problem.condition_number(state.outcome.gram) <= LEVEL
        if self.first is None and reached and state.violation < 5e-4:
            self.first = time.monotonic() - self._began


def panda(starts=10, peers=4):
    began = time.perf_counter()
    problem = panda_problem()
    say(f"panda: built in {time.perf_counter() - began:.2f} s")
    solutions, reached = [], []
    for seed in range(starts):
        search = TimedSearch(problem, seed)
        solution, first = search.solve(), search.first
        violation = max(excess.value for excess in problem.excesses(solution.z))
        solutions.append(solution)
        reached.append(first)
        say(
            f"  seed {seed}: cond {solution.condition_number:.2f} in {solution.seconds:.2f} s, "
            f"{solution.iterations} iterations, cond {LEVEL} after {text(first)}, "
            f"violation {violation:.1g} on the grid {FINE}x finer"
        )
    numbers = [s.condition_number for s in solutions]
    good = sum(n <= 12.5 and s.seconds <= 3.0 for n, s in zip(numbers, solutions, strict=True))
    say(
        f"  {good} of {starts} at cond <= 12.5 within 3 s (bar 9); "
        f"best {min(numbers):.2f} (bar 11.6)"
    )
    peer = Peer(problem)
    constraints = problem.constraints(1, margin=0.0)
    slsqp = []
    for seed in range(peers):
        for objective in ("log_condition", "surrogate"):
            log = run_slsqp(peer, constraints, problem.random_start(seed), objective=objective)
            slsqp.append(first_time(log, LEVEL))
            say(
                f"  SLSQP seed {seed}, {objective}: cond {min(v for _, v, _ in log):.2f} after "
                f"{log[-1][0]:.1f} s, {len(log)} iterations, cond {LEVEL} after {text(slsqp[-1])}"
            )
    own = np.median([np.inf if t is None else t for t in reached])
    other = np.median([np.inf if t is None else t for t in slsqp])
    say(f"  cond {LEVEL}, medians: {own:.3f} s here, {other:.3f} s SLSQP: {other / own:.1f} x")


def limits_problem():
    """The same with torque, Cartesian speed, floor and self-collision, at rest at the middle."""
    robot = lieid.robots.panda()
    links = capsules_of(robot)
    return ExcitationProblem(
        lieid.Model(robot), basis=Fourier(), criterion="condition", acceleration=5.0, margin=1.0,
        limits=(
            Torque(), CartesianSpeed(SPEED), floor(capsules=links), SelfCollision(0.02, links),
        ),
    )  # fmt: skip


def limits(starts=10):
    began = time.perf_counter()
    problem = limits_problem()
    say(f"all limits ({SPEED:g} m/s): built in {time.perf_counter() - began:.2f} s")
    report(problem, starts)


def report(problem, starts):
    for seed in range(starts):
        try:
            solution = Search(problem, seed).solve()
        except NoSolution as reason:
            say(f"  seed {seed}: {reason}")
            continue
        violation = max(excess.value for excess in problem.excesses(solution.z))
        say(
            f"  seed {seed}: cond {solution.condition_number:.2f} in {solution.seconds:.2f} s, "
            f"violation {violation:.1g}"
        )


def ur10e_problem(duration=20.0):
    """Inertial, Coulomb, viscous and offset columns, torque limits and self-collision."""
    robot = lieid.Robot.from_urdf(UR10E)
    return ExcitationProblem(
        lieid.Model(robot, effects=["coulomb", "viscous", "offset"]),
        basis=Fourier(duration=duration), criterion="condition", acceleration=5.0, margin=1.0,
        limits=(Torque(), SelfCollision(0.02, capsules_of(robot))),
    )  # fmt: skip


def ur10e(starts=5, seconds=20.0):
    if not UR10E.exists():
        say(f"ur10e: skipped, no {UR10E}")
        return
    for duration in (20.0, 12.0):
        began = time.perf_counter()
        problem = ur10e_problem(duration=duration)
        say(f"ur10e, {duration:g} s: built in {time.perf_counter() - began:.2f} s")
        report(problem, starts)
        log = run_slsqp(
            Peer(problem, friction=True), problem.constraints(1, margin=0.0),
            problem.random_start(0), seconds=seconds, nonlinear=True,
        )  # fmt: skip
        good = [v for _, v, violation in log if violation <= 1e-6]
        say(f"  SLSQP: cond {min(good, default=np.inf):.1f} after {log[-1][0]:.0f} s")


def command():
    """The whole command, import to files."""
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        subprocess.run(
            [sys.executable, "-m", "lieid_casadi.cli.main", "excite", "panda", "-o", f"{folder}/x"],
            check=True, stdout=subprocess.DEVNULL,
        )  # fmt: skip
        say(f"lieid excite panda: {time.perf_counter() - began:.1f} s (bar 25)")


def say(text):
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def text(seconds):
    return "never" if seconds is None else f"{seconds:.3f} s"


if __name__ == "__main__":
    for name in sys.argv[1:] or ["panda", "limits", "ur10e", "command"]:
        globals()[name]()
