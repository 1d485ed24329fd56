"""Colours of the page: Okabe and Ito's, and a scale that grows darker with the error."""

from __future__ import annotations

from lieid_casadi.comparison.verdict import AS_NOISE, BEYOND_NOISE

UNKNOWN_COLOUR = "#b8bec4"
#: Largest error over noise floor of each class and its colour; readable without red and green.
SCALE = (
    (AS_NOISE, "#7fb8dc"),
    (BEYOND_NOISE, "#e6d36a"),
    (5.0, "#e69f00"),
    (float("inf"), "#b03a00"),
)
#: Lines for successive models and effects.
SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#6a51a3", "#555555")


def ratio_colour(ratio: float | None) -> str:
    """Return the colour of an error in multiples of the noise floor."""
    if ratio is None:
        return UNKNOWN_COLOUR
    return next(colour for most, colour in SCALE if ratio <= most)
