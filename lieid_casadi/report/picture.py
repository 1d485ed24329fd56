"""Figures embedded in a page."""

from __future__ import annotations

from base64 import b64encode
from io import BytesIO
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def data_uri(figure: Figure, *, dpi: float = 110.0, colors: int | None = None) -> str:
    """Return a figure as a PNG in a ``data:`` URI, of as many colors (a quarter of the bytes).

    Parameters
    ----------
    figure : Figure
    dpi : float
        Pixels per inch.
    colors : int, optional
        All of them if left out.
    """
    stream = BytesIO()
    figure.savefig(stream, format="png", dpi=dpi, metadata={"Software": None})
    if colors is not None:
        from PIL import Image  # Matplotlib requires it

        picture = Image.open(stream).convert("RGB").quantize(colors)
        stream = BytesIO()
        picture.save(stream, "png", optimize=True)
    return "data:image/png;base64," + b64encode(stream.getvalue()).decode("ascii")
