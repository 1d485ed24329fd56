"""A small picture of points, as SVG."""

from __future__ import annotations

from html import escape

from lieid_casadi.comparison.plot_style import BACKWARD, FORWARD
from lieid_casadi.workbench.computing.results import EffectCurve
from lieid_casadi.workbench.views.elements import figures

WIDTH, HEIGHT, MARGIN = 270.0, 62.0, 4.0


def curve_svg(curve: EffectCurve, unit: str) -> str:
    """Return the torque of an effect over its signal; the texts are the ranges of both axes.

    Parameters
    ----------
    curve : EffectCurve
    unit : str
        Of the torque.
    """
    xs, ys = curve.signal, curve.torque
    low, high = min(xs), max(xs)
    most = max(max(abs(y) for y in ys), 1e-12)
    names = {"dq": "speed", "ddq": "acceleration", "q": "angle"}
    across, down = WIDTH - 2 * MARGIN, HEIGHT - 2 * MARGIN - 12.0
    points = "".join(
        f'<circle cx="{MARGIN + across * (x - low) / (high - low or 1.0):.1f}" '
        f'cy="{MARGIN + down * (0.5 - 0.5 * y / most):.1f}" r="1.4" '
        f'fill="{FORWARD if y >= 0.0 else BACKWARD}"/>'
        for x, y in zip(xs, ys, strict=True)
    )
    middle = MARGIN + 0.5 * down
    text = (
        f"± {figures(most)} {unit} over {names.get(curve.name, curve.name)} "
        f"{figures(low)} to {figures(high)} {curve.unit}"
    )
    return (
        f'<svg viewBox="0 0 {WIDTH:.0f} {HEIGHT:.0f}" width="100%" role="img" '
        f'aria-label="{escape(text)}">'
        f'<line x1="0" x2="{WIDTH:.0f}" y1="{middle:.1f}" y2="{middle:.1f}" stroke="#c8ced4"/>'
        f'{points}<text x="{MARGIN}" y="{HEIGHT - 3:.0f}" font-size="9.5" fill="#52606d">'
        f"{escape(text)}</text></svg>"
    )
