"""Benchmarks of compiled models: ``python tests/benchmarks/run.py [--json FILE]``.

Times are medians of processor time on one core, each beside Pinocchio's from the same run, and
beside what the processor could do at most: operations in registers, or bytes written to memory.
"""

import argparse
import ctypes
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

import arms  # noqa: E402
import numpy as np  # noqa: E402
import pinocchio as pin  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402
from robot.random_arms import to_pinocchio  # noqa: E402
from timing import peak_operations, several  # noqa: E402

import lieid_casadi as lieid  # noqa: E402
from lieid_casadi.codegen_files import codegen_folder  # noqa: E402
from lieid_casadi.compiled.kernel_source import kernel_source  # noqa: E402
from lieid_casadi.compiled.kernels import available_targets, build, find_compiler  # noqa: E402

FRICTION = "coulomb,viscous,offset,viscous_polynomial"  # five columns a joint
BATCH = 20_000


@dataclass(frozen=True)
class Row:
    """One line of the table; seconds per sample."""

    arm: str
    what: str
    seconds: float
    target: float | None = None
    pinocchio: float | None = None
    limit: float | None = None  # the least that it could take
    limited_by: str = ""


class Compiled:
    """C for one purpose: a kernel for single samples, or the peak."""

    def __init__(self, folder):
        self.folder, self.count = Path(folder), 0

    def library(self, text, target):
        self.count += 1
        source = self.folder / f"{self.count}.c"
        source.write_text(text)
        path = source.with_suffix(".so")
        build(find_compiler(), target, source, path, codegen_folder())
        return ctypes.CDLL(str(path))


def operations(sparse):
    """Arithmetic operations of one sample."""
    import casadi as ca

    free = {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST}
    f = sparse.function
    return sum(f.instruction_id(k) not in free for k in range(f.n_instructions()))


def single(make, sparse, robot, motion):
    """A run over all samples, one kernel call each, inside C."""
    scalar = available_targets()[-1]
    kernel = make.library(kernel_source(sparse), scalar)
    loops = make.library((HERE / "loops.c").read_text(), scalar)
    counts = np.bincount(sparse.rows, minlength=robot.n)
    results = [np.zeros(max(count, 1)) for count in counts]
    rows = (ctypes.c_void_p * robot.n)(*(result.ctypes.data for result in results))
    pointers = [ctypes.c_void_p(x.ctypes.data) for x in (*motion, robot.link_parameters)]
    size = [ctypes.c_int64(robot.n), ctypes.c_int64(len(motion[0]))]
    function = ctypes.cast(kernel.lieid_kernel, ctypes.c_void_p)

    def run():
        assert results  # the memory that rows point to
        loops.samples_one_by_one(function, *size, *pointers, rows)

    return run


def rows_of(robot, make, peaks):
    rng, n = np.random.default_rng(0), robot.n
    q, dq, ddq = motion = rng.normal(size=(3, BATCH, n))
    few = motion[:, :500]
    model = lieid.Model(robot, effects=FRICTION)
    arm, links = lieid.compile(model, threads=1), robot.link_parameters
    functions = arm.functions
    dense, torque = np.zeros((BATCH, n, 10 * n)), np.zeros((BATCH, n))
    blocks = arm.base_blocks(q, dq, ddq)
    buffer = blocks.buffer()
    pinocchio = to_pinocchio(robot)
    data, stack = pinocchio.createData(), np.zeros((500, n, 10 * n))

    def pinocchio_regressor():
        for state in zip(*few, strict=True):
            pin.computeJointTorqueRegressor(pinocchio, data, *state)

    def pinocchio_stacked():
        for k, state in enumerate(zip(*few, strict=True)):
            stack[k] = pin.computeJointTorqueRegressor(pinocchio, data, *state)

    def pinocchio_torque():
        for state in zip(*few, strict=True):
            pin.rnea(pinocchio, data, *state)

    def in_blocks():
        for first in range(0, BATCH, blocks.size):
            blocks.evaluate(first, min(first + blocks.size, BATCH), buffer)

    runs = {
        "pinocchio regressor": (pinocchio_regressor, 500),
        "pinocchio stacked": (pinocchio_stacked, 500),
        "pinocchio torque": (pinocchio_torque, 500),
        "fill": (lambda: dense.fill(1.0), BATCH),
        "single regressor": (single(make, functions.regressor, robot, few), 500),
        "single torque": (single(make, functions.inverse_dynamics, robot, few), 500),
        "blocks": (in_blocks, BATCH),
        "dense": (lambda: arm.regressor(q, dq, ddq, out=dense), BATCH),
        "torque": (lambda: arm.inverse_dynamics(q, dq, ddq, links, out=torque), BATCH),
    }
    measured = several([run for run, _ in runs.values()])
    t = {name: s / count for (name, (_, count)), s in zip(runs.items(), measured, strict=True)}
    scalar, vector = peaks
    flops = {
        "regressor": operations(functions.regressor),
        "torque": operations(functions.inverse_dynamics),
        "base": operations(functions.base_regressor) + operations(functions.base_effects),
    }
    targets = iter([0.25, 0.15, 0.09, 0.5, 0.03] if robot.name == "panda" else [None] * 5)

    def row(what, key, peer, limit, limited_by):
        target = next(targets, None)
        target = None if target is None else 1e-6 * target
        peer = None if peer is None else t[peer]
        return Row(robot.name, what, t[key], target, peer, limit, limited_by)

    return [
        row("full regressor, one sample per C call", "single regressor", "pinocchio regressor",
            flops["regressor"] / scalar, "operations"),
        row("torque, one sample per C call", "single torque", "pinocchio torque",
            flops["torque"] / scalar, "operations"),
        row("base regressor + 5 friction columns, in cache", "blocks", "pinocchio stacked",
            flops["base"] / vector, "operations"),
        row(f"full regressor into (N, {n}, {10 * n}), out=", "dense", "pinocchio stacked",
            t["fill"], "plain fill"),
        row("torque, batch", "torque", "pinocchio torque", flops["torque"] / vector, "operations"),
    ]  # fmt: skip


COMPILE = """
import time, numpy as np, lieid_casadi as lieid
from lieid_casadi.effects import ArmEffect
from lieid_casadi.effects.registry import REGISTER
names = [name for name in sorted(REGISTER) if "/" not in name]
names = [name for name in names if not isinstance(REGISTER[name](), ArmEffect)]
effects = [name + ":2<1" if REGISTER[name]().couples else name for name in names]
model = lieid.Model(lieid.robots.panda(), effects=effects)
q, links, none = np.zeros((8, 7)), model.robot.link_parameters, np.zeros(len(model.columns))
clock = time.perf_counter if not cached else time.process_time
compile = lieid.compile  # its import is not counted
start = clock()
arm = compile(model)
arm.base_regressor(q, q, q)
middle = clock()
arm.regressor(q, q, q), arm.inverse_dynamics(q, q, q, links), arm.effect_torque(q, q, q, none)
arm.mass_matrix(q, links), arm.gravity(q, links), arm.jacobian(q), arm.effect_columns(q, q, q)
print(middle - start, clock() - start)
"""


def compile_rows():
    rows = []
    with tempfile.TemporaryDirectory() as cache:
        environment = os.environ | {"LIEID_CACHE_DIR": cache}

        def run(cached):
            command = [sys.executable, "-c", f"cached = {cached}\n{COMPILE}"]
            done = subprocess.run(command, env=environment, capture_output=True, check=True)
            return [float(number) for number in done.stdout.split()]

        cold = run(False)  # wall time: two compilers work at once
        cached = np.median([run(True) for _ in range(5)], axis=0)
    for name, seconds, target in (("cold", cold, 5.0), ("cached", cached, 0.05)):
        what = f"compile, {name}: base regressor of all effects"
        rows.append(Row("panda", what, float(seconds[0]), target))
        rows.append(Row("panda", f"compile, {name}: every function", float(seconds[1]), target))
    return rows


def show(rows):
    table = Table(title="lieid-casadi, one core, medians of processor time")
    for heading in ("arm", "what", "time", "must", "Pinocchio", "ratio", "limit", "of limit"):
        table.add_column(heading, justify="left" if heading in ("arm", "what") else "right")
    for r in rows:
        table.add_row(
            r.arm, r.what, _time(r.seconds), _time(r.target), _time(r.pinocchio),
            f"{r.pinocchio / r.seconds:.0f}×" if r.pinocchio else "",
            f"{_time(r.limit)} {r.limited_by}" if r.limit else "",
            f"{100 * r.limit / r.seconds:.0f} %" if r.limit else "",
        )  # fmt: skip
    Console(width=160).print(table)


def _time(seconds):
    if seconds is None:
        return ""
    return f"{1e6 * seconds:.3f} µs" if seconds < 1e-3 else f"{1e3 * seconds:.0f} ms"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="write the rows here")
    options = parser.parse_args()
    targets = available_targets()
    with tempfile.TemporaryDirectory() as folder:
        make = Compiled(folder)
        peak = (HERE / "peak.c").read_text()
        scalar = peak_operations(make.library(peak, targets[-1]))
        vector = targets[0].lanes * peak_operations(make.library(peak, targets[0]))
        rows = []
        for robot in (arms.panda(), arms.six_joints(), arms.twelve_joints()):
            rows += rows_of(robot, make, (scalar, vector))
    rows += compile_rows()
    show(rows)
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")


if __name__ == "__main__":
    main()
