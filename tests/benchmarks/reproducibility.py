"""Ranges of the demo's numbers: ``python tests/benchmarks/reproducibility.py [--seeds N]``.

OpenBLAS selects its kernels by processor, and the order in which they sum differs. The optimizer
of the excitation amplifies this rounding: its path, and with it the optimum that it reaches,
depends on the processor. The generated C gives the same bits for every vector width
(``tests/compiled/test_against_machine.py``) and does not add to it. Each setting runs
``lieid demo`` in a process of its own; a statement about the demo holds on any machine if it holds
over the ranges printed here.
"""

import argparse
import itertools
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from rich.console import Console
from rich.progress import track
from rich.table import Table

KERNELS = ("SkylakeX", "Haswell", "Nehalem")  # OPENBLAS_CORETYPE: AVX-512, AVX2, SSE
JOINT = 1  # 0-based; the joint with the hidden effect


def demo(seed: int, kernels: str, threads: int) -> dict[str, float | str]:
    """Run ``lieid demo`` under the given settings and return its numbers."""
    settings = {
        "OPENBLAS_CORETYPE": kernels,
        "LIEID_THREADS": str(threads),
        "OPENBLAS_NUM_THREADS": str(threads),
        "OMP_NUM_THREADS": str(threads),
        "MPLBACKEND": "Agg",
    }
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "demo.json"
        command = [sys.executable, "-m", "lieid_casadi.cli.main", "demo", "--seed", str(seed)]
        command += ["-o", str(Path(folder) / "demo"), "--json", str(target)]
        subprocess.run(command, env=os.environ | settings, check=True, capture_output=True)
        content = json.loads(target.read_text())
    steps = [
        f"{step['effect']}:{'+'.join(str(j) for j in step['joints'])}"
        for step in content["diagnosis"]["steps"]
    ]
    return {
        "condition number": content["excitation"]["condition_number"],
        "before": content["before"]["rms_moving"][JOINT],
        "after": content["after"]["rms_moving"][JOINT],
        "found": ", ".join(steps) or "nothing",
    }


def main() -> None:
    """Print one row per setting and the range of each number."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    args = parser.parse_args()
    settings = [(0, kernels, threads) for kernels, threads in itertools.product(KERNELS, (1, 2))]
    settings += [(seed, KERNELS[0], 1) for seed in range(1, args.seeds)]
    results = [demo(*each) for each in track(settings, "lieid demo", console=Console(stderr=True))]
    table = Table(title=f"lieid demo, joint {JOINT + 1}: error on the test motion, N·m")
    for heading in ("seed", "OpenBLAS", "threads", *results[0]):
        table.add_column(heading)
    for setting, result in zip(settings, results, strict=True):
        numbers = [f"{v:.4g}" if isinstance(v, float) else str(v) for v in result.values()]
        table.add_row(*map(str, setting), *numbers)
    Console(width=130).print(table)
    for name in ("condition number", "before", "after"):
        values = [float(result[name]) for result in results]
        Console().print(f"{name}: {min(values):.3g} to {max(values):.3g}")


if __name__ == "__main__":
    main()
