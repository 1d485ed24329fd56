"""Plots of the page: torque over time, what the error follows, its correlation, its spectrum."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from nicegui import ui
from nicegui.events import GenericEventArguments, ValueChangeEventArguments

from lieid_casadi.arrays import Array
from lieid_casadi.comparison.plot_style import (
    BACKWARD,
    ERROR,
    FORWARD,
    MEASURED,
    PREDICTED,
    REST,
    envelope,
    thin,
)
from lieid_casadi.comparison.plots import binned_mean, intervals
from lieid_casadi.comparison.series import (
    Correlation,
    Series,
    residual_correlations,
    residual_spectrum,
    strongest_at,
)
from lieid_casadi.tables import figures
from lieid_casadi.workbench.elements import (
    COMPARED,
    PLAIN,
    Chart,
    View,
    button,
    named,
    noise_band,
    set_text,
    text,
)
from lieid_casadi.workbench.evaluation import series_of
from lieid_casadi.workbench.workbench import Workbench

COLUMNS = 900  # pixels of the plot: minimum and maximum are kept for each
MOST_SAMPLES = 350  # of one direction in a plot of the error
NEAR = 0.03  # of the range of a spectrum: a click so near means a peak
EXCLUDED = "#b0b6bc"
LEGEND = {"top": 0, "right": 10, "itemHeight": 8, "textStyle": {"fontSize": 11}}
Line = list[list[float | None]]  # [x, y] pairs; a pair of None interrupts the line


def torque_lines(
    series: list[Series], joint: int, window: tuple[float, float], columns: int = COLUMNS
) -> dict[str, Line]:
    """Return torques and error of a joint in a window of time, s, decimated by min and max."""
    lines: dict[str, Line] = {"measured": [], "predicted": [], "error": []}
    for s in series:
        first, last = np.searchsorted(s.time, window)
        part = slice(max(int(first) - 1, 0), int(last) + 1)
        if s.time[part].size == 0:
            continue
        for name, line in lines.items():
            if line:
                line.append([None, None])
            values = getattr(s, name)[part, joint]
            line += pairs(*envelope(s.time[part], values, columns))
    return lines


def pairs(x: Array, y: Array) -> Line:
    """Return points as a list, rounded to what a plot resolves."""
    return np.column_stack([np.round(x, 4), np.round(y, 5)]).tolist()  # type: ignore[no-any-return]


class TorquePlot(View):
    """Torque of the selected joint along a recording; the wheel zooms, dragging selects."""

    def __init__(self, workbench: Workbench) -> None:
        super().__init__(workbench)
        self._span = (0.0, 1.0)
        self._selection: tuple[float, float] | None = None
        with ui.column().classes("panel w-full"):
            with ui.row().classes("w-full items-center gap-2 no-wrap"):
                self._title = text("Torque", "panel-title grow")
                self._recording = ui.select([], on_change=self._choose_recording)
                self._recording.props("dense borderless options-dense").classes("choice")
                named(self._recording, "recording")
            with ui.row().classes("w-full items-center gap-2 no-wrap"):
                hint = "drag: select; wheel: zoom; click: show on the arm"
                text(hint, "muted small grow ellipsis")
                self._range = ui.input("select from to, s").props("dense").classes("range")
                named(self._range, "range").on("keydown.enter", self._select_range)
                self._exclude = button(
                    "Exclude selection",
                    "exclude-selection",
                    self._exclude_selection,
                    "flat size=sm",
                )
                button("Whole recording", "whole-recording", self._reset, "flat size=sm")
            self._chart = Chart("torque-plot", _torque_options((0.0, 1.0), {}, {}, None, "N·m", []))
        element = self._chart.element
        element.on("chart:datazoom", self._zoomed, throttle=0.12, leading_events=False)
        element.on("chart:brushEnd", self._brushed, ["areas"])
        element.on("instant", self._show_instant)
        self._chart.call("emitClicks", "'instant'")

    def update(self) -> None:
        """Draw the current evaluation; the window of time stays if the recording does."""
        workbench = self.workbench
        view, session, opened = workbench.view, workbench.session, workbench.opened
        if view.selection != self._selection:
            self._selection = view.selection
            self._range.value = (
                "" if view.selection is None else "{:.2f} {:.2f}".format(*view.selection)
            )
        self._exclude.set_enabled(view.selection is not None)
        evaluation, compared = workbench.evaluation, workbench.compared
        if evaluation is None or opened is None or session.step is None:
            return
        noise, joint = evaluation.errors.noise_floor[session.joint], session.joint
        excluded = [
            (e.start, e.end) for e in session.step.excluded if e.recording == session.recording
        ]
        if not self.is_new(
            evaluation.train, evaluation.test, compared, noise, joint, session.recording,
            view.window, excluded,
        ):  # fmt: skip
            return
        recording = opened.recordings[session.recording]
        span = recording.start, recording.end
        new_recording, self._span = self._span != span, span
        window, unit = view.window or span, opened.units[joint]
        lines, other = (
            torque_lines(series_of(each, recording.name), joint, window, COLUMNS)
            for each in (evaluation, compared)
        )
        set_text(
            self._title,
            f"Torque of joint {joint + 1} {opened.joint_names[joint]}, "
            f"low-pass {figures(evaluation.cutoff)} Hz",
        )
        self._recording.set_options([r.name for r in opened.recordings], value=recording.name)
        self._chart.show(
            _torque_options(span, lines, other, noise, unit, excluded), whole=new_recording
        )

    def move_cursor(self, time: float) -> None:
        """Show the time of the arm's pose."""
        line = {"id": "cursor", "markLine": {"data": [{"xAxis": round(time, 3)}]}}
        self._chart.draw({"series": [line]})

    def _choose_recording(self, event: ValueChangeEventArguments[str | None]) -> None:
        workbench = self.workbench
        if workbench.opened is None:
            return
        names = [r.name for r in workbench.opened.recordings]
        if event.value in names and names.index(event.value) != workbench.session.recording:
            workbench.show(replace(workbench.session, recording=names.index(event.value)))

    def _zoomed(self, event: GenericEventArguments) -> None:
        changes = event.args.get("batch") or [event.args]
        start, end = changes[0].get("start"), changes[0].get("end")
        if start is None or end is None:
            return
        first, last = self._span
        length = last - first
        whole = start <= 0.0 and end >= 100.0
        window = (first + 0.01 * start * length, first + 0.01 * end * length)
        self.workbench.look(replace(self.workbench.view, window=None if whole else window))

    def _brushed(self, event: GenericEventArguments) -> None:
        areas = event.args.get("areas") or []
        selection = None
        if areas:
            start, end = (float(t) for t in areas[0]["coordRange"])
            first, last = self._span
            start, end = max(start, first), min(end, last)
            if COLUMNS * (end - start) > last - first:  # shorter: a click, not a selection
                selection = (start, end)
        self.workbench.look(replace(self.workbench.view, selection=selection))

    def _select_range(self) -> None:
        """Select and show the range of time that is typed; the whole recording without one."""
        ends = [float(x) for x in re.findall(r"-?\d+\.?\d*", self._range.value or "")]
        if len(ends) != 2:
            self.workbench.look(replace(self.workbench.view, selection=None))
            self._reset()
            return
        start, end = np.clip(sorted(ends), *self._span).tolist()
        self.workbench.look(replace(self.workbench.view, selection=(start, end)))
        zoom = {"type": "dataZoom", "startValue": start, "endValue": end}
        self._chart.run("dispatchAction", zoom)

    def _show_instant(self, event: GenericEventArguments) -> None:
        first, last = self._span
        if isinstance(event.args, (int, float)) and first <= event.args <= last:
            self.workbench.look(replace(self.workbench.view, instant=float(event.args)))

    async def _exclude_selection(self) -> None:
        workbench = self.workbench
        if workbench.view.selection is None:
            return
        start, end = workbench.view.selection
        workbench.look(replace(workbench.view, selection=None))
        self._chart.run("dispatchAction", {"type": "brush", "areas": []})
        await workbench.apply(workbench.session.excluding(round(start, 3), round(end, 3)))

    def _reset(self) -> None:
        self._chart.run("dispatchAction", {"type": "dataZoom", "start": 0, "end": 100})


def _torque_options(
    span: tuple[float, float],
    lines: dict[str, Line],
    other: dict[str, Line],
    noise: float | None,
    unit: str,
    excluded: list[tuple[float, float]],
) -> dict[str, Any]:
    """Return the options of the plot: lines of the model that is shown, and of a compared one."""
    x_axis = {"type": "value", "min": span[0], "max": span[1]}
    y_axis = {"type": "value", "scale": True, "nameLocation": "middle", "nameGap": 40}
    labels = {"hideOverlap": True, "showMaxLabel": False}
    names = ["measured", "predicted", "error"]
    names += ["predicted (compared)", "error (compared)"] if other.get("predicted") else []
    return {
        **PLAIN,
        "grid": [
            {"left": 62, "right": 14, "top": 26, "height": "42%"},
            {"left": 62, "right": 14, "top": "58%", "bottom": 54},
        ],
        "legend": LEGEND | {"data": names},
        "xAxis": [
            {**x_axis, "gridIndex": 0, "axisLabel": {"show": False}},
            {**x_axis, "gridIndex": 1, "name": "time [s]", "nameLocation": "middle", "nameGap": 20,
             "axisLabel": labels, "axisLine": {"onZero": False}},
        ],
        "yAxis": [
            {**y_axis, "gridIndex": 0, "name": f"torque [{unit}]", "splitNumber": 4,
             "axisLabel": {"hideOverlap": True}},
            {**y_axis, "gridIndex": 1, "name": f"error [{unit}]", "splitNumber": 3,
             "axisLabel": {"hideOverlap": True}},
        ],
        "axisPointer": {"link": [{"xAxisIndex": "all"}]},
        "dataZoom": [
            {"type": "inside", "xAxisIndex": [0, 1], "filterMode": "none",
             "moveOnMouseMove": False, "zoomOnMouseWheel": True},
            {"type": "slider", "xAxisIndex": [0, 1], "filterMode": "none", "height": 16,
             "bottom": 4, "showDataShadow": False, "brushSelect": False},
        ],
        "brush": {"xAxisIndex": "all", "brushLink": "all", "toolbox": [],
                  "throttleType": "debounce", "throttleDelay": 100,
                  "outOfBrush": {"colorAlpha": 1.0}},
        "toolbox": {"show": False},
        "series": _torque_series(lines, other, noise, excluded),
    }  # fmt: skip


def _torque_series(
    lines: dict[str, Line],
    other: dict[str, Line],
    noise: float | None,
    excluded: list[tuple[float, float]],
) -> list[dict[str, Any]]:
    line = {
        "type": "line", "showSymbol": False, "animation": False, "silent": True,
        "connectNulls": False,
    }  # fmt: skip
    below = {"xAxisIndex": 1, "yAxisIndex": 1}
    left_out = {
        "silent": True, "itemStyle": {"color": EXCLUDED, "opacity": 0.35},
        "label": {"color": "#52606d", "fontSize": 10}, "emphasis": {"disabled": True},
        "data": [[{"xAxis": a, "name": "excluded"}, {"xAxis": b}] for a, b in excluded],
    }  # fmt: skip
    return [
        {**line, "id": "measured", "name": "measured", "color": MEASURED,
         "lineStyle": {"width": 2.4}, "data": lines.get("measured", []), "markArea": left_out},
        {**line, "id": "predicted", "name": "predicted", "color": PREDICTED,
         "lineStyle": {"width": 1.3}, "data": lines.get("predicted", [])},
        {**line, **below, "id": "error", "name": "error", "color": ERROR,
         "lineStyle": {"width": 1.1}, "data": lines.get("error", []),
         "markArea": noise_band(noise)},
        {**line, **below, "id": "cursor", "data": [],
         "markLine": {"symbol": "none", "animation": False, "label": {"show": False},
                      "lineStyle": {"color": "#333333", "type": "solid"}, "data": []}},
        {**line, "id": "other", "name": "predicted (compared)", "color": COMPARED,
         "lineStyle": {"width": 1.3, "type": "dashed"}, "data": other.get("predicted", [])},
        {**line, **below, "id": "other error", "name": "error (compared)", "color": COMPARED,
         "lineStyle": {"width": 1.1, "type": "dashed"}, "data": other.get("error", [])},
    ]  # fmt: skip


class ErrorOverSignal(NamedTuple):
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
) -> list[ErrorOverSignal]:
    """Return the error over angle, speed, load, time, and temperature where it was recorded.

    In a window of time, s.
    """
    parts = []
    for s in series:
        ends = (0, len(s.time)) if window is None else np.searchsorted(s.time, window)
        parts.append((s, slice(int(ends[0]), int(ends[1]))))

    def joined(name: str) -> Array:
        return np.concatenate([getattr(s, name)[rows, joint] for s, rows in parts])

    if not parts or not sum(rows.stop - rows.start for _, rows in parts):
        return []
    error, sign = joined("error"), joined("sign")
    angle = "rad" if revolute else "m"
    signals = [
        ("angle" if revolute else "position", angle, joined("q")),
        ("speed", f"{angle}/s", joined("dq")),
        ("load", "N·m" if revolute else "N", joined("load")),
        ("time", "s", np.concatenate([s.time[rows] for s, rows in parts])),
    ]
    if all(s.temperature is not None for s, _ in parts):
        signals.append(("temperature", "°C", joined("temperature")))
    return [_over(title, unit, values, error, sign) for title, unit, values in signals]


def _over(title: str, unit: str, signal: Array, error: Array, sign: Array) -> ErrorOverSignal:
    edges = intervals(signal, around_zero=title == "speed")
    samples, means = [], []
    for direction in (1.0, -1.0, 0.0):
        here = sign == direction
        use = thin(here, MOST_SAMPLES)
        samples.append(pairs(signal[use], error[use]))
        centre, mean = binned_mean(signal[here], error[here], edges)
        means.append([[x, y] for x, y in pairs(centre, mean) if y == y])
    return ErrorOverSignal(title, unit, *samples, *means[:2])


class Shown(NamedTuple):
    """The series of the recording that is shown, and facts about the selected joint."""

    series: list[Series]
    joint: int
    floor: float | None
    unit: str
    revolute: bool
    cutoff: float


class SeriesView(View):
    """A plot of the selected joint along the recording; `draw` is called when these change."""

    def update(self) -> None:
        """Draw what is shown if it is new."""
        workbench = self.workbench
        evaluation, session, opened = workbench.evaluation, workbench.session, workbench.opened
        if evaluation is None or opened is None:
            return
        joint, floor = session.joint, evaluation.errors.noise_floor[session.joint]
        view = workbench.view.selection or workbench.view.window
        name = opened.recordings[session.recording].name
        if self.is_new(
            evaluation.train, evaluation.test, name, joint, floor, view if self.of_view else None
        ):
            series = series_of(evaluation, name)
            facts = (opened.units[joint], opened.revolute[joint], evaluation.cutoff)
            self.draw(Shown(series, joint, floor, *facts))

    #: Whether the plot depends on the range of time that is visible.
    of_view = False

    def draw(self, shown: Shown) -> None:
        """Draw the plot."""
        raise NotImplementedError


class ResidualPlot(SeriesView):
    """One panel per signal; forward and backward motion have their own colours and means."""

    def __init__(self, workbench: Workbench) -> None:
        super().__init__(workbench)
        with ui.column().classes("panel w-full"):
            self._title = text("What the error follows", "panel-title")
            self._chart = Chart("residual-plot", _residual_options([], None, ""))

    of_view = True

    def draw(self, shown: Shown) -> None:
        """Draw the selected range of the recording."""
        window = self.workbench.view.selection or self.workbench.view.window
        panels = errors_over_signals(shown.series, shown.joint, window, revolute=shown.revolute)
        where = "" if window is None else f", {window[0]:.2f} to {window[1]:.2f} s"
        set_text(self._title, f"What the error of joint {shown.joint + 1} follows{where}")
        self._chart.show(_residual_options(panels, shown.floor, shown.unit))


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
    series: list[dict[str, Any]] = []
    for k, p in enumerate(panels):
        axes = {"xAxisIndex": k, "yAxisIndex": k, "silent": True}
        samples = (
            ("at rest", p.rest, REST), ("forward", p.forward, FORWARD),
            ("backward", p.backward, BACKWARD),
        )  # fmt: skip
        series += [
            {**axes, "id": f"{k} {name}", "type": "scatter", "name": name, "data": data,
             "symbolSize": 3, "symbol": "rect", "color": colour, "itemStyle": {"opacity": 0.45},
             "large": True, "largeThreshold": 100}  # one path for all samples: drawn much faster
            for name, data, colour in samples
        ]  # fmt: skip
        series[-3]["markArea"] = noise_band(floor)
        series += [
            {**axes, "id": f"{k} mean {name}", "type": "line", "name": name, "data": data,
             "color": colour, "z": 4, "showSymbol": False,
             "lineStyle": {"width": 2.6, "type": kind}}
            for name, data, colour, kind in (
                ("forward", p.forward_mean, FORWARD, "solid"),
                ("backward", p.backward_mean, BACKWARD, "dashed"),
            )
        ]  # fmt: skip
    return {
        **PLAIN,
        **_axes(titles, f"error [{unit}]", limit=float(f"{1.05 * largest:.2g}")),
        "legend": LEGEND | {"data": ["forward", "backward", "at rest"]},
        "series": series,
    }


class CorrelationPlot(SeriesView):
    """Auto-correlation of the error, and its correlation with speed and acceleration."""

    def __init__(self, workbench: Workbench) -> None:
        super().__init__(workbench)
        with ui.column().classes("panel w-full"):
            self._title = text("Correlation of the error", "panel-title")
            self._chart = Chart("correlation-plot", _correlation_options([]))

    def draw(self, shown: Shown) -> None:
        """Draw the correlations along the recording."""
        found = residual_correlations(shown.series, shown.joint, shown.cutoff)
        title = f"Correlation of the error of joint {shown.joint + 1}"
        set_text(self._title, f"{title}; grey: 99 % of what noise gives")
        self._chart.show(_correlation_options(found))


def _correlation_options(found: list[Correlation]) -> dict[str, Any]:
    largest = max((float(np.abs(c.value).max()) for c in found), default=1.0)
    limit = max(math.ceil(5.0 * largest), 1) / 5.0
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
        "legend": LEGEND | {"data": ["as noise", "beyond noise"]},
        "series": series,
    }  # fmt: skip


class SpectrumPlot(SeriesView):
    """Spectrum of the error; a click on a peak shows when it happens."""

    def __init__(self, workbench: Workbench) -> None:
        super().__init__(workbench)
        self._frequency, self._amplitude = np.zeros(0), np.zeros(0)
        self._drawn: Shown | None = None
        with ui.column().classes("panel w-full"):
            with ui.row().classes("w-full items-center no-wrap gap-1"):
                self._title = text("Spectrum of the error", "panel-title grow", "spectrum-title")
                button("Show the largest peak", "spectrum-peak", self._largest, "flat size=sm")
            options = _spectrum_options(self._frequency, self._amplitude, None, "N·m")
            self._chart = Chart("spectrum-plot", options)
        self._chart.element.on("frequency", self._clicked)
        self._chart.call("emitClicks", "'frequency'")

    def draw(self, shown: Shown) -> None:
        """Draw the spectrum along the recording."""
        self._drawn = shown
        found = residual_spectrum(shown.series, shown.joint, shown.cutoff)
        self._frequency, self._amplitude = found
        set_text(self._title, f"Spectrum of the error of joint {shown.joint + 1}; click a peak")
        # white noise of the size of the noise floor has this amplitude at each frequency
        level = None if shown.floor is None else shown.floor / math.sqrt(max(len(found[0]), 1))
        self._chart.show(_spectrum_options(*found, level, shown.unit))

    def _clicked(self, event: GenericEventArguments) -> None:
        if isinstance(event.args, (int, float)) and len(self._frequency):
            near = np.abs(self._frequency - event.args) <= NEAR * self._frequency[-1]
            self._show_peak(int(np.argmax(np.where(near, self._amplitude, -1.0))))

    def _largest(self) -> None:
        if len(self._frequency):
            self._show_peak(int(np.argmax(self._amplitude)))

    def _show_peak(self, k: int) -> None:
        """Show on the arm when the error oscillates most with the k-th frequency."""
        assert self._drawn is not None
        joint, frequency = self._drawn.joint, float(self._frequency[k])
        time = strongest_at(self._drawn.series, joint, frequency)
        self.workbench.look(replace(self.workbench.view, instant=time))
        what = f"{figures(frequency)} Hz: largest at {time:.2f} s"
        set_text(self._title, f"Spectrum of the error of joint {joint + 1}; {what}")


def _spectrum_options(
    frequency: Array, amplitude: Array, level: float | None, unit: str
) -> dict[str, Any]:
    line = {"type": "line", "silent": True, "showSymbol": False}
    ends = (
        [] if level is None or not len(frequency) else [[0.0, level], [float(frequency[-1]), level]]
    )
    axes = _axes(["frequency [Hz]"], f"RMS [{unit}]")
    return {
        **PLAIN,
        **axes,
        "yAxis": [{**axes["yAxis"][0], "min": 0}],
        "legend": LEGEND | {"data": ["error", "white noise of the noise floor"]},
        "series": [
            {**line, "id": "spectrum", "name": "error", "color": ERROR,
             "areaStyle": {"opacity": 0.2}, "data": pairs(frequency, amplitude)},
            {**line, "id": "level", "name": "white noise of the noise floor", "color": "#52606d",
             "lineStyle": {"type": "dashed", "width": 1.2}, "data": ends},
        ],
    }  # fmt: skip
