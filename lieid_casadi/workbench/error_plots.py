"""Errors of the models, and what the error of the selected joint follows."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from nicegui import ui
from nicegui.events import ValueChangeEventArguments

from lieid_casadi.arrays import Array
from lieid_casadi.comparison.plot_style import BACKWARD, ERROR, FORWARD, PREDICTED, REST, thin
from lieid_casadi.comparison.plots import binned_mean, intervals
from lieid_casadi.comparison.series import Correlation, Series, residual_correlations
from lieid_casadi.workbench.elements import (
    COMPARED,
    FIRST,
    Chart,
    View,
    named,
    noise_band,
    set_text,
    text,
)
from lieid_casadi.workbench.session import Numbers, StepErrors
from lieid_casadi.workbench.torque_plot import Line, pairs, series_of
from lieid_casadi.workbench.workbench import Workbench

MOST_SAMPLES = 350  # of one direction in a plot of the error
PLAIN = {"animation": False, "textStyle": {"fontFamily": "inherit"}}


@dataclass(frozen=True)
class ErrorOverSignal:
    """Error of one joint over one signal: samples and means, forward and backward apart."""

    title: str
    unit: str
    forward: Line
    backward: Line
    rest: Line
    forward_mean: Line
    backward_mean: Line


def errors_over_signals(
    series: list[Series],
    joint: int,
    window: tuple[float, float] | None,
    *,
    revolute: bool = True,
    degrees: bool = False,
) -> list[ErrorOverSignal]:
    """Return the error over angle, speed, load, time, and temperature where it was recorded.

    In a window of time, s; angles of a joint that turns are in degrees if ``degrees`` says so.
    """
    parts = [_rows(s, window) for s in series]

    def joined(name: str) -> Array:
        return np.concatenate([getattr(s, name)[rows, joint] for s, rows in parts])

    if not parts or not sum(rows.stop - rows.start for _, rows in parts):
        return []
    error, sign = joined("error"), joined("sign")
    scale = np.degrees(1.0) if degrees and revolute else 1.0
    angle = ("°" if degrees else "rad") if revolute else "m"
    signals = [
        ("angle" if revolute else "position", angle, scale * joined("q")),
        ("speed", f"{angle}/s", scale * joined("dq")),
        ("load", "N·m" if revolute else "N", joined("load")),
        ("time", "s", np.concatenate([s.time[rows] for s, rows in parts])),
    ]
    if all(s.temperature is not None for s, _ in parts):
        signals.append(("temperature", "°C", joined("temperature")))
    return [_over(title, unit, values, error, sign) for title, unit, values in signals]


def _rows(series: Series, window: tuple[float, float] | None) -> tuple[Series, slice]:
    first, last = (0, len(series.time)) if window is None else np.searchsorted(series.time, window)
    return series, slice(int(first), int(last))


def _over(title: str, unit: str, signal: Array, error: Array, sign: Array) -> ErrorOverSignal:
    edges = intervals(signal, around_zero=title == "speed")

    def samples(direction: float) -> Line:
        use = thin(sign == direction, MOST_SAMPLES)
        return pairs(signal[use], error[use])

    def means(direction: float) -> Line:
        here = sign == direction
        centre, mean = binned_mean(signal[here], error[here], edges)
        return [[x, y] for x, y in pairs(centre, mean) if y == y]

    return ErrorOverSignal(
        title, unit, samples(1.0), samples(-1.0), samples(0.0), means(1.0), means(-1.0)
    )


class ResidualPlot(View):
    """One panel per signal; forward and backward motion have their own colours and means."""

    def __init__(self, workbench: Workbench) -> None:
        super().__init__(workbench)
        with ui.column().classes("panel w-full"):
            with ui.row().classes("w-full items-center no-wrap"):
                self._title = text("What the error follows", "panel-title grow")
                units = ui.toggle({False: "rad", True: "deg"}, value=workbench.session.degrees)
                named(units.props("dense no-caps size=sm"), "angle-unit")
                units.on_value_change(self._choose_unit)
            self._chart = Chart("residual-plot", _residual_options([], None, ""))

    def _choose_unit(self, event: ValueChangeEventArguments[bool]) -> None:
        workbench = self.workbench
        workbench.show(replace(workbench.session, degrees=bool(event.value)))

    def update(self) -> None:
        """Draw the selected range of the recording that is shown."""
        workbench = self.workbench
        evaluation, session, opened = workbench.evaluation, workbench.session, workbench.opened
        if evaluation is None or opened is None:
            return
        window, joint = workbench.view.selection or workbench.view.window, session.joint
        floor = evaluation.errors.noise_floor[joint]
        if not self.is_new(
            evaluation.train, evaluation.test, floor, joint, session.recording, window,
            session.degrees,
        ):  # fmt: skip
            return
        panels = errors_over_signals(
            series_of(evaluation, opened.recordings[session.recording].name),
            joint,
            window,
            revolute=opened.revolute[joint],
            degrees=session.degrees,
        )
        where = "" if window is None else f", {window[0]:.2f} to {window[1]:.2f} s"
        set_text(self._title, f"What the error of joint {joint + 1} follows{where}")
        self._chart.show(_residual_options(panels, floor, opened.units[joint]))


def _axes(titles: list[str], y_name: str, *, limit: float | None = None) -> dict[str, Any]:
    """Return grids and axes of panels beside each other with one scale of their vertical axis."""
    width = 94.0 / max(len(titles), 1)
    vertical = {"type": "value", "scale": True, "axisLine": {"onZero": False}, "nameGap": 36,
                "nameLocation": "middle"}  # fmt: skip
    if limit is not None:
        vertical |= {"min": -limit, "max": limit}
    return {
        "grid": [
            {"left": f"{6.0 + k * width}%", "width": f"{width - 2.0}%", "top": 30, "bottom": 42}
            for k in range(len(titles))
        ],
        "xAxis": [
            {"type": "value", "gridIndex": k, "scale": True, "nameLocation": "middle",
             "nameGap": 22, "name": title, "splitNumber": 4, "axisLine": {"onZero": False},
             "axisLabel": {"hideOverlap": True, "fontSize": 10, "showMaxLabel": False}}
            for k, title in enumerate(titles)
        ],
        "yAxis": [
            {**vertical, "gridIndex": k, "name": "" if k else y_name,
             "axisLabel": {"show": not k, "fontSize": 10, "hideOverlap": True}}
            for k in range(len(titles))
        ],
    }  # fmt: skip


def _residual_options(
    panels: list[ErrorOverSignal], floor: float | None, unit: str
) -> dict[str, Any]:
    values = [y for p in panels for line in (p.forward, p.backward, p.rest) for _, y in line]
    largest = max((abs(y) for y in values if y is not None), default=1.0) or 1.0
    titles = [f"{panel.title} [{panel.unit}]" for panel in panels]
    return {
        **PLAIN,
        **_axes(titles, f"error [{unit}]", limit=float(f"{1.05 * largest:.2g}")),
        "legend": {"top": 0, "right": 10, "itemHeight": 8, "textStyle": {"fontSize": 11},
                   "data": ["forward", "backward", "at rest"]},
        "series": [s for k, panel in enumerate(panels) for s in _panel_series(panel, k, floor)],
    }  # fmt: skip


def _panel_series(panel: ErrorOverSignal, k: int, floor: float | None) -> list[dict[str, Any]]:
    axes = {"xAxisIndex": k, "yAxisIndex": k, "silent": True}
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
    made[0]["markArea"] = noise_band(floor)
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


class CorrelationPlot(View):
    """Auto-correlation of the error, and its correlation with speed and acceleration."""

    def __init__(self, workbench: Workbench) -> None:
        super().__init__(workbench)
        with ui.column().classes("panel w-full"):
            self._title = text("Correlation of the error", "panel-title")
            self._chart = Chart("correlation-plot", _correlation_options([]))

    def update(self) -> None:
        """Draw the recording that is shown."""
        workbench = self.workbench
        evaluation, session, opened = workbench.evaluation, workbench.session, workbench.opened
        if evaluation is None or opened is None:
            return
        joint = session.joint
        if not self.is_new(evaluation.train, evaluation.test, joint, session.recording):
            return
        series = series_of(evaluation, opened.recordings[session.recording].name)
        found = residual_correlations(series, joint, evaluation.cutoff)
        set_text(
            self._title,
            f"Correlation of the error of joint {joint + 1}; grey: 99 % of what noise gives",
        )
        self._chart.show(_correlation_options(found))


def _correlation_options(found: list[Correlation]) -> dict[str, Any]:
    largest = max((float(np.abs(c.value).max()) for c in found), default=1.0)
    limit = max(math.ceil(10.0 * largest), 1) / 10.0
    series: list[dict[str, Any]] = []
    for k, each in enumerate(found):
        outside = np.abs(each.value) > each.band
        for name, use, colour in (
            ("beyond noise", outside, ERROR),
            ("as noise", ~outside, PREDICTED),
        ):
            series.append(
                {"id": f"{k} {name}", "name": name, "type": "bar", "xAxisIndex": k, "yAxisIndex": k,
                 "barWidth": 3, "barGap": "-100%", "color": colour, "silent": True,
                 "data": pairs(each.lag[use], each.value[use])}
            )  # fmt: skip
        series[-1]["markArea"] = noise_band(each.band)
    return {
        **PLAIN,
        **_axes([f"{c.title}, lag [s]" for c in found], "correlation", limit=limit),
        "legend": {"top": 0, "right": 10, "itemHeight": 8, "textStyle": {"fontSize": 11},
                   "data": ["as noise", "beyond noise"]},
        "series": series,
    }  # fmt: skip


class WaterfallView(View):
    """Bars: unseen error of the first and the shown model; diamonds: training; dashes: noise."""

    def __init__(self, workbench: Workbench) -> None:
        super().__init__(workbench)
        with ui.column().classes("panel w-full h-full"):
            self._title = text("Error of the models, first model = 1", "panel-title")
            self._chart = Chart("waterfall", _waterfall_options([], None))

    def update(self) -> None:
        """Draw the first model, the one that is shown, and the compared one."""
        session, playing = self.workbench.session, self.workbench.playing
        history, compared = session.history, self.workbench.view.compared
        chosen = {k: COMPARED for k in (compared,) if k is not None and k < len(history)}
        chosen = {0: FIRST, session.position: PREDICTED} | chosen | {0: FIRST}
        models = [
            (f"{k + 1}. {history[k].title}", colour, history[k].errors)
            for k, colour in chosen.items()
            if history
        ]
        known = [(title, colour, errors) for title, colour, errors in models if errors is not None]
        if known and len(known) == len(models) and self.is_new(known, playing):
            self._chart.show(_waterfall_options(known, playing))


def relative(values: Numbers, first: Numbers) -> list[float | None]:
    """Return values relative to those of the first model, None where one is unknown."""
    return [
        None if value is None or not start else round(value / start, 4)
        for value, start in zip(values, first, strict=True)
    ]


def _waterfall_options(
    models: list[tuple[str, str, StepErrors]], playing: Numbers | None
) -> dict[str, Any]:
    """Return bars of each model (title, colour, errors); the second one's may be on their way."""
    series: list[dict[str, Any]] = []
    for k, (title, colour, errors) in enumerate(models):
        shown = playing if k == 1 and playing is not None else errors.shown
        series.append(
            {"id": f"model {k}", "type": "bar", "name": _shortened(title), "color": colour,
             "barGap": "8%", "data": relative(shown, models[0][2].shown)}
        )  # fmt: skip
    if models:
        first, last = models[0][2], models[min(1, len(models) - 1)][2]
        trained = relative(last.train, first.train) if any(first.train) else []
        series += [
            {"id": "training", "type": "scatter", "name": "training", "symbol": "diamond",
             "symbolSize": 9, "data": trained, "z": 5,
             "itemStyle": {"color": "white", "borderColor": "#222222", "borderWidth": 1.2}},
            {"id": "noise", "type": "scatter", "name": "noise floor", "symbol": "rect",
             "symbolSize": [26, 2], "color": "#222222", "z": 5,
             "data": relative(last.noise_floor, first.shown)},
        ]  # fmt: skip
    joints = range(1, len(models[0][2].shown) + 1) if models else ()
    return {
        **PLAIN,
        "animation": playing is not None,
        "animationDurationUpdate": 300,
        "grid": {"left": 46, "right": 8, "top": 40, "bottom": 34},
        "legend": {"type": "plain", "top": 0, "left": 0, "itemWidth": 12, "itemHeight": 8,
                   "itemGap": 8, "textStyle": {"fontSize": 11}},
        "tooltip": {"trigger": "axis"},
        "xAxis": {"type": "category", "data": [str(j) for j in joints], "name": "joint",
                  "nameLocation": "middle", "nameGap": 20, "axisLabel": {"interval": 0}},
        "yAxis": {"type": "value", "min": 0, "name": "error / that of the first model",
                  "nameLocation": "middle", "nameGap": 32},
        "series": series,
    }  # fmt: skip


def _shortened(title: str, most: int = 26) -> str:
    return title if len(title) <= most else title[: most - 1] + "…"
