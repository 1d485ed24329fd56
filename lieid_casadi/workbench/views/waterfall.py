"""Errors of the successive models on every joint, relative to the first model."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nicegui import ui

from lieid_casadi.workbench.state.session import ModelStep
from lieid_casadi.workbench.views.chart import Chart
from lieid_casadi.workbench.views.colours import SERIES

if TYPE_CHECKING:
    from lieid_casadi.workbench.workbench import Workbench

MOST_MODELS = 6


class WaterfallView:
    """Bars: error on the test; diamonds: on the training; dashes: noise floor.

    Parameters
    ----------
    workbench : Workbench
    """

    def __init__(self, workbench: Workbench) -> None:
        self._workbench = workbench
        self._shown: object = None
        with ui.column().classes("panel w-full h-full"):
            ui.label("Error of each model, first model = 1").classes("panel-title")
            self._chart = Chart("waterfall", _options([]))

    def update(self) -> None:
        """Draw the models up to the one that is shown."""
        session = self._workbench.session
        steps = [s for s in session.history[: session.position + 1] if s.errors is not None]
        now = tuple((s.key, s.errors) for s in steps)
        if now == self._shown or not steps:
            return
        self._shown = now
        kept = [steps[0], *steps[1:][-(MOST_MODELS - 1) :]]
        self._chart.show(_options(kept))


def relative(values: tuple[float | None, ...], first: tuple[float | None, ...]) -> list[Any]:
    """Return values relative to those of the first model, None where one is unknown."""
    return [
        None if value is None or not start else round(value / start, 4)
        for value, start in zip(values, first, strict=True)
    ]


def _options(steps: list[ModelStep]) -> dict[str, Any]:
    joints = len(steps[0].errors.shown) if steps and steps[0].errors is not None else 0
    series: list[dict[str, Any]] = []
    for k, step in enumerate(steps):
        if step.errors is None or steps[0].errors is None:
            continue
        first, colour = steps[0].errors, "#9aa5b1" if k == 0 else SERIES[(k - 1) % len(SERIES)]
        series.append(
            {"id": f"model {k}", "type": "bar", "name": step.title, "color": colour, "barGap": "8%",
             "data": relative(step.errors.shown, first.shown)}
        )  # fmt: skip
        if k == len(steps) - 1 and any(first.train):
            series.append(
                {"id": "training", "type": "scatter", "name": "training", "symbol": "diamond",
                 "symbolSize": 9,
                 "itemStyle": {"color": "white", "borderColor": "#222222", "borderWidth": 1.2},
                 "data": relative(step.errors.train, first.train), "z": 5}
            )  # fmt: skip
        if k == len(steps) - 1:
            series.append(
                {"id": "noise", "type": "scatter", "name": "noise floor", "symbol": "rect",
                 "symbolSize": [26, 2], "color": "#222222", "z": 5,
                 "data": relative(step.errors.noise_floor, first.shown)}
            )  # fmt: skip
    return {
        "animation": False,
        "textStyle": {"fontFamily": "inherit"},
        "grid": {"left": 38, "right": 8, "top": 44, "bottom": 34},
        "legend": {"type": "scroll", "top": 0, "left": 0, "itemWidth": 12, "itemHeight": 8,
                   "textStyle": {"fontSize": 11}},
        "tooltip": {"trigger": "axis"},
        "xAxis": {"type": "category", "data": [str(j + 1) for j in range(joints)],
                  "name": "joint", "nameLocation": "middle", "nameGap": 20},
        "yAxis": {"type": "value", "min": 0},
        "series": series,
    }  # fmt: skip
