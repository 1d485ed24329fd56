"""Error of each model, and error of the selected joint over the signals that it follows."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from nicegui import ui
from nicegui.events import ValueChangeEventArguments

from lieid_casadi.comparison.plot_style import BACKWARD, FORWARD, REST
from lieid_casadi.workbench.elements import SERIES, Chart, named
from lieid_casadi.workbench.session import ModelStep
from lieid_casadi.workbench.torque_plot import ErrorOverSignal, errors_over_signals, series_of

if TYPE_CHECKING:
    from lieid_casadi.workbench.workbench import Workbench

BAND = "#9fb6c6"


class ResidualPlot:
    """One panel per signal; forward and backward motion have their own colours and means."""

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


MOST_MODELS = 6


class WaterfallView:
    """Bars: error on the test; diamonds: on the training; dashes: noise floor."""

    def __init__(self, workbench: Workbench) -> None:
        self._workbench = workbench
        self._shown: object = None
        with ui.column().classes("panel w-full h-full"):
            ui.label("Error of each model, first model = 1").classes("panel-title")
            self._chart = Chart("waterfall", _waterfall_options([]))

    def update(self) -> None:
        """Draw the models up to the one that is shown."""
        session = self._workbench.session
        steps = [s for s in session.history[: session.position + 1] if s.errors is not None]
        now = tuple((s.key, s.errors) for s in steps)
        if now == self._shown or not steps:
            return
        self._shown = now
        kept = [steps[0], *steps[1:][-(MOST_MODELS - 1) :]]
        self._chart.show(_waterfall_options(kept))


def relative(values: tuple[float | None, ...], first: tuple[float | None, ...]) -> list[Any]:
    """Return values relative to those of the first model, None where one is unknown."""
    return [
        None if value is None or not start else round(value / start, 4)
        for value, start in zip(values, first, strict=True)
    ]


def _waterfall_options(steps: list[ModelStep]) -> dict[str, Any]:
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
