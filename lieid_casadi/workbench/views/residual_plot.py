"""Error of the selected joint over angle, speed, load, time and temperature."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from nicegui import ui
from nicegui.events import ValueChangeEventArguments

from lieid_casadi.comparison.plot_style import BACKWARD, FORWARD, REST
from lieid_casadi.workbench.plot_data import ErrorOverSignal, errors_over_signals, series_of
from lieid_casadi.workbench.views.chart import Chart
from lieid_casadi.workbench.views.elements import named

if TYPE_CHECKING:
    from lieid_casadi.workbench.workbench import Workbench

BAND = "#9fb6c6"


class ResidualPlot:
    """One panel per signal; forward and backward motion have their own colours and means.

    Parameters
    ----------
    workbench : Workbench
    """

    def __init__(self, workbench: Workbench) -> None:
        self._workbench = workbench
        self._shown: object = None
        with ui.column().classes("panel w-full"):
            with ui.row().classes("w-full items-center no-wrap"):
                self._title = ui.label("What the error follows").classes("panel-title grow")
                units = ui.toggle({False: "rad", True: "deg"}, value=workbench.session.degrees)
                named(units.props("dense no-caps size=sm"), "angle-unit")
                units.on_value_change(self._choose_unit)
            self._chart = Chart("residual-plot", _options([], None, ""))

    def _choose_unit(self, event: ValueChangeEventArguments[bool]) -> None:
        workbench = self._workbench
        workbench.show(replace(workbench.session, degrees=bool(event.value)))

    def update(self) -> None:
        """Draw the selected range of the recording that is shown."""
        workbench = self._workbench
        evaluation, session, opened = workbench.evaluation, workbench.session, workbench.opened
        if evaluation is None or opened is None:
            return
        window = workbench.view.selection or workbench.view.window
        joint = session.joint
        floor = evaluation.errors.noise_floor[joint]
        now = (
            evaluation.train, evaluation.test, floor,
            joint, session.recording, window, session.degrees,
        )  # fmt: skip
        if now == self._shown:
            return
        self._shown = now
        recording = opened.recordings[session.recording]
        panels = errors_over_signals(
            series_of(evaluation, recording.name),
            joint,
            window,
            revolute=opened.revolute[joint],
            degrees=session.degrees,
        )
        where = "" if window is None else f", {window[0]:.2f} to {window[1]:.2f} s"
        self._title.text = f"What the error of joint {joint + 1} follows{where}"
        self._chart.show(_options(panels, floor, opened.units[joint]))


def _options(panels: list[ErrorOverSignal], floor: float | None, unit: str) -> dict[str, Any]:
    count = max(len(panels), 1)
    width = (100.0 - 6.0) / count
    grids, x_axes, y_axes = [], [], []
    series: list[dict[str, Any]] = []
    for k, panel in enumerate(panels):
        grids.append({"left": f"{6.0 + k * width}%", "width": f"{width - 2.0}%", "top": 30,
                      "bottom": 42})  # fmt: skip
        x_axes.append({"type": "value", "gridIndex": k, "scale": True, "nameLocation": "middle",
                       "nameGap": 22, "name": f"{panel.title} [{panel.unit}]", "splitNumber": 4,
                       "axisLabel": {"hideOverlap": True, "fontSize": 10},
                       "axisLine": {"onZero": False}})  # fmt: skip
        y_axes.append({"type": "value", "gridIndex": k, "scale": True,
                       "name": f"error [{unit}]" if k == 0 else "",
                       "axisLine": {"onZero": False},
                       "axisLabel": {"show": k == 0, "fontSize": 10}})  # fmt: skip
        series += _panel_series(panel, k, floor)
    if panels:
        values = [y for p in panels for line in (p.forward, p.backward, p.rest) for _, y in line]
        largest = max((abs(y) for y in values if y is not None), default=1.0)
        limit = float(f"{1.05 * largest:.2g}")
        for axis in y_axes:
            axis["min"], axis["max"] = -limit, limit
    return {
        "animation": False,
        "textStyle": {"fontFamily": "inherit"},
        "legend": {"top": 0, "right": 10, "itemHeight": 8, "textStyle": {"fontSize": 11},
                   "data": ["forward", "backward", "at rest"]},
        "grid": grids, "xAxis": x_axes, "yAxis": y_axes, "series": series,
    }  # fmt: skip


def _panel_series(panel: ErrorOverSignal, k: int, floor: float | None) -> list[dict[str, Any]]:
    axes = {"xAxisIndex": k, "yAxisIndex": k, "silent": True}
    ends = [] if floor is None else [[{"yAxis": -floor}, {"yAxis": floor}]]
    band = {"silent": True, "itemStyle": {"color": BAND, "opacity": 0.35}, "data": ends}
    made: list[dict[str, Any]] = [
        {**axes, "id": f"{k} {name}", "type": "scatter", "name": name, "data": data,
         "symbolSize": 3, "symbol": "rect", "color": colour, "itemStyle": {"opacity": 0.45},
         "large": True, "largeThreshold": 100}  # one path for all samples: drawn much faster
        for name, data, colour in (
            ("at rest", panel.rest, REST),
            ("forward", panel.forward, FORWARD),
            ("backward", panel.backward, BACKWARD),
        )
    ]  # fmt: skip
    made[0]["markArea"] = band
    for name, data, colour, kind in (
        ("forward", panel.forward_mean, FORWARD, "solid"),
        ("backward", panel.backward_mean, BACKWARD, "dashed"),
    ):
        made.append(
            {**axes, "id": f"{k} mean {name}", "type": "line", "name": name, "data": data,
             "color": colour, "z": 4, "showSymbol": False,
             "lineStyle": {"width": 2.6, "type": kind}}
        )  # fmt: skip
    return made
