"""Sections of the page: text with tables, figures, and claims with verdicts."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Cell = str | float | int
INK = "#1f2933"
COLOURS = ("#1b6ca8", "#d1495b", "#edae49", "#66a182", "#6d597a")


@dataclass(frozen=True)
class Claim:
    """A statement of the paper, or a requirement of this project, and the verdict on it.

    Attributes
    ----------
    source : str
        Section of the paper.
    text : str
    holds : bool or None
        None where the numbers do not decide: a difference within its uncertainty, or a
        statement without a limit.
    evidence : str
        The numbers of the verdict.
    ranking : bool
        Whether the statement is that one model or criterion is better than another.
    """

    source: str
    text: str
    holds: bool | None
    evidence: str
    ranking: bool = False

    @property
    def verdict(self) -> str:
        """The verdict in words."""
        return {True: "holds", False: "does not hold", None: "not decided"}[self.holds]

    def row(self) -> list[Cell]:
        """Return the claim as a row of a table."""
        verdict = f"**{self.verdict}**" if self.holds is False else self.verdict
        return [self.source, self.text, verdict, self.evidence]


@dataclass(frozen=True)
class Section:
    """One table or figure of the paper."""

    title: str
    body: str
    claims: tuple[Claim, ...] = ()
    pictures: dict[str, Figure] = field(default_factory=dict)

    def markdown(self) -> str:
        """Return the section with links to its figures."""
        return f"## {self.title}\n\n{self.body.strip()}\n"

    def draw(self, folder: Path) -> None:
        """Write the figures into a folder."""
        from matplotlib import pyplot as plt
        from PIL import Image

        folder.mkdir(parents=True, exist_ok=True)
        for name, figure in self.pictures.items():
            drawn = io.BytesIO()
            figure.savefig(drawn, format="png", dpi=110)
            plt.close(figure)
            with Image.open(drawn) as image:  # a palette halves the size of the file
                image.convert("RGB").quantize(128).save(folder / f"{name}.png", optimize=True)


def table(header: Sequence[Cell], rows: Sequence[Sequence[Cell]]) -> str:
    """Return a markdown table; numbers are right-aligned."""
    right = [any(isinstance(row[k], float) for row in rows) for k in range(len(header))]
    lines: list[Sequence[Cell]] = [header, ["--:" if r else "---" for r in right], *rows]
    return "\n".join("| " + " | ".join(_cell(x) for x in line) + " |" for line in lines) + "\n"


def _cell(value: Cell) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, int | np.integer):
        return str(value)
    return "–" if np.isnan(value) else f"{value:.4f}"


def joints(n: int) -> list[str]:
    """Return the headings of the columns of n joints."""
    return [f"joint {j + 1}" for j in range(n)]


def listed(found: Sequence[int] | np.ndarray) -> str:
    """Return joints (from 0) as text, numbered from 1."""
    if len(found) == 0:
        return "no joint"
    return f"joint{'s' * (len(found) > 1)} {', '.join(str(j + 1) for j in found)}"


def listed_claims(claims: Sequence[Claim]) -> str:
    """Return claims as a markdown list."""
    return "\n".join(f"- {c.text} ({c.source}): {c.evidence}" for c in claims) or "- none"


def plain_logarithmic(axis: Axes, low: float, high: float) -> None:
    """Make an axis of speeds logarithmic, with few plain ticks."""
    axis.set_xscale("log")
    ticks = [x for x in (0.1, 0.3, 1, 3, 5, 10, 20, 30) if low * 0.99 <= x <= high * 1.01]
    if high / low > 50.0:
        ticks = [x for x in ticks if x not in (5, 20)]
    axis.set_xticks(ticks, [f"{x:g}" for x in ticks])
    axis.set_xticks([], minor=True)


def show(section: Section) -> None:
    """Print a section on the terminal."""
    print(section.markdown())
    for claim in section.claims:
        print(f"- {claim.text}: {claim.verdict} ({claim.evidence})")
