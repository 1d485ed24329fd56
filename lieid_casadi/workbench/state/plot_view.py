"""The part of the recordings that the plots show."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PlotView:
    """What the plots show; not saved.

    Attributes
    ----------
    window : (float, float) or None
        First and last time that is visible, s; None for the whole recording.
    selection : (float, float) or None
        Range of time that the user has selected, s.
    compared : int or None
        Position of the step in the history that the current one is compared with.
    """

    window: tuple[float, float] | None = None
    selection: tuple[float, float] | None = None
    compared: int | None = None
