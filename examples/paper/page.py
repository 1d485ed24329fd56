"""What a script hands to the page: text with tables, pictures, and claims that hold or do not."""

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
INK, PALE = "#1f2933", "#8b98a5"
COLOURS = ("#1b6ca8", "#d1495b", "#edae49", "#66a182", "#6d597a")


@dataclass(frozen=True)
class Claim:
    """A sentence of the paper, whether it holds here, and the numbers that say so.

    ``ranking``: it says that one model is better than another.
    """

    source: str
    text: str
    holds: bool
    evidence: str
    ranking: bool = False

    def row(self) -> list[Cell]:
        """Return the claim as a table's row."""
        verdict = "holds" if self.holds else "**does not hold**"
        return [self.source, self.text, verdict, self.evidence]


@dataclass(frozen=True)
class Section:
    """One table or figure of the paper."""

    title: str
    body: str
    claims: tuple[Claim, ...] = ()
    pictures: dict[str, Figure] = field(default_factory=dict)

    def markdown(self) -> str:
        """Return the section with links to its pictures."""
        return f"## {self.title}\n\n{self.body.strip()}\n"

    def draw(self, folder: Path) -> None:
        """Write the pictures into a folder."""
        from matplotlib import pyplot as plt
        from PIL import Image

        folder.mkdir(parents=True, exist_ok=True)
        for name, figure in self.pictures.items():
            drawn = io.BytesIO()
            figure.savefig(drawn, format="png", dpi=110)
            plt.close(figure)
            with Image.open(drawn) as image:  # flat colours: a palette halves the file
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
    """Return the heads of n joints' columns."""
    return [f"joint {j + 1}" for j in range(n)]


def listed(found: Sequence[int] | np.ndarray) -> str:
    """Return joints (from 0) as people name them."""
    if len(found) == 0:
        return "no joint"
    return f"joint{'s' * (len(found) > 1)} {', '.join(str(j + 1) for j in found)}"


def listed_claims(claims: Sequence[Claim]) -> str:
    """Return claims as a list."""
    return "\n".join(f"- {c.text} ({c.source}): {c.evidence}" for c in claims) or "- none"


def plain_logarithmic(axis: Axes, low: float, high: float) -> None:
    """Give an axis of speeds ticks that are read at a glance."""
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
        print(f"- {claim.text}: {'holds' if claim.holds else 'does not hold'} ({claim.evidence})")
