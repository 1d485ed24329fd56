"""Measured and predicted torque, error, and noise band over time; all joints at a glance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from html import escape
from typing import Any

import numpy as np
from nicegui import ui
from nicegui.events import GenericEventArguments, ValueChangeEventArguments

from lieid_casadi.arrays import Array
from lieid_casadi.comparison.plot_style import ERROR, MEASURED, PREDICTED, envelope
from lieid_casadi.comparison.series import Series
from lieid_casadi.workbench.elements import (
    BAND,
    COMPARED,
    Chart,
    View,
    acting,
    button,
    figures,
    named,
    noise_band,
    on_action,
    set_text,
    text,
    toggle_class,
)
from lieid_casadi.workbench.evaluation import Evaluation
from lieid_casadi.workbench.workbench import Workbench

COLUMNS = 900  # pixels of the plot: minimum and maximum are kept for each
SMALL_COLUMNS = 150  # of the plot of one joint in the overview
EXCLUDED = "#b0b6bc"
Line = list[list[float | None]]  # [time, value] pairs; a pair of None interrupts the line
# Dragging selects; with shift it moves the plot, for which the brush has to let go. A click shows
# the instant on the arm.
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
  chart.getZr().on('click', (event) => {
    const [time] = chart.convertFromPixel({ gridIndex: 0 }, [event.offsetX, event.offsetY]);
    getElement(ID).$emit('instant', time);
  });
})();"""


@dataclass(frozen=True)
class TorqueLines:
    """Lines of the torque plot in a time window, N·m over s."""

    measured: Line
    predicted: Line
    error: Line


def series_of(evaluation: Evaluation | None, title: str) -> list[Series]:
    """Return the series of one recording, in the order of time."""
    parts = [] if evaluation is None else [evaluation.train, evaluation.test]
    return [
        series
        for comparison in parts
        if comparison is not None
        for series in comparison.series
        if series.recording == title or series.recording.startswith(f"{title}@")
    ]


def torque_lines(
    series: list[Series], joint: int, window: tuple[float, float], columns: int
) -> TorqueLines:
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
    return TorqueLines(**lines)


def pairs(x: Array, y: Array) -> Line:
    """Return points as a list, rounded to what a plot resolves."""
    return np.column_stack([np.round(x, 4), np.round(y, 5)]).tolist()  # type: ignore[no-any-return]


class TorquePlot(View):
    """Torque of the selected joint along a recording; the wheel zooms, dragging selects."""

    def __init__(self, workbench: Workbench) -> None:
        super().__init__(workbench)
        self._span = (0.0, 1.0)
        with ui.column().classes("panel w-full"):
            with ui.row().classes("w-full items-center gap-2 no-wrap"):
                self._title = text("Torque", "panel-title grow")
                self._recording = ui.select([], on_change=self._choose_recording)
                self._recording.props("dense borderless options-dense").classes("choice")
                named(self._recording, "recording")
            with ui.row().classes("w-full items-center gap-2 no-wrap"):
                self._hint = text("", "muted small grow ellipsis")
                self._exclude = button(
                    "Exclude selection",
                    "exclude-selection",
                    self._exclude_selection,
                    "flat size=sm",
                )
                button("Whole recording", "whole-recording", self._reset, "flat size=sm")
            empty = TorqueLines([], [], [])
            self._chart = Chart("torque-plot", _options((0.0, 1.0), empty, empty, None, "N·m", []))
        element = self._chart.element
        element.on("chart:datazoom", self._zoomed, throttle=0.12, leading_events=False)
        element.on("chart:brushEnd", self._brushed, ["areas"])
        element.on("instant", self._show_instant)

    def update(self) -> None:
        """Draw the current evaluation; the window of time stays if the recording does."""
        workbench = self.workbench
        view, session, opened = workbench.view, workbench.session, workbench.opened
        hint = "drag: select; wheel: zoom; shift and drag: move; click: show on the arm"
        if view.selection is not None:
            hint = f"selected {view.selection[0]:.2f} to {view.selection[1]:.2f} s"
        set_text(self._hint, hint)
        self._exclude.set_enabled(view.selection is not None and session.inputs.mode == "missing")
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
        self._chart.show(_options(span, lines, other, noise, unit, excluded), whole=new_recording)
        if new_recording:
            chart = self._chart.element
            chart.client.run_javascript(_START_BRUSH.replace("ID", str(chart.id)))

    def move_cursor(self, time: float) -> None:
        """Show the time of the arm's pose."""
        line = {"id": "cursor", "markLine": {"data": [{"xAxis": round(time, 3)}]}}
        self._chart.run("setOption", {"series": [line]})

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


def _options(
    span: tuple[float, float],
    lines: TorqueLines,
    other: TorqueLines,
    noise: float | None,
    unit: str,
    excluded: list[tuple[float, float]],
) -> dict[str, Any]:
    """Return the options of the plot: lines of the model that is shown, and of a compared one."""
    x_axis = {"type": "value", "min": span[0], "max": span[1]}
    y_axis = {"type": "value", "scale": True, "nameLocation": "middle", "nameGap": 40}
    labels = {"hideOverlap": True, "showMaxLabel": False}
    names = ["measured", "predicted", "error"]
    names += ["predicted (compared)", "error (compared)"] if other.predicted else []
    return {
        "animation": False,
        "textStyle": {"fontFamily": "inherit"},
        "grid": [
            {"left": 62, "right": 14, "top": 26, "height": "42%"},
            {"left": 62, "right": 14, "top": "58%", "bottom": 54},
        ],
        "legend": {"top": 0, "right": 10, "itemHeight": 8, "data": names,
                   "textStyle": {"fontSize": 11}},
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
             "moveOnMouseMove": "shift", "zoomOnMouseWheel": True},
            {"type": "slider", "xAxisIndex": [0, 1], "filterMode": "none", "height": 16,
             "bottom": 4, "showDataShadow": False, "brushSelect": False},
        ],
        "brush": {"xAxisIndex": "all", "brushLink": "all", "toolbox": [],
                  "throttleType": "debounce", "throttleDelay": 100,
                  "outOfBrush": {"colorAlpha": 1.0}},
        "toolbox": {"show": False},
        "series": _series(lines, other, noise, excluded),
    }  # fmt: skip


def _series(
    lines: TorqueLines,
    other: TorqueLines,
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
         "lineStyle": {"width": 2.4}, "data": lines.measured, "markArea": left_out},
        {**line, "id": "predicted", "name": "predicted", "color": PREDICTED,
         "lineStyle": {"width": 1.3}, "data": lines.predicted},
        {**line, **below, "id": "error", "name": "error", "color": ERROR,
         "lineStyle": {"width": 1.1}, "data": lines.error, "markArea": noise_band(noise)},
        {**line, **below, "id": "cursor", "data": [],
         "markLine": {"symbol": "none", "animation": False, "label": {"show": False},
                      "lineStyle": {"color": "#333333", "type": "solid"}, "data": []}},
        {**line, "id": "other", "name": "predicted (compared)", "color": COMPARED,
         "lineStyle": {"width": 1.3, "type": "dashed"}, "data": other.predicted},
        {**line, **below, "id": "other error", "name": "error (compared)", "color": COMPARED,
         "lineStyle": {"width": 1.1, "type": "dashed"}, "data": other.error},
    ]  # fmt: skip


class Overview(View):
    """Torque and error of every joint along the recording that is shown; a click selects one."""

    def __init__(self, workbench: Workbench) -> None:
        super().__init__(workbench)
        with ui.column().classes("panel w-full"):
            ui.label("All joints: measured and predicted torque, error below").classes(
                "panel-title"
            )
            self._list = named(ui.element("div"), "overview").classes("overview")
        self._names: tuple[str, ...] = ()
        self._cells: list[tuple[ui.element, ui.html]] = []
        on_action(self._list, self._select)

    async def _select(self, joint: str) -> None:
        self.workbench.show(replace(self.workbench.session, joint=int(joint)))

    def update(self) -> None:
        """Draw the recording."""
        evaluation, opened = self.workbench.evaluation, self.workbench.opened
        session = self.workbench.session
        if evaluation is None or opened is None:
            return
        if self._names != opened.joint_names:
            self._names = opened.joint_names
            self._build()
        for j, (cell, _) in enumerate(self._cells):
            toggle_class(cell, "selected", j == session.joint)
        floors = evaluation.errors.noise_floor
        if not self.is_new(evaluation.train, evaluation.test, floors, session.recording):
            return
        series = series_of(evaluation, opened.recordings[session.recording].name)
        for j, (_, picture) in enumerate(self._cells):
            picture.content = _joint_svg(series, j, floors[j], opened.units[j])

    def _build(self) -> None:
        self._list.clear()
        self._cells = []
        with self._list:
            for j, name in enumerate(self._names):
                cell = acting(ui.element("div").classes("overview-joint"), str(j))
                cell.props["role"], cell.props["tabindex"] = "button", "0"
                cell.props["title"] = f"joint {j + 1} {name}"
                with cell:
                    ui.label(f"{j + 1} {name}").classes("small ellipsis")
                    self._cells.append((cell, ui.html("", sanitize=False).classes("w-full")))


def _joint_svg(series: list[Series], joint: int, floor: float | None, unit: str) -> str:
    """Return a picture of the torque of a joint, and of its error with the noise band."""
    if not series:
        return ""
    start, end = series[0].time[0], series[-1].time[-1]
    size = max(float(np.abs(s.measured[:, joint]).max()) for s in series) or 1.0
    error = max(float(np.abs(s.error[:, joint]).max()) for s in series) or 1.0
    band = 14.0 * min((floor or 0.0) / error, 1.0)
    parts = [f'<rect x="0" width="200" y="{76 - band:.1f}" height="{2 * band:.1f}" fill="{BAND}"/>']
    for name, colour, width, middle, half in (
        ("measured", MEASURED, 2.2, 28.0, 26.0 / size),
        ("predicted", PREDICTED, 1.0, 28.0, 26.0 / size),
        ("error", ERROR, 0.9, 76.0, 14.0 / error),
    ):
        for s in series:
            t, y = envelope(s.time, getattr(s, name)[:, joint], SMALL_COLUMNS)
            x = 200.0 * (t - start) / max(end - start, 1e-9)
            points = np.column_stack([x, middle - half * y]).round(1)
            line = " ".join(f"{a:g},{b:g}" for a, b in points.tolist())
            parts.append(
                f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="{width}"/>'
            )
    ranges = f"±{figures(size, digits=2)}, error ±{figures(error, digits=2)} {unit}"
    parts.append(f'<text x="0" y="102" font-size="13" fill="#52606d">{escape(ranges)}</text>')
    return f'<svg viewBox="0 0 200 106" width="100%" role="img">{"".join(parts)}</svg>'
