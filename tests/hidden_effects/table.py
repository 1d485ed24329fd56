"""Table of the benchmark: goals, rates by effect and size with exact intervals, confusion."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from hidden_effects.case_setup import Case
from hidden_effects.score import CLOSE_TO_TRUE_MODEL
from rich.console import Console
from rich.table import Table
from scipy.stats import binomtest

Row = dict[str, Any]
OTHER_JOINT = "right effect, other joint"
COUNTED = 1.0  # multiples of the noise, from which an effect counts for the goals


@dataclass(frozen=True)
class Rate:
    """A rate with its exact (Clopper-Pearson) 95 % interval."""

    hits: int
    total: int

    @classmethod
    def of(cls, rows: Iterable[Row], test: Callable[[Row], bool]) -> Rate:
        values = [bool(test(row)) for row in rows]
        return cls(sum(values), len(values))

    @property
    def interval(self) -> tuple[float, float]:
        if not self.total:
            return 0.0, 1.0
        found = binomtest(self.hits, self.total).proportion_ci(0.95, method="exact")
        return float(found.low), float(found.high)

    @property
    def value(self) -> float:
        return self.hits / self.total if self.total else float("nan")

    def __str__(self) -> str:
        if not self.total:
            return "–"
        low, high = self.interval
        share = f"{100 * self.value:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"
        return f"{self.hits}/{self.total} = {share}"


@dataclass(frozen=True)
class Goal:
    """A required rate and the measured one."""

    description: str
    rate: Rate
    required: float
    at_most: bool = False

    @property
    def is_met(self) -> bool | None:
        if not self.rate.total:
            return None
        return (
            self.rate.value <= self.required if self.at_most else self.rate.value >= self.required
        )


def size_of(row: Row) -> float:
    """Return the smallest size of the effects of a case."""
    return min((e["target"] for e in row["truth"]), default=0.0)


def counted(rows: Iterable[Row], mode: str, kind: str) -> list[Row]:
    """Return the rows that count for a goal."""
    return [
        r for r in rows
        if r["mode"] == mode and r["kind"] == kind and (kind == "none" or size_of(r) >= COUNTED)
    ]  # fmt: skip


def goals(rows: Sequence[Row]) -> list[Goal]:
    """Return all goals with the measured rates."""
    right: Callable[[Row], bool] = lambda r: r["right"]  # noqa: E731
    in_set: Callable[[Row], bool] = lambda r: r["right_in_set"]  # noqa: E731
    wrong: Callable[[Row], bool] = lambda r: not r["right"]  # noqa: E731
    single, pair = (counted(rows, "missing", kind) for kind in ("single", "pair"))
    triple, none = (counted(rows, "missing", kind) for kind in ("triple", "none"))
    foreign, form = (counted(rows, "missing", kind) for kind in ("foreign", "form"))
    world = [r for r in rows if r["kind"] == "world"]
    compared = [r for r in single + pair if r.get("rms_ratio") is not None]
    lines = [
        Goal("single: right effect first", Rate.of(single, lambda r: r["right_first"]), 0.95),
        Goal("single: right and nothing else", Rate.of(single, right), 0.95),
        Goal("single: right or in the stated set, nothing else", Rate.of(single, in_set), 0.99),
        Goal("pair: both and nothing else", Rate.of(pair, right), 0.85),
        Goal("pair: the same, stated sets allowed", Rate.of(pair, in_set), 0.85),
        Goal("triple: all and nothing else", Rate.of(triple, right), 0.0),
        Goal("none: false alarm", Rate.of(none, wrong), 0.05, at_most=True),
        Goal("none: an effect named", Rate.of(none, lambda r: r["named"]), 0.03, at_most=True),
        Goal("violated assumptions: a wrong name", Rate.of(world, wrong), 0.05, at_most=True),
        Goal(
            f"test RMS within {CLOSE_TO_TRUE_MODEL:g} of a fit of the true model",
            Rate.of(compared, lambda r: r["rms_ratio"] <= CLOSE_TO_TRUE_MODEL), 0.95,
        ),
        Goal("foreign: no step, right joint and signals first", Rate.of(foreign, right), 0.90),
        Goal("foreign form: class named or signal first", Rate.of(form, right), 0.90),
        Goal("foreign form: class named first", Rate.of(form, lambda r: r["first_named"]), 0.0),
        Goal("foreign: no step", Rate.of(foreign, lambda r: r["no_step"]), 0.90),
    ]  # fmt: skip
    changed = {kind: counted(rows, "changed", kind) for kind in ("single", "none", "foreign")}
    return [
        *lines,
        Goal(
            "changed: right cause first",
            Rate.of(changed["single"], lambda r: r["right_first"]), 0.95,
        ),
        Goal("changed: right cause and nothing else", Rate.of(changed["single"], right), 0.95),
        Goal("changed: right cause or in the set", Rate.of(changed["single"], in_set), 0.95),
        Goal("changed: pair", Rate.of(counted(rows, "changed", "pair"), right), 0.90),
        Goal("changed: triple", Rate.of(counted(rows, "changed", "triple"), right), 0.0),
        Goal("changed: nothing, false alarm", Rate.of(changed["none"], wrong),
            0.05, at_most=True),
        Goal("changed: foreign", Rate.of(changed["foreign"], right), 0.90),
    ]  # fmt: skip


def show(rows: Sequence[Row], console: Console | None = None) -> None:
    """Print goals, rates by effect and size, and times."""
    console = console or Console(width=140)
    table = Table(title="Goals (effects of at least 1 × the noise)", title_justify="left")
    for heading in ("measure", "measured [95 %]", "goal", "met"):
        table.add_column(heading)
    for goal in goals(rows):
        sign = "≤" if goal.at_most else "≥"
        met = {None: "", True: "yes", False: "NO"}[goal.is_met]
        required = f"{sign} {100 * goal.required:.0f} %" if goal.required else "–"
        table.add_row(goal.description, str(goal.rate), required, met if goal.required else "")
    console.print(table)
    for mode in ("missing", "changed"):
        for kind in ("single", "foreign"):
            _by_effect(console, [r for r in rows if r["mode"] == mode and r["kind"] == kind], mode)
    _by_effect(console, [r for r in rows if r["kind"] == "form"], "missing")
    _by_world(console, [r for r in rows if r["kind"] == "world"])
    seconds = [r["seconds"] for r in rows if "seconds" in r]
    if seconds:
        console.print(
            f"{len(seconds)} results; seconds: median {np.median(seconds):.1f}, "
            f"95 % below {np.percentile(seconds, 95):.1f}, longest {max(seconds):.1f}"
        )
    errors = [r for r in rows if "error" in r]
    if errors:
        console.print(f"{len(errors)} failed, for example with {errors[0]['error']}")


def _by_effect(console: Console, rows: list[Row], mode: str) -> None:
    if not rows:
        return
    sizes = sorted({e["target"] for r in rows for e in r["truth"]}, reverse=True)
    table = Table(title=f"{mode}: {rows[0]['kind']}, right and nothing else", title_justify="left")
    for heading in ("effect", *(f"{size:g}×" for size in sizes), "in the set, ≥ 1×"):
        table.add_column(heading)
    for effect in sorted({r["truth"][0]["effect"] for r in rows}):
        own = [r for r in rows if r["truth"][0]["effect"] == effect]
        cells = [
            str(Rate.of([r for r in own if size_of(r) == size], lambda r: r["right"]))
            for size in sizes
        ]
        large = [r for r in own if size_of(r) >= COUNTED]
        in_set = Rate.of(large, lambda r: r.get("right_in_set", r["right"]))
        table.add_row(effect, *cells, str(in_set))
    console.print(table)


def _by_world(console: Console, rows: list[Row]) -> None:
    if not rows:
        return
    table = Table(title="violated assumptions: wrong names", title_justify="left")
    for heading in ("assumption", "a wrong name", "names, wrong or right"):
        table.add_column(heading)
    world = {r["case"]: Case.parse(r["case"]).effect for r in rows}
    for name in sorted(set(world.values())):
        own = [r for r in rows if world[r["case"]] == name]
        names = sorted({str(step[0]) for r in own for step in r["steps"]})
        table.add_row(name, str(Rate.of(own, lambda r: not r["right"])), ", ".join(names))
    console.print(table)


def named_first(row: Row) -> str:
    """Return the first finding: an effect, perhaps on another joint, unexplained, or nothing."""
    if not row["completed"]:
        return "failed"
    if not row["steps"]:
        return "unexplained" if row["verdict"] == "unexplained" else "nothing"
    name, joints = row["steps"][0]
    places = [e["joints"] for e in row["truth"] if e["effect"] == name]
    return str(name) if not places or list(joints) in places else OTHER_JOINT


def confusion_picture(rows: Sequence[Row], path: Path, mode: str = "missing") -> None:
    """Draw the first finding for each hidden effect (singles, none, foreign)."""
    from matplotlib.figure import Figure

    rows = [
        r for r in rows
        if r["mode"] == mode and r["kind"] in ("single", "none", "foreign")
        and (r["kind"] == "none" or size_of(r) >= COUNTED)
    ]  # fmt: skip
    kinds = {"none": "(nothing)", "foreign": "(not in the library)"}
    hidden = [kinds.get(r["kind"]) or str(r["truth"][0]["effect"]) for r in rows]
    down = sorted(set(hidden), key=lambda x: (x.startswith("("), x))
    across = sorted({d for d in down if not d.startswith("(")} | {named_first(r) for r in rows})
    across.sort(key=lambda x: (x in (OTHER_JOINT, "nothing", "unexplained", "failed"), x))
    counts = np.zeros((len(down), len(across)))
    for name, row in zip(hidden, rows, strict=True):
        counts[down.index(name), across.index(named_first(row))] += 1
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)
    figure = Figure(
        figsize=(1.8 + 0.36 * len(across), 1.8 + 0.32 * len(down)), layout="constrained"
    )
    ax = figure.add_subplot()
    ax.imshow(share, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for i, j in zip(*np.nonzero(counts), strict=True):
        ax.text(
            j, i, f"{counts[i, j]:.0f}", ha="center", va="center", fontsize=7,
            color="white" if share[i, j] > 0.5 else "black",
        )  # fmt: skip
    ax.set_xticks(range(len(across)), across, rotation=60, ha="right", fontsize=7)
    ax.set_yticks(range(len(down)), down, fontsize=7)
    ax.set_xlabel("named first")
    ax.set_ylabel("hidden")
    figure.savefig(path, dpi=150)
