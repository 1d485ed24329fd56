"""Measured and predicted torque, error, and noise band over time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from nicegui import ui
from nicegui.events import GenericEventArguments, ValueChangeEventArguments

from lieid_casadi.arrays import Array
from lieid_casadi.comparison.plot_style import ERROR, MEASURED, PREDICTED, envelope, thin
from lieid_casadi.comparison.plots import binned_mean, intervals
from lieid_casadi.comparison.series import Series
from lieid_casadi.workbench.elements import Chart, figures, named
from lieid_casadi.workbench.evaluation import Evaluation

if TYPE_CHECKING:
    from lieid_casadi.workbench.workbench import Workbench

MOST_SAMPLES = 350  # of one direction in a plot of the error
Line = list[list[float | None]]  # [time, value] pairs; a pair of None interrupts the line


@dataclass(frozen=True)
class TorqueLines:
    """Lines of the torque plot in a time window, N·m over s."""

    measured: Line
    predicted: Line
    error: Line


def series_of(evaluation: Evaluation, title: str) -> list[Series]:
    """Return the series of one recording, in the order of time."""
    parts = [c.series for c in (evaluation.train, evaluation.test) if c is not None]
    return [
        series
        for comparison in parts
        for series in comparison
        if series.recording == title or series.recording.startswith(f"{title}@")
    ]


def torque_lines(
    series: list[Series], joint: int, window: tuple[float, float], columns: int
) -> TorqueLines:
    """Return measured and predicted torque and error of a joint, decimated by minimum and maximum.

    Parameters
    ----------
    joint : int
        From 0.
    window : (float, float)
        First and last time, s.
    columns : int
        Pixels of the plot.
    """
    lines: dict[str, Line] = {"measured": [], "predicted": [], "error": []}
    for s in series:
        first, last = np.searchsorted(s.time, window)
        part = slice(max(int(first) - 1, 0), int(last) + 1)
        if s.time[part].size == 0:
            continue
        for name, values in (
            ("measured", s.measured),
            ("predicted", s.predicted),
            ("error", s.error),
        ):
            if lines[name]:
                lines[name].append([None, None])
            lines[name] += pairs(*envelope(s.time[part], values[part, joint], columns))
    return TorqueLines(**lines)


def pairs(x: Array, y: Array) -> Line:
    """Return points as a list, rounded to what a plot resolves."""
    return np.column_stack([np.round(x, 4), np.round(y, 5)]).tolist()  # type: ignore[no-any-return]


@dataclass(frozen=True)
class ErrorOverSignal:
    """Error of one joint over one signal: samples and means, forward and backward apart.

    Attributes
    ----------
    title, unit : str
        Of the signal.
    forward, backward, rest : Line
        Samples, evenly thinned.
    forward_mean, backward_mean : Line
        Means over intervals of the signal.
    """

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

    Parameters
    ----------
    joint : int
        From 0.
    window : (float, float) or None
        Range of time, s; None for all of it.
    revolute, degrees : bool
        Whether angles are those of a joint that turns, in degrees.
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


COLUMNS = 900  # pixels of the plot: minimum and maximum are kept for each
BAND = "#9fb6c6"
COMPARED = "#009e73"
# Dragging selects; with shift it moves the plot, for which the brush has to let go.
_START_BRUSH = """(function start() {
  const chart = getElement(ID)?.chart;
  if (!chart) { setTimeout(start, 20); return; }
  let brushes = null;
  const brush = (on) => {
    if (on === brushes) return;
    brushes = on;
    const brushOption = { brushType: on ? 'lineX' : false, brushMode: 'single' };
    chart.dispatchAction({ type: 'takeGlobalCursor', key: 'brush', brushOption });
  };
  brush(true);
  chart.getDom().addEventListener('pointerdown', (event) => brush(!event.shiftKey), true);
})();"""


class TorquePlot:
    """Torque of the selected joint along a recording; the wheel zooms, dragging selects."""

    def __init__(self, workbench: Workbench) -> None:
        self._workbench = workbench
        self._shown: object = None
        self._span = (0.0, 1.0)
        with ui.column().classes("panel w-full"):
            with ui.row().classes("w-full items-center gap-2 no-wrap"):
                self._title = ui.label("Torque").classes("panel-title grow")
                self._recording = ui.select([], on_change=self._choose_recording)
                named(self._recording.props("dense borderless options-dense"), "recording")
                self._exclude = ui.button("Exclude selection", on_click=self._exclude_selection)
                named(self._exclude.props("dense flat no-caps size=sm"), "exclude-selection")
                reset = ui.button("Whole recording", on_click=self._reset)
                named(reset.props("dense flat no-caps size=sm"), "whole-recording")
            self._selected = ui.label("").classes("muted small")
            self._chart = Chart("torque-plot", _empty_options())
        self._chart.element.on("chart:datazoom", self._zoomed, throttle=0.12, leading_events=False)
        self._chart.element.on("chart:brushEnd", self._brushed, ["areas"])

    def update(self) -> None:
        """Draw the current evaluation; the window of time stays if the recording does."""
        workbench = self._workbench
        view = workbench.view
        self._selected.text = (
            "drag: select; wheel: zoom; shift and drag: move"
            if view.selection is None
            else f"selected {view.selection[0]:.2f} to {view.selection[1]:.2f} s"
        )
        self._exclude.set_enabled(
            view.selection is not None and workbench.session.inputs.mode == "missing"
        )
        evaluation, session, opened = workbench.evaluation, workbench.session, workbench.opened
        if evaluation is None or opened is None:
            return
        compared = workbench.compared
        noise = evaluation.errors.noise_floor[session.joint]
        now = (
            evaluation.train, evaluation.test, compared, noise,
            session.joint, session.recording, view.window,
        )  # fmt: skip
        if now == self._shown:
            return
        recording, joint = opened.recordings[session.recording], session.joint
        span = recording.start, recording.end
        new_recording = self._shown is None or self._span != span
        self._shown, self._span = now, span
        window = view.window or span
        lines = torque_lines(series_of(evaluation, recording.name), joint, window, COLUMNS)
        other = torque_lines(
            [] if compared is None else series_of(compared, recording.name), joint, window, COLUMNS
        )
        self._title.text = (
            f"Torque of joint {joint + 1} {opened.joint_names[joint]} [{opened.units[joint]}], "
            f"low-pass {figures(evaluation.cutoff)} Hz"
        )
        self._recording.set_options([r.name for r in opened.recordings], value=recording.name)
        self._chart.show(_options(span, lines, other, noise), whole=new_recording)
        if new_recording:
            self._start_brush()

    def move_cursor(self, time: float) -> None:
        """Show the time of the arm's pose."""
        line = {"id": "cursor", "markLine": {"data": [{"xAxis": round(time, 3)}]}}
        self._chart.run("setOption", {"series": [line]})

    def _start_brush(self) -> None:
        """Make dragging select a range of time, once the browser has drawn the plot."""
        chart = self._chart.element
        chart.client.run_javascript(_START_BRUSH.replace("ID", str(chart.id)))

    def _choose_recording(self, event: ValueChangeEventArguments[str | None]) -> None:
        workbench = self._workbench
        if workbench.opened is None:
            return
        names = [r.name for r in workbench.opened.recordings]
        if event.value in names and names.index(event.value) != workbench.session.recording:
            workbench.show(workbench.session.show_recording(names.index(event.value)))

    def _zoomed(self, event: GenericEventArguments) -> None:
        changes = event.args.get("batch") or [event.args]
        start, end = changes[0].get("start"), changes[0].get("end")
        if start is None or end is None:
            return
        first, last = self._span
        length = last - first
        whole = start <= 0.0 and end >= 100.0
        window = (first + 0.01 * start * length, first + 0.01 * end * length)
        self._workbench.look(replace(self._workbench.view, window=None if whole else window))

    def _brushed(self, event: GenericEventArguments) -> None:
        areas = event.args.get("areas") or []
        selection = None
        if areas:
            start, end = (float(t) for t in areas[0]["coordRange"])
            first, last = self._span
            start, end = max(start, first), min(end, last)
            if COLUMNS * (end - start) > last - first:  # shorter: a click, not a selection
                selection = (start, end)
        self._workbench.look(replace(self._workbench.view, selection=selection))

    async def _exclude_selection(self) -> None:
        workbench = self._workbench
        if workbench.view.selection is None:
            return
        start, end = workbench.view.selection
        workbench.look(replace(workbench.view, selection=None))
        self._chart.run("dispatchAction", {"type": "brush", "areas": []})
        await workbench.apply(workbench.session.excluding(round(start, 3), round(end, 3)))

    def _reset(self) -> None:
        self._chart.run("dispatchAction", {"type": "dataZoom", "start": 0, "end": 100})


def _empty_options() -> dict[str, Any]:
    empty = TorqueLines([], [], [])
    return _options((0.0, 1.0), empty, empty, None)


def _options(
    span: tuple[float, float], lines: TorqueLines, other: TorqueLines, noise: float | None
) -> dict[str, Any]:
    """Return the options of the plot."""
    axis = {
        "type": "value",
        "min": span[0],
        "max": span[1],
        "axisLabel": {"hideOverlap": True, "showMaxLabel": False},
    }
    return {
        "animation": False,
        "textStyle": {"fontFamily": "inherit"},
        "grid": [
            {"left": 58, "right": 14, "top": 26, "height": "48%"},
            {"left": 58, "right": 14, "top": "66%", "bottom": 52},
        ],
        "legend": {"top": 0, "right": 10, "itemHeight": 8,
                   "data": ["measured", "predicted", "error"], "textStyle": {"fontSize": 11}},
        "xAxis": [
            {**axis, "gridIndex": 0, "axisLabel": {"show": False}},
            {**axis, "gridIndex": 1, "name": "time [s]", "nameLocation": "middle", "nameGap": 20},
        ],
        "yAxis": [
            {"type": "value", "gridIndex": 0, "scale": True, "name": "torque"},
            {"type": "value", "gridIndex": 1, "scale": True, "name": "error", "splitNumber": 3},
        ],
        "axisPointer": {"link": [{"xAxisIndex": "all"}]},
        "dataZoom": [
            {"type": "inside", "xAxisIndex": [0, 1], "filterMode": "none",
             "moveOnMouseMove": "shift", "zoomOnMouseWheel": True},
            {"type": "slider", "xAxisIndex": [0, 1], "filterMode": "none", "height": 16,
             "bottom": 4, "showDataShadow": False, "brushSelect": False},
        ],
        "brush": {"xAxisIndex": "all", "brushLink": "all", "toolbox": [],
                  "throttleType": "debounce", "throttleDelay": 100,
                  "outOfBrush": {"colorAlpha": 1.0}},
        "toolbox": {"show": False},
        "series": _series(lines, other, noise),
    }  # fmt: skip


def _series(lines: TorqueLines, other: TorqueLines, noise: float | None) -> list[dict[str, Any]]:
    line = {
        "type": "line", "showSymbol": False, "animation": False, "silent": True,
        "connectNulls": False,
    }  # fmt: skip
    below = {"xAxisIndex": 1, "yAxisIndex": 1}
    return [
        {**line, "id": "measured", "name": "measured", "color": MEASURED,
         "lineStyle": {"width": 2.4}, "data": lines.measured},
        {**line, "id": "predicted", "name": "predicted", "color": PREDICTED,
         "lineStyle": {"width": 1.3}, "data": lines.predicted},
        {**line, **below, "id": "error", "name": "error", "color": ERROR,
         "lineStyle": {"width": 1.1}, "data": lines.error, "markArea": _band(noise)},
        {**line, **below, "id": "cursor", "data": [],
         "markLine": {"symbol": "none", "animation": False, "label": {"show": False},
                      "lineStyle": {"color": "#333333", "type": "solid"}, "data": []}},
        {**line, "id": "other", "name": "predicted (compared)", "color": COMPARED,
         "lineStyle": {"width": 1.3, "type": "dashed"}, "data": other.predicted},
        {**line, **below, "id": "other error", "name": "error (compared)", "color": COMPARED,
         "lineStyle": {"width": 1.1, "type": "dashed"}, "data": other.error},
    ]  # fmt: skip


def _band(noise: float | None) -> dict[str, Any]:
    """Return the noise floor as a band around zero."""
    ends = [] if noise is None else [[{"yAxis": -noise}, {"yAxis": noise}]]
    return {"silent": True, "itemStyle": {"color": BAND, "opacity": 0.35}, "data": ends}
