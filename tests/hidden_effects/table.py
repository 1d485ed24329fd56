"""Table of the benchmark: rates with exact intervals, by effect and size, and confusion."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from hidden_effects.case_setup import Case
from rich.console import Console
from rich.table import Table
from scipy.stats import binomtest

Row = dict[str, Any]
OTHER_JOINT = "right effect, other joint"
COUNTED = 1.0  # multiples of the noise, from which an effect counts for the goals
DETECTABLE = 10.0  # standard deviations above noise of this correlation, likewise
CLOSE = 1.05  # error on an unseen recording relative to a fit that knew what is hidden


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
    """A measured rate and the required one; 0: none."""

    description: str
    rate: Rate
    required: float = 0.0
    at_most: bool = False

    @property
    def is_met(self) -> bool | None:
        if not self.rate.total or not self.required:
            return None
        return (
            self.rate.value <= self.required if self.at_most else self.rate.value >= self.required
        )

    def cells(self) -> tuple[str, str, str, str]:
        sign = "≤" if self.at_most else "≥"
        met = {None: "", True: "yes", False: "NO"}[self.is_met]
        required = f"{sign} {100 * self.required:g} %" if self.required else "–"
        return self.description, str(self.rate), required, met


def size_of(row: Row) -> float:
    """Return the smallest size of the effects of a case."""
    return min((e["target"] for e in row["truth"]), default=0.0)


def counts(row: Row) -> bool:
    """Whether the effects of a case are large enough for the goals."""
    return all(
        e["target"] >= COUNTED and (e.get("deviations") or np.inf) >= DETECTABLE
        for e in row["truth"]
    )


def goals(rows: Sequence[Row]) -> list[Goal]:
    """Return all rates, of cases whose effects are large enough."""
    every = [r for r in rows if counts(r)]

    def of(mode: str, *kinds: str) -> list[Row]:
        return [r for r in every if r["mode"] == mode and r["kind"] in kinds]

    def rate(chosen: list[Row], key: str) -> Rate:
        return Rate.of(chosen, lambda r: r.get(key, False))

    single, pair, triple, six = (
        of("missing", kind) for kind in ("single", "pair", "triple", "six")
    )
    nothing = of("missing", "none", "correlated")
    changed, unchanged = of("changed", "single"), of("changed", "none", "correlated")
    foreign, form = of("missing", "foreign"), of("missing", "form")
    world, by_foreign = of("missing", "world"), of("changed", "foreign")
    knew, of_six, harmed = (
        [r for r in rows if r.get("rms_ratio") is not None]
        for rows in (single + pair + triple, six, nothing)
    )
    close = lambda r: r["rms_ratio"] <= CLOSE  # noqa: E731
    wrong = lambda r: not r["right"]  # noqa: E731
    return [
        Goal("single: right first", rate(single, "right_first"), 0.97),
        Goal("single: right first, or in the stated set", rate(single, "right_first_in_set"), 0.97),
        Goal("single: complete and nothing else", rate(single, "right")),
        Goal("single: the same, stated sets allowed", rate(single, "right_in_set")),
        Goal("pair: complete and nothing else", rate(pair, "right")),
        Goal("pair: the same, stated sets allowed", rate(pair, "right_in_set")),
        Goal("triple: the same, stated sets allowed", rate(triple, "right_in_set")),
        Goal(f"test RMS within {CLOSE:g} of a fit that knew", Rate.of(knew, close), 0.95),
        Goal("six effects: the same, stated sets allowed", rate(six, "right_in_set")),
        Goal(f"six effects: test RMS within {CLOSE:g} of a fit that knew", Rate.of(of_six, close)),
        Goal("nothing hidden: false names or shapes", rate(nothing, "name_or_shape"), 0.02, True),
        Goal("nothing hidden: false names", rate(nothing, "name"), 0.02, True),
        Goal("nothing hidden: not sufficient", Rate.of(nothing, wrong)),
        Goal(f"nothing hidden: test RMS within {CLOSE:g}", Rate.of(harmed, close)),
        Goal("outside the library: right", rate(foreign, "right"), 0.90),
        Goal("outside the library: right joint and signals", rate(foreign, "signals_right")),
        Goal("outside the library: no effect named", rate(foreign, "no_wrong_step")),
        Goal("other form: class, or right signal", rate(form, "right"), 0.90),
        Goal("violated assumption: a wrong name", Rate.of(world, wrong), 0.05, True),
        Goal("changed: right first", rate(changed, "right_first"), 0.95),
        Goal("changed: right first, or in the stated set", rate(changed, "right_first_in_set")),
        Goal("changed: complete and nothing else", rate(changed, "right")),
        Goal("changed: the same, stated sets allowed", rate(changed, "right_in_set")),
        Goal("changed: pair, stated sets allowed", rate(of("changed", "pair"), "right_in_set")),
        Goal("changed: by an effect outside the library", rate(by_foreign, "right")),
        Goal("nothing changed: names or shapes", rate(unchanged, "name_or_shape"), 0.02, True),
        Goal("nothing changed: not sufficient", Rate.of(unchanged, wrong)),
        Goal("all: named wrongly", rate(every, "named_wrongly"), 0.02, True),
        Goal("all: failed", Rate.of(every, lambda r: not r["completed"]), 0.005, True),
    ]


def markdown(rows: Sequence[Row]) -> str:
    """Return the table of goals for the documentation."""
    lines = ["| measure | measured [95 %] | goal | met |", "| --- | --- | --- | --- |"]
    lines += [f"| {' | '.join(goal.cells())} |" for goal in goals(rows) if goal.rate.total]
    return "\n".join(lines) + "\n"


def show(rows: Sequence[Row], console: Console | None = None) -> None:
    """Print goals, rates by effect and size, and times."""
    console = console or Console(width=140)
    title = f"Effects of at least {COUNTED:g} × the noise and {DETECTABLE:g} standard deviations"
    table = Table(title=title, title_justify="left")
    for heading in ("measure", "measured [95 %]", "goal", "met"):
        table.add_column(heading)
    for goal in goals(rows):
        if goal.rate.total:
            table.add_row(*goal.cells())
    console.print(table)
    for mode in ("missing", "changed"):
        for kind in ("single", "foreign"):
            _by_effect(console, [r for r in rows if r["mode"] == mode and r["kind"] == kind], mode)
    _by_effect(console, [r for r in rows if r["kind"] == "form"], "missing")
    _by_world(console, [r for r in rows if r["kind"] == "world"])
    _by_correlation(console, rows)
    small = sum(not counts(r) for r in rows)
    if small:
        console.print(f"{small} cases with smaller effects are only in the tables by effect")
    seconds = [r["seconds"] for r in rows if "seconds" in r]
    if seconds:
        console.print(
            f"{len(seconds)} results; seconds of processor time: median {np.median(seconds):.1f}, "
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
    for heading in ("effect", *(f"{size:g}×" for size in sizes), "in the set, large enough"):
        table.add_column(heading)
    for effect in sorted({r["truth"][0]["effect"] for r in rows}):
        own = [r for r in rows if r["truth"][0]["effect"] == effect]
        cells = [
            str(Rate.of([r for r in own if size_of(r) == size], lambda r: r["right"]))
            for size in sizes
        ]
        large = [r for r in own if counts(r)]
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
        names = sorted({str(step["effect"]) for r in own for step in r["steps"]})
        table.add_row(name, str(Rate.of(own, lambda r: not r["right"])), ", ".join(names))
    console.print(table)


def _by_correlation(console: Console, rows: Sequence[Row]) -> None:
    """Print how the rates depend on the correlation time of the noise."""
    table = Table(title="by the correlation time of the noise (missing effects)",
                  title_justify="left")  # fmt: skip
    for heading in ("s", "single: right first or in the set", "nothing hidden: a name or shape",
                    "named wrongly"):  # fmt: skip
        table.add_column(heading)
    edges = (0.0, 0.05, 0.15, 0.4, 1.1)
    for low, high in pairwise(edges):
        own = [
            r for r in rows
            if r["mode"] == "missing" and low <= (r.get("correlation_time") or 0.0) < high
            and counts(r)
        ]  # fmt: skip
        single = [r for r in own if r["kind"] == "single"]
        nothing = [r for r in own if r["kind"] in ("none", "correlated")]
        table.add_row(
            f"{low:g} to {high:g}",
            str(Rate.of(single, lambda r: r["right_first_in_set"])),
            str(Rate.of(nothing, lambda r: r["name_or_shape"])),
            str(Rate.of(own, lambda r: r["named_wrongly"])),
        )
    console.print(table)


def named_first(row: Row) -> str:
    """Return the first finding: an effect, perhaps on another joint, unexplained, or nothing."""
    if not row["completed"]:
        return "failed"
    if not row["steps"]:
        return "unexplained" if row["verdict"] == "unexplained" else "nothing"
    name, joints = row["steps"][0]["effect"], row["steps"][0]["joints"]
    places = [e["joints"] for e in row["truth"] if e["effect"] == name]
    return str(name) if not places or list(joints) in places else OTHER_JOINT


def confusion_picture(rows: Sequence[Row], path: Path, mode: str = "missing") -> None:
    """Draw the first finding for each hidden effect (singles, none, foreign)."""
    from matplotlib.figure import Figure

    rows = [
        r for r in rows
        if r["mode"] == mode and r["kind"] in ("single", "none", "foreign")
        and counts(r)
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
