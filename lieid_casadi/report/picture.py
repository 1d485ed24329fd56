"""Figures embedded in a page."""

from __future__ import annotations

from base64 import b64encode
from io import BytesIO
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def data_uri(figure: Figure, *, dpi: float = 110.0) -> str:
    """Return a figure as a PNG in a ``data:`` URI."""
    stream = BytesIO()
    figure.savefig(stream, format="png", dpi=dpi, metadata={"Software": None})
    return "data:image/png;base64," + b64encode(stream.getvalue()).decode("ascii")
