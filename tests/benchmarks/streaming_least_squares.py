"""Least squares from processed arrays: ``python tests/benchmarks/streaming_least_squares.py``.

A 7-joint Panda, 43 base parameters and 5 friction columns a joint, from q, dq, ddq, tau (N, 7) to
the parameters: blocks evaluated and reduced at once, beside a loop over Pinocchio's regressor that
stacks the same columns for ``numpy.linalg.lstsq``. Every case runs in a process of its own, so
that its peak of memory is its own. Medians; wall time on two cores, processor time on one.
"""

import argparse
import ctypes
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]
FRICTION = "coulomb,viscous,offset,viscous_polynomial"
SIZES = {"lieid": (10_000, 100_000, 1_000_000), "pinocchio": (10_000, 100_000)}
REPEATS = {10_000: 5, 100_000: 3, 1_000_000: 3}
MOST_SECONDS, MOST_MEGABYTES, LEAST_RATIO = 4.0, 400.0, 50.0


def signals(samples):
    """Return q, dq, ddq, tau without temporaries: the peak of memory is that of the arrays."""
    import numpy as np

    rng = np.random.default_rng(0)
    arrays = [np.empty((samples, 7)) for _ in range(4)]
    for array in arrays:
        rng.standard_normal(out=array)
    return arrays


def by_blocks(model, cores):
    import numpy as np

    import lieid_casadi as lieid
    from lieid_casadi.identification.regression.array_factors import factors
    from lieid_casadi.identification.regression.least_squares import combine, solve

    arm = lieid.compile(model, threads=cores)

    def run(q, dq, ddq, tau):
        return solve(combine(factors(arm, q, dq, ddq, tau), np.ones(7))).values

    return run


def by_pinocchio(model, cores):
    import numpy as np
    import pinocchio as pin
    from robot.random_arms import to_pinocchio

    del cores  # see measured()
    arm = to_pinocchio(model.robot)
    data, kept = arm.createData(), model.base.kept[model.base.kept < 70]
    effects = model.base.kept[model.base.kept >= 70] - 70

    def run(q, dq, ddq, tau):
        matrix = np.zeros((len(q), 7, len(model.base.kept)))
        for k, state in enumerate(zip(q, dq, ddq, strict=True)):
            matrix[k, :, : len(kept)] = pin.computeJointTorqueRegressor(arm, data, *state)[:, kept]
        sign = np.sign(dq)
        columns = np.stack([sign, dq, np.ones_like(dq), sign * dq**2, dq**3])
        order = [(c, j) for c in range(3) for j in range(7)]
        order += [(c, j) for j in range(7) for c in (3, 4)]
        for k, effect in enumerate(effects):
            c, j = order[effect]
            matrix[:, j, len(kept) + k] = columns[c][:, j]
        return np.linalg.lstsq(matrix.reshape(-1, matrix.shape[2]), tau.ravel(), rcond=None)[0]

    return run


def case(who, samples, cores):
    """Measure one case in this process."""
    import lieid_casadi as lieid

    model = lieid.Model(lieid.robots.panda(), FRICTION)
    run = {"lieid": by_blocks, "pinocchio": by_pinocchio}[who](model, cores)
    values = run(*signals(500))  # compiled and loaded
    arrays = signals(samples)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    wall, processor = [], []
    for _ in range(REPEATS[samples] if who == "lieid" else 1):
        start, busy = time.perf_counter(), time.process_time()
        values = run(*arrays)
        wall.append(time.perf_counter() - start)
        processor.append(time.process_time() - busy)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    middle = len(wall) // 2
    return {
        "who": who, "samples": samples, "cores": cores, "wall": sorted(wall)[middle],
        "processor": sorted(processor)[middle], "megabytes": (peak - before) / 1024.0,
        "values": values.tolist(),
    }  # fmt: skip


def measured(who, samples, cores):
    # the loop's threads are those of lstsq; the blocks have their own
    environment = os.environ | {"OMP_NUM_THREADS": str(cores if who == "pinocchio" else 1)}
    arguments = ["--case", who, str(samples), str(cores)]
    done = subprocess.run(
        [sys.executable, __file__, *arguments], env=environment, capture_output=True, text=True
    )
    if done.returncode:
        raise SystemExit(done.stderr)
    return json.loads(done.stdout)


def limits():
    """Return operations per sample of evaluation and reduction, and this core's peak of both."""
    from run import operations
    from timing import peak_operations

    import lieid_casadi as lieid
    from lieid_casadi.codegen_files import codegen_folder
    from lieid_casadi.compiled.compiler import available_targets, build, find_compiler

    arm = lieid.compile(lieid.Model(lieid.robots.panda(), FRICTION))
    q = signals(8)[0]
    widths = [len(columns) + 1 for columns in arm.base_blocks(q, q, q).columns]
    reduction = sum(2 * width**2 for width in widths)
    evaluation = operations(arm.functions.base_regressor) + operations(arm.functions.base_effects)
    target = available_targets()[0]
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder, "peak.so")
        build(find_compiler(), target, HERE / "peak.c", library, codegen_folder())
        peak = target.lanes * peak_operations(ctypes.CDLL(str(library)))
    return evaluation, reduction, peak


def show(rows, evaluation, reduction, peak):
    from rich.console import Console
    from rich.table import Table

    table = Table(title="Least squares from processed arrays, 7-joint Panda, 43 + 35 columns")
    headings = ("who", "samples", "cores", "wall", "processor", "µs a sample", "memory above")
    for heading in (*headings, "Pinocchio: wall", "processor"):
        table.add_column(heading, justify="right")
    peers = {(r["samples"], r["cores"]): r for r in rows if r["who"] == "pinocchio"}
    for r in rows:
        peer = peers.get((r["samples"], r["cores"])) if r["who"] == "lieid" else None
        table.add_row(
            r["who"], f"{r['samples']:.0e}", str(r["cores"]), f"{r['wall']:.3f} s",
            f"{r['processor']:.3f} s", f"{1e6 * r['processor'] / r['samples']:.3f}",
            f"{r['megabytes']:.0f} MB",
            f"{peer['wall'] / r['wall']:.0f}×" if peer else "",
            f"{peer['processor'] / r['processor']:.0f}×" if peer else "",
        )  # fmt: skip
    console = Console(width=140)
    console.print(table)
    best = min(
        (r for r in rows if r["who"] == "lieid"), key=lambda r: r["processor"] / r["samples"]
    )
    least = (evaluation + reduction) / peak
    console.print(
        f"{evaluation} operations a sample to evaluate, {reduction} to reduce (2 Σ kⱼ²): "
        f"{1e6 * least:.3f} µs at {1e-9 * peak:.0f} GFlop/s, this core's peak in registers; "
        f"{100 * least * best['samples'] / best['processor']:.0f} % of it reached. "
        f"Must: 10⁶ samples ≤ {MOST_SECONDS:g} s on two cores, ≤ {MOST_MEGABYTES:g} MB above the "
        f"arrays, Pinocchio ≥ {LEAST_RATIO:g}× slower."
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--case", nargs=3, metavar=("WHO", "SAMPLES", "CORES"))
    parser.add_argument("--json", type=Path, help="write the rows here")
    options = parser.parse_args()
    if options.case:
        who, samples, cores = options.case
        sys.stdout.write(json.dumps(case(who, int(samples), int(cores))))
        return
    rows = [measured(who, n, c) for who, sizes in SIZES.items() for c in (1, 2) for n in sizes]
    show(rows, *limits())
    values = {(r["who"], r["samples"]): r.pop("values") for r in rows}
    for n in SIZES["pinocchio"]:
        pairs = zip(values["lieid", n], values["pinocchio", n], strict=True)
        worst = max(abs(a - b) for a, b in pairs) / max(map(abs, values["pinocchio", n]))
        sys.stdout.write(f"{n} samples: parameters differ by {worst:.1e} of the largest\n")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
