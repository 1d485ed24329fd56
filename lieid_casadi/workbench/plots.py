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
from lieid_casadi.comparison.plots import binned_mean, intervals
from lieid_casadi.comparison.series import (
    Series,
    residual_correlations,
    residual_spectrum,
    strongest_at,
)
from lieid_casadi.plot_style import envelope, thin
from lieid_casadi.tables import figures
from lieid_casadi.workbench.elements import Chart, View, button, named, set_text, text
from lieid_casadi.workbench.evaluation import series_of
from lieid_casadi.workbench.workbench import Workbench

COLUMNS = 900  # pixels of the plot: minimum and maximum are kept for each
MOST_SAMPLES = 350  # of one direction in a plot of the error
NEAR = 0.03  # of the range of a spectrum: a click so near means a peak
Line = list[list[float | None]]  # [x, y] pairs; a pair of None interrupts the line


def torque_lines(series: list[Series], joint: int, window: tuple[float, float]) -> dict[str, Line]:
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
            line += pairs(*envelope(s.time[part], values, COLUMNS))
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
                self._title = text("Torque", "panel-title")
                hint = "drag: select; wheel: zoom; click: show on the arm"
                text(hint, "muted small grow ellipsis")
            with ui.row().classes("w-full items-center gap-2 no-wrap"):
                self._recording = ui.select([], on_change=self._choose_recording)
                self._recording.props("dense borderless options-dense").classes("choice grow")
                named(self._recording, "recording")
                self._range = ui.input("select from to, s").props("dense").classes("range")
                named(self._range, "range").on("keydown.enter", self._select_range)
                self._exclude = button(
                    "Exclude selection",
                    "exclude-selection",
                    self._exclude_selection,
                    "flat size=sm",
                )
                button("Whole recording", "whole-recording", self._reset, "flat size=sm")
            self._chart = Chart(
                "torque-plot", span=(0, 1), lines={}, other={}, noise=None, unit="", excluded=[]
            )
        element = self._chart.element
        element.on("chart:datazoom", self._zoomed, throttle=0.12, leading_events=False)
        element.on("chart:brushEnd", self._brushed, ["areas"])
        element.on("instant", self._show_instant)
        self._chart.call("emitClicks", "instant")

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
            torque_lines(series_of(each, recording.name), joint, window)
            for each in (evaluation, compared)
        )
        set_text(
            self._title,
            f"Torque of joint {joint + 1} {opened.joint_names[joint]}, "
            f"low-pass {figures(evaluation.cutoff)} Hz",
        )
        self._recording.set_options([r.name for r in opened.recordings], value=recording.name)
        self._chart.show(
            span=span, lines=lines, other=other, noise=noise, unit=unit, excluded=excluded,
            whole=new_recording,
        )  # fmt: skip

    def move_cursor(self, time: float) -> None:
        """Show the time of the arm's pose."""
        self._chart.call("moveCursor", round(time, 3))

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
        self._reset()
        await workbench.apply(workbench.session.excluding(round(start, 3), round(end, 3)))

    def _reset(self) -> None:
        self._chart.run("dispatchAction", {"type": "dataZoom", "start": 0, "end": 100})


def errors_over_signals(
    series: list[Series], joint: int, window: tuple[float, float] | None, *, revolute: bool = True
) -> list[dict[str, Any]]:
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


def _over(title: str, unit: str, signal: Array, error: Array, sign: Array) -> dict[str, Any]:
    """Return the error over one signal: samples and means, forward and backward apart."""
    edges = intervals(signal, around_zero=title == "speed")
    samples, means = [], []
    for direction in (1.0, -1.0, 0.0):
        here = sign == direction
        use = thin(here, MOST_SAMPLES)
        samples.append(pairs(signal[use], error[use]))
        centre, mean = binned_mean(signal[here], error[here], edges)
        means.append([[x, y] for x, y in pairs(centre, mean) if y == y])
    panel = {"title": title, "unit": unit, "forward_mean": means[0], "backward_mean": means[1]}
    return panel | dict(zip(("forward", "backward", "rest"), samples, strict=True))


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
            self._chart = Chart("residual-plot", panels=[], noise=None, unit="")

    of_view = True

    def draw(self, shown: Shown) -> None:
        """Draw the selected range of the recording."""
        window = self.workbench.view.selection or self.workbench.view.window
        panels = errors_over_signals(shown.series, shown.joint, window, revolute=shown.revolute)
        where = "" if window is None else f", {window[0]:.2f} to {window[1]:.2f} s"
        set_text(self._title, f"What the error of joint {shown.joint + 1} follows{where}")
        self._chart.show(panels=panels, noise=shown.floor, unit=shown.unit)


class CorrelationPlot(SeriesView):
    """Auto-correlation of the error, and its correlation with speed and acceleration."""

    def __init__(self, workbench: Workbench) -> None:
        super().__init__(workbench)
        with ui.column().classes("panel w-full"):
            self._title = text("Correlation of the error", "panel-title")
            self._chart = Chart("correlation-plot", panels=[])

    def draw(self, shown: Shown) -> None:
        """Draw the correlations along the recording."""
        found = residual_correlations(shown.series, shown.joint, shown.cutoff)
        title = f"Correlation of the error of joint {shown.joint + 1}"
        set_text(self._title, f"{title}; grey: 99 % of what noise gives")
        self._chart.show(
            panels=[
                {"title": c.title, "band": c.band, "values": pairs(c.lag, c.value)} for c in found
            ]
        )


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
            self._chart = Chart("spectrum-plot", values=[], level=None, unit="")
        self._chart.element.on("frequency", self._clicked)
        self._chart.call("emitClicks", "frequency")

    def draw(self, shown: Shown) -> None:
        """Draw the spectrum along the recording."""
        self._drawn = shown
        found = residual_spectrum(shown.series, shown.joint, shown.cutoff)
        self._frequency, self._amplitude = found
        set_text(self._title, f"Spectrum of the error of joint {shown.joint + 1}; click a peak")
        # white noise of the size of the noise floor has this amplitude at each frequency
        level = None if shown.floor is None else shown.floor / math.sqrt(max(len(found[0]), 1))
        self._chart.show(values=pairs(*found), level=level, unit=shown.unit)

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
