"""Benchmarks of ``lieid fleet``: ``python tests/benchmarks/fleet.py WHAT``, WHAT one of

``changes``: a simulated fleet in which six arms change; what was found, when, and how it is named.
``null``: false alarms of fleets in which nothing changes, resampled from the runs of ``changes``.
``throughput``: arm-nights per hour against a loop over ``diagnose``, with one and two workers.
``faults``: worker, scheduler and client killed at random moments.
``cost``: time and memory of judging a night, over the numbers of arms and of nights; drawn rows.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np

os.environ.setdefault("OMP_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parents[2]
sys.path[:1] = [str(ROOT / "tests"), str(ROOT)]  # tests/fleet, not this file

from benchmarks.changing_fleet import FIRST_NIGHT, arms_of, write_simulated_fleet  # noqa: E402

from lieid_casadi.fleet.alarms import alarms_after  # noqa: E402
from lieid_casadi.fleet.arm_history import read_arms  # noqa: E402
from lieid_casadi.fleet.changes import NightSeries  # noqa: E402
from lieid_casadi.fleet.cluster import RunOptions  # noqa: E402
from lieid_casadi.fleet.config import read_fleet  # noqa: E402
from lieid_casadi.fleet.history import ArmEntry, History  # noqa: E402
from lieid_casadi.fleet.run import run_fleet  # noqa: E402

#: Arms and nights unless stated otherwise; ``null`` uses the history of ``changes``.
SIZES = {
    "changes": (40, 30),
    "null": (40, 30),
    "throughput": (12, 12),
    "faults": (2, 4),
    "cost": (0, 0),
}
FOLDERS = {"null": "changes"}


def say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def changes(args: argparse.Namespace) -> None:
    """Print what was found on the simulated fleet."""
    arms = arms_of(args.arms, args.nights, seed=args.seed)
    start = time.monotonic()
    path = write_simulated_fleet(args.folder, arms, args.nights, args.duration)
    say(f"simulated in {time.monotonic() - start:.0f} s")
    with History(args.folder / "history.duckdb") as history:
        result = run_fleet(
            read_fleet(path),
            history,
            options=RunOptions(workers=args.workers),
            progress=lambda done, total: (
                say(f"{done}/{total}, {time.monotonic() - start:.0f} s")
                if done % 100 == 0
                else None
            ),
        )
        say(f"{result.counts}, {result.seconds:.0f} s")
        alarms, _ = judged_again(list(read_arms(history)))
    print_changes(arms, alarms, args.arms * args.nights)


def judged_again(arms):
    """Return the alarms of arms, judged night after night by this code, and as they were raised."""
    alarms, raised = [], []
    for night in sorted({night for arm in arms for night in arm.dates}):
        alarms, new = alarms_after(alarms, arms, night)
        raised += new
    return alarms, raised


def print_changes(arms, alarms, nights: int) -> None:
    """Print a line per change, and the false alarms."""
    say(f"{'arm':6} {'change':22} {'since':10}   {'raised':10} {'named':24} {'since':10} nights")
    false = []
    for arm in arms:
        own = [a for a in alarms if a.serial == arm.serial]
        if arm.change is None:
            false += own
            continue
        truth = FIRST_NIGHT + timedelta(days=arm.first_changed)
        change = f"{arm.change.effect}:{arm.change.joint or 'arm'}"
        right = [a for a in own if a.raised >= truth]
        false += [a for a in own if a.raised < truth] + right[1:]
        if not right:
            say(f"{arm.serial:6} {change:22} {truth}   not found")
        for a in right[:1]:
            named = f"{a.quantity}:{a.joint or 'arm'}"
            late = (a.since - truth).days
            say(f"{arm.serial:6} {change:22} {truth}   {a.raised} {named:24} {a.since} {late:+d}")
            say(f"       {a.sentence}")
    say(f"false alarms: {len(false)} in {nights} arm-nights")
    for a in false:
        say(f"       {a.serial} {a.quantity}:{a.joint} raised {a.raised}: {a.sentence}")


def null(args: argparse.Namespace) -> None:
    """Print the false alarms of fleets that are resampled from runs in which nothing changes.

    The runs are those of the arms that do not change in the fleet of ``changes``.
    """
    arms = arms_of(args.arms, args.nights, seed=args.seed)
    healthy = {arm.serial for arm in arms if arm.change is None}
    with History(args.folder / "history.duckdb") as history:
        measured = [arm for arm in read_arms(history) if arm.serial in healthy]
    print_false_alarms(measured, args.repetitions)


def exact_interval(count: int, total: int) -> tuple[float, float]:
    """Return the interval of 95 % confidence of a rate (Poisson; one-sided if the count is 0)."""
    from scipy.stats import chi2

    tail = 0.05 if count == 0 else 0.025
    low = 0.5 * float(chi2.ppf(tail, 2 * count)) if count else 0.0
    return low / total, 0.5 * float(chi2.isf(tail, 2 * count + 2)) / total


def print_false_alarms(measured, repetitions: int, *, size: int = 40, nights: int = 30) -> None:
    """Print the alarms of resampled fleets.

    Each arm of a fleet takes its nights, with replacement, from the runs of one measured arm.
    """
    random = np.random.default_rng(7)
    runs = sum(len(arm.dates) for arm in measured)
    raised, total = [], 0
    for k in range(repetitions):
        fleet = [resampled(measured, random, f"{k}-{j}", nights) for j in range(size)]
        raised += judged_again(fleet)[1]
        total += size * nights
        say(f"{total} arm-nights from {runs} runs: {len(raised)} false alarms")
    low, high = exact_interval(len(raised), total)
    say(f"rate {len(raised) / total:.2g} per arm-night, 95 %: {low:.2g} to {high:.2g}")
    for alarm in raised:
        say(f"       {alarm.serial}: {alarm.sentence}")


def resampled(measured, random, serial, nights):
    """Return an arm whose nights are drawn from those of a measured arm."""
    arm = measured[int(random.integers(len(measured)))]
    drawn = random.integers(len(arm.dates), size=nights)
    dates = tuple(FIRST_NIGHT + timedelta(days=k) for k in range(nights))
    days = np.array([date.toordinal() for date in dates], dtype=float)
    series = {
        q: NightSeries(
            days, s.values[drawn], s.scales[drawn], s.temperature[drawn], s.motions[drawn]
        )
        for q, s in arm.series.items()
    }
    found = tuple(arm.found[k] for k in drawn)
    return replace(
        arm, serial=serial, dates=dates, series=series, found=found, shares=arm.shares[drawn]
    )


def throughput(args: argparse.Namespace) -> None:
    """Print arm-nights per hour of a loop over ``diagnose`` and of ``lieid fleet``.

    Processor time is printed beside elapsed time: it does not depend on what else the machine does.
    """
    arms = [
        replace(arm, change=None, has_payloads=False)  # a loop has no known payloads
        for arm in arms_of(args.arms, args.nights, seed=args.seed)
    ]
    fleet = read_fleet(write_simulated_fleet(args.folder, arms, args.nights, args.duration))
    looped(fleet.arms[:3], args.folder, 1)  # to compile all kinds
    elapsed, processor = time.perf_counter(), time.process_time()
    count = looped(fleet.arms, args.folder, args.nights)
    loop = (time.perf_counter() - elapsed) / count
    own = (time.process_time() - processor) / count
    say(f"loop: {count} arm-nights, {3600 / loop:.0f} per hour, {own:.3f} s of processor time each")
    for workers in (1, 2):
        rate, worker, client, whole = measured_run(fleet, args.folder, workers)
        say(
            f"{workers} workers: {3600 * rate:.0f} per hour after the first, "
            f"{rate * loop / workers:.2f} of the loop per worker "
            f"({count * loop / whole / workers:.2f} with start and judging); processor time of "
            f"each: worker {worker:.3f} s ({own / worker:.2f} of the loop), client and scheduler "
            f"{1000 * client:.0f} ms"
        )


def looped(arms, folder: Path, nights: int) -> int:
    """Diagnose recordings one after another; return their number."""
    import lieid_casadi as lieid

    count = 0
    for arm in arms:
        fit = lieid.Fit.load(arm.fits[0].value)
        for file in sorted((folder / "nights" / arm.serial).iterdir())[:nights]:
            lieid.diagnose(fit, lieid.Recording.load(file))
            count += 1
    return count


def measured_run(fleet, folder: Path, workers: int) -> tuple[float, float, float, float]:
    """Return arm-nights per second, processor time of an arm-night in workers and client, and s.

    All but the last are measured between the first batches, one per worker, and the last one.
    """
    import psutil

    path = folder / f"throughput-{workers}.duckdb"
    for file in folder.glob(f"{path.name}*"):
        file.unlink()
    own, finished = psutil.Process(), []

    def note(done: int, _: int) -> None:
        children = own.children(recursive=True)
        spent = [sum(child.cpu_times()[:2]) for child in children]
        finished.append((done, time.perf_counter(), sum(spent), sum(own.cpu_times()[:2])))

    with History(path) as opened:
        result = run_fleet(fleet, opened, options=RunOptions(workers=workers), progress=note)
    first, last = finished[workers - 1], finished[-1]
    count = last[0] - first[0]
    elapsed, worker, client = ((b - a) / count for a, b in zip(first[1:], last[1:], strict=True))
    return 1.0 / elapsed, worker, client, result.seconds


#: A night of arms with six joints and three coefficients each, in which nothing changes.
DRAWN = """
CREATE OR REPLACE TEMP TABLE drawn AS SELECT serial, DATE '2026-01-01' + $night::INTEGER AS date,
    md5(serial || $night) AS run FROM arms;
INSERT INTO runs SELECT run, serial, format('nights/{}/{}.parquet', serial, date), md5(run), 'f',
    '0.1.0', date::TIMESTAMP, 1, 'done', '', date, '200000:' || date, md5('f'), '', 3 FROM drawn;
INSERT INTO parameters SELECT run, serial, date, name, j, 2 + 0.01 * sqrt(-2 * ln(1 - random()))
    * cos(2 * pi() * random()), 0.01, 'N·m' FROM drawn, range(1, 7) x(j),
    (VALUES ('coulomb.f_c'), ('viscous.f_v'), ('offset.f_b')) y(name);
INSERT INTO errors SELECT run, serial, date, j, 0.1 * (0.95 + 0.1 * random()), 0.08, 0.1, 3, 25,
    -1, 1, 0, 0.5 FROM drawn, range(1, 7) x(j);
"""


def fill(history: History, arms: int, nights: int) -> None:
    """Write drawn rows in the order in which a fleet writes them: night by night."""
    serials = [f"A{k:05d}" for k in range(arms)]
    history.set_arms([ArmEntry(serial, "robot", 6, "f") for serial in serials])
    for night in range(nights):
        for statement in DRAWN.split(";\n")[:-1]:
            values = {"night": night} if "$night" in statement else None
            history.connection.execute(statement, values)
    history.connection.execute("INSERT INTO judged SELECT max(date) - 1, max(date) - 1 FROM runs")


def cost(args: argparse.Namespace) -> None:
    """Print processor time per arm and largest memory of judging a night, each in a process."""
    import subprocess

    if args.folder.suffix == ".duckdb":  # in the process of one point of the curve
        import resource

        from lieid_casadi.fleet.alarms import judge_new_nights

        with History(args.folder) as history:
            start = time.process_time()
            alarms = judge_new_nights(history)
            spent = time.process_time() - start
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        say(
            f"{args.arms:6} arms, {args.nights:5} nights: {spent / args.arms:.4f} s per arm, "
            f"{memory:.0f} MB, {len(alarms)} alarms"
        )
        return
    args.folder.mkdir(parents=True, exist_ok=True)
    for arms, nights in args.sizes or ((20, 30), (20, 365), (20, 1000), (200, 365), (2000, 30)):
        path = args.folder / f"cost-{arms}-{nights}.duckdb"
        for file in args.folder.glob(f"{path.stem}*"):
            file.unlink()
        with History(path) as history:
            start = time.monotonic()
            fill(history, arms, nights)
            say(f"filled in {time.monotonic() - start:.0f} s")
        words = ["cost", "--folder", str(path), "--arms", str(arms), "--nights", str(nights)]
        subprocess.run([sys.executable, __file__, *words], check=True)


def faults(args: argparse.Namespace) -> None:
    """Kill worker, scheduler and client at random moments and print what was lost or repeated."""
    import random
    import shutil

    from benchmarks.fleet_faults import ClusterProcesses, killed_run, lost_or_repeated

    arms = [replace(arm, change=None) for arm in arms_of(args.arms, args.nights, seed=args.seed)]
    write_simulated_fleet(args.folder, arms, args.nights, args.duration)
    chosen, wrong = random.Random(args.seed), 0
    cluster = ClusterProcesses(args.folder)
    try:
        for k in range(args.repetitions):
            for file in args.folder.glob("history.duckdb*"):
                file.unlink()
            victim = ("worker", "scheduler", "client")[k % 3]
            delay = chosen.uniform(1.0, args.latest)
            killed_run(args.folder, cluster, victim, delay)
            found = lost_or_repeated(args.folder, args.arms * args.nights)
            wrong += bool(found)
            say(f"{k + 1}: {victim} killed after {delay:.1f} s: {found or 'nothing wrong'}")
    finally:
        cluster.stop()
        shutil.rmtree(args.folder / "dask-worker-space", ignore_errors=True)
    say(f"{args.repetitions} kills, {wrong} with arm-nights lost or recorded twice")


def main() -> int:
    """Run one of the benchmarks."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("what", choices=tuple(SIZES))
    parser.add_argument("--folder", type=Path, help="default: build/fleet/WHAT")
    parser.add_argument("--arms", type=int)
    parser.add_argument("--sizes", nargs="*", type=lambda x: tuple(map(int, x.split("x"))),
                        help="of ``cost``, as ARMSxNIGHTS")  # fmt: skip
    parser.add_argument("--nights", type=int)
    parser.add_argument("--duration", type=float, default=20.0, help="s, of a night")
    parser.add_argument("--workers", type=int, default=None)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--repetitions", type=int, default=9, help="resampled fleets, or kills")
    parser.add_argument("--latest", type=float, default=20.0, help="s, of a kill")
    args = parser.parse_args()
    arms, nights = SIZES[args.what]
    args.arms, args.nights = args.arms or arms, args.nights or nights
    args.folder = args.folder or Path("build/fleet") / FOLDERS.get(args.what, args.what)
    run = {
        "changes": changes, "null": null, "throughput": throughput, "faults": faults, "cost": cost,
    }  # fmt: skip
    run[args.what](args)
    return 0


if __name__ == "__main__":
    sys.exit(main())
