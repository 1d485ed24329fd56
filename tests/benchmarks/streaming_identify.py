"""``identify`` of long recordings: ``python tests/benchmarks/streaming_identify.py [--rows N…]``.

A 7-joint Panda at 1 kHz, 43 base parameters and 5 friction columns a joint, low-pass 9.4 Hz: from
a Parquet file to the fit, loaded and in parts. Every case runs in a process of its own: wall and
processor time by stage, and the peak of memory above the interpreter with its libraries.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

FRICTION = "coulomb,viscous,offset,viscous_polynomial"
CHUNK = 100_000  # rows written at once
ROW_BYTES = 22 * 8


def write(path, rows):
    """Write a recording of the nominal arm with friction and noise, piece by piece."""
    import numpy as np
    import pyarrow as pa
    import pyarrow.parquet as pq

    import lieid_casadi as lieid

    robot, rng = lieid.robots.panda(), np.random.default_rng(0)
    arm, middle = lieid.compile(lieid.Model(robot)), np.array([0, 0.2, 0, -1.5, 0, 1.7, 0.5])
    waves = 2.0 * np.pi * 0.05 * np.arange(1, 6)
    sines, cosines = rng.normal(size=(2, 5, 7)) * 0.15 / np.arange(1, 6)[:, None]
    writer = None
    for first in range(0, rows, CHUNK):
        t = np.arange(first, min(first + CHUNK, rows)) * 1e-3
        s, c = np.sin(np.outer(t, waves)), np.cos(np.outer(t, waves))
        q = middle + s @ sines + c @ cosines
        dq = (c * waves) @ sines - (s * waves) @ cosines
        ddq = -(s * waves**2) @ sines - (c * waves**2) @ cosines
        tau = arm.inverse_dynamics(q, dq, ddq, robot.link_parameters)
        tau += 0.5 * np.sign(dq) + 0.3 * dq + 0.1 * rng.normal(size=q.shape)
        columns = {"t": t}
        for name, signal in (("q", q), ("dq", dq), ("tau", tau)):
            columns |= {f"{name}{j + 1}": signal[:, j] for j in range(7)}
        table = pa.table(columns)
        writer = writer or pq.ParquetWriter(path, table.schema)
        writer.write_table(table)
    writer.close()


def case(path, how):
    """Identify in this process."""
    import numpy as np

    import lieid_casadi as lieid
    from lieid_casadi.recording import Processing, Recording, stream

    model = lieid.Model(lieid.robots.panda(), FRICTION)
    few = np.zeros((8, 7))
    lieid.compile(model).base_regressor(few, few, few)  # built and loaded
    before, stages = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, {}
    start, busy = time.perf_counter(), time.process_time()
    recording = {"loaded": Recording.load, "in parts": stream}[how](path)

    def record_stage(stage, _):
        stages[stage] = time.process_time() - busy

    fit = lieid.identify(model, recording, processing=Processing(cutoff=9.4), progress=record_stage)
    return {
        "how": how, "rows": len(recording), "wall": time.perf_counter() - start,
        "processor": time.process_time() - busy, "stages": stages,
        "megabytes": (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024.0,
        "values": fit.values.tolist(),
    }  # fmt: skip


def measured(path, how):
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, __file__, "--case", str(path), how],
        env=environment,
        capture_output=True,
        text=True,
    )
    if done.returncode:
        raise SystemExit(done.stderr)
    return json.loads(done.stdout)


def show(rows):
    from rich.console import Console
    from rich.table import Table

    table = Table(title="identify, 7-joint Panda at 1 kHz, 43 + 35 columns, two cores")
    for heading in (
        "rows",
        "recording",
        "how",
        "wall",
        "processor",
        "peak above",
        "same values to",
    ):
        table.add_column(heading, justify="right")
    first = {}
    for r in rows:
        values = first.setdefault(r["rows"], r["values"])
        worst = max(abs(a - b) for a, b in zip(r["values"], values, strict=True))
        table.add_row(
            f"{r['rows']:.0e}", f"{1e-6 * ROW_BYTES * r['rows']:.0f} MB", r["how"],
            f"{r['wall']:.1f} s", f"{r['processor']:.1f} s", f"{r['megabytes']:.0f} MB",
            f"{worst / max(map(abs, values)):.0e}",
        )  # fmt: skip
    Console(width=120).print(table)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", nargs="+", type=int, default=[100_000, 1_000_000, 4_000_000])
    parser.add_argument("--case", nargs=2, metavar=("FILE", "HOW"))
    parser.add_argument("--json", type=Path, help="write the rows here")
    options = parser.parse_args()
    if options.case:
        sys.stdout.write(json.dumps(case(*options.case)))
        return
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for count in options.rows:
            path = Path(folder, f"{count}.parquet")
            write(path, count)
            found += [measured(path, how) for how in ("loaded", "in parts")]
            path.unlink()
    show(found)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
