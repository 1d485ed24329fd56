"""Table III: four criteria from random starts, by `examples/table_3.py`."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
from arm import PRINTED
from lab import Lab
from page import Claim, Section, show, table

COLUMN_SETS = {"inertial columns": "", "with 5 friction columns a joint": None}


def section(lab: Lab) -> Section:
    """Run the criteria and set them beside the printed table."""
    script = _script()
    printed = {name: np.median(rows, axis=0) for name, rows in PRINTED["table_3"].items()}
    rows = [["paper, median", *_cells(printed, script.CRITERIA)]]
    claims: list[Claim] = []
    for title, effects in COLUMN_SETS.items():
        wanted = script.FRICTION if effects is None else effects
        results = {
            name: np.median(script.run(wanted, criterion, range(lab.criterion_starts)), axis=0)
            for name, criterion in script.CRITERIA.items()
        }
        rows.append([f"here, {title}", *_cells(results, script.CRITERIA)])
        claims += _claims(title, results)
    body = (
        f"Condition number, −log det, seconds of one start; medians of {lab.criterion_starts} "
        "random starts here, of 5 in the paper. The paper does not state the columns' scaling "
        "behind its numbers and has no column for C4 alone; compare within a row.\n\n"
        + table(["", "C1 combined", "C2 condition", "C3 Hadamard", "C4 log det"], rows)
    )
    return Section("Table III: excitation criteria", body, tuple(claims))


def _cells(results: dict[str, np.ndarray], names: dict[str, str]) -> list[str]:
    return [
        f"{results[k][0]:.4g}, {results[k][1]:.4g}, {results[k][2]:.3g} s" if k in results else "–"
        for k in names
    ]


def _claims(title: str, results: dict[str, np.ndarray]) -> list[Claim]:
    c1, c2, c3 = (results[name] for name in ("C1", "C2", "C3"))
    source = f"6.3, {title}"
    return [
        Claim(
            source,
            "C1 takes about 30 % of C2's time",
            bool(c1[2] <= 0.4 * c2[2]),
            f"{100 * c1[2] / c2[2]:.0f} %",
            ranking=True,
        ),
        Claim(
            source,
            "C1's condition number is close to C2's",
            bool(c1[0] <= 1.15 * c2[0]),
            f"{c1[0] / c2[0]:.2f} of it",
            ranking=True,
        ),
        Claim(
            source,
            "C1's −log det is better than C2's",
            bool(c1[1] < c2[1]),
            f"{c1[1] - c2[1]:+.1f}",
            ranking=True,
        ),
        Claim(
            source,
            "C1's condition number is better than C3's",
            bool(c1[0] < c3[0]),
            f"{c1[0] / c3[0]:.2f} of it",
            ranking=True,
        ),
    ]


def _script() -> ModuleType:
    path = Path(__file__).parents[1] / "table_3.py"
    specification = importlib.util.spec_from_file_location("table_3", path)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


if __name__ == "__main__":
    show(section(Lab()))
