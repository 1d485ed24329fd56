"""The joints with their errors, the history of models, all joints and models at a glance."""

from __future__ import annotations

from typing import Any

import numpy as np
from markupsafe import Markup
from nicegui import ui

from lieid_casadi.comparison.series import Series
from lieid_casadi.plot_style import ERROR, MEASURED, PREDICTED, envelope, shortened
from lieid_casadi.tables import MISSING, figures, html
from lieid_casadi.workbench.elements import (
    BAND,
    COMPARED,
    FIRST,
    Chart,
    Parts,
    View,
    cut_part,
    icon_part,
    named,
    part,
    ratio,
    ratio_colour,
    set_text,
    text,
)
from lieid_casadi.workbench.evaluation import difference_tables, series_of
from lieid_casadi.workbench.session import ModelStep, Numbers, StepErrors
from lieid_casadi.workbench.workbench import Workbench

LONGEST_TITLE = 26  # characters of a model's title
SMALL_COLUMNS = 150  # of the plot of one joint in the overview
HEADINGS = {
    "held out": "RMS error in motion, cross-validated (no test)",
    "test": "RMS error in motion on the test",
}


class JointsView(View):
    """Two lines per joint: its name and error; noise floor, ratio, fit."""

    def __init__(self, workbench: Workbench) -> None:
        super().__init__(workbench)
        self._errors: StepErrors | None = None  # the last that were known
        with ui.column().classes("panel w-full"):
            self._title = ui.label("Error of each joint").classes("panel-title")
            self._list = Parts("joint-list", workbench.select)

    def update(self) -> None:
        """Show the errors of the current step; while it is fitted, the last ones, in grey."""
        workbench, opened = self.workbench, self.workbench.opened
        session = workbench.session
        set_text(self._title, HEADINGS[session.error_name])
        errors = None if session.step is None else session.step.errors
        outdated = "" if errors is not None else "outdated"
        self._errors = errors or (self._errors if session.can_undo else None)
        count = 0 if opened is None else len(opened.joint_names)
        if self._errors is not None and len(self._errors.shown) != count:
            self._errors = None
        self._list.show(*(self._row(j, self._errors, outdated) for j in range(count)))

    def _row(self, j: int, errors: StepErrors | None, state: str) -> Markup:
        workbench, opened, evaluation = (
            self.workbench,
            self.workbench.opened,
            self.workbench.evaluation,
        )
        assert opened is not None
        # The noise floor of the last model stays, in grey, until that of this one is computed.
        preliminary = "preliminary" if evaluation is None or not evaluation.complete else ""
        inexact = "inexact" if evaluation is not None and not evaluation.exact else ""
        selected = "selected" if workbench.session.joint == j else ""
        error, number = MISSING, j + 1
        noise = multiple = fit = other = ""
        colour = ratio_colour(None)
        if errors is not None:
            error = f"{figures(errors.shown[j])} {opened.units[j]}"
            noise = f"noise {figures(errors.noise_floor[j])}"
            over, percent = ratio(errors.shown[j], errors.noise_floor[j]), errors.fit_percent(j)
            multiple = "" if over is None else f"{figures(over)} ×"
            fit = "" if percent is None else f"{percent:.1f} % fit"
            colour = ratio_colour(over)
            if workbench.compared is not None:
                other = _difference(workbench.compared.errors.shown[j], errors.shown[j])
        return part(
            f"joint-row {state or preliminary} {inexact} {selected}",
            part("swatch", style=f"background: {colour}"),
            cut_part("joint-name", f"{number} {opened.joint_names[j]}"),
            cut_part("number strong", error, id=f"error-{number}"),
            part(
                "joint-facts muted small",
                cut_part("number noise", noise or MISSING, id=f"noise-{number}"),
                cut_part("number noise", multiple),
                cut_part("number", fit, id=f"fit-percent-{number}"),
                cut_part("number compared", other, id=f"compared-{number}") if other else "",
            ),
            id=f"joint-{number}",
            action=str(j),
        )


def _difference(other: float | None, error: float | None) -> str:
    """Return the error of the compared model, and how much that of the shown one differs."""
    if other is None or error is None or not other:
        return figures(other)
    return f"{figures(other)} ({100.0 * (error / other - 1.0):+z.0f} %)"


class HistoryView(View):
    """The steps taken so far with the error of the selected joint; a click returns to one."""

    def __init__(self, workbench: Workbench) -> None:
        super().__init__(workbench)
        with ui.column().classes("panel w-full"):
            self._title = ui.label("History").classes("panel-title")
            self._list = Parts("scroll", self._act)

    async def _act(self, action: str) -> None:
        """Return to a step, or compare it with the one that is shown."""
        kind, number = action.split()
        workbench, k = self.workbench, int(number)
        if kind == "show":
            await workbench.apply(workbench.session.at(k))
        else:
            await workbench.compare_with(None if workbench.view.compared == k else k)

    def update(self) -> None:
        """Show the steps."""
        session = self.workbench.session
        set_text(self._title, f"History, error of joint {session.joint + 1} [N·m]")
        self._list.show(*(self._row(k, step) for k, step in enumerate(session.history)))

    def _row(self, k: int, step: ModelStep) -> Markup:
        session, other = self.workbench.session, self.workbench.view.compared == k
        shown = [cut_part("grow ellipsis", f"{k + 1}. {step.title}")]
        if step.errors is not None:
            trained, unseen = (e[session.joint] for e in (step.errors.train, step.errors.shown))
            shown.append(part("number muted", f"train {figures(trained)}"))
            shown.append(part("number", f"{session.error_name} {figures(unseen)}"))
        if other or k != session.position:
            meaning = "end the comparison" if other else "compare with the step that is shown"
            names = {"id": f"compare-{k + 1}", "css": "accent" if other else ""}
            shown.append(icon_part("compare_arrows", f"compare {k}", meaning, **names))
        state = "selected" if k == session.position else "undone" if k > session.position else ""
        return part(f"history-row {state}", *shown, id=f"step-{k + 1}", action=f"show {k}")


class DifferenceView(View):
    """Errors and effects of the compared model beside those of the shown one."""

    def __init__(self, workbench: Workbench) -> None:
        super().__init__(workbench)
        with ui.column().classes("panel w-full") as self._panel:
            self._title = text("Difference", "panel-title")
            self._tables = named(ui.html("", sanitize=False), "difference-table")
            self._tables.classes("difference")

    def update(self) -> None:
        """Show the tables while a model is compared."""
        workbench, session = self.workbench, self.workbench.session
        shown, other, position = workbench.evaluation, workbench.compared, workbench.view.compared
        self._panel.set_visibility(other is not None)
        if shown is None or other is None or position is None:
            return
        if self.is_new(shown, other, position, session.position, session.joint):
            titles = (session.history[k].title for k in (position, session.position))
            set_text(self._title, " → ".join(titles))
            tables = difference_tables(session, position, (other, shown), session.joint)
            self._tables.set_content(html(*(t for t in tables if t.rows)))


class Overview(View):
    """Torque and error of every joint along the recording that is shown; a click selects one."""

    def __init__(self, workbench: Workbench) -> None:
        super().__init__(workbench)
        self._pictures: list[tuple[Markup, str]] = []
        with ui.column().classes("panel w-full"):
            title = "All joints: measured and predicted torque, error below"
            ui.label(title).classes("panel-title")
            self._list = Parts("overview", workbench.select)
            named(self._list.element, "overview")

    def update(self) -> None:
        """Draw the recording."""
        evaluation, opened = self.workbench.evaluation, self.workbench.opened
        session = self.workbench.session
        if evaluation is None or opened is None:
            return
        floors = evaluation.errors.noise_floor
        if self.is_new(evaluation.train, evaluation.test, floors, session.recording):
            series = series_of(evaluation, opened.recordings[session.recording].name)
            drawn = enumerate(opened.units)
            self._pictures = [_joint_svg(series, j, floors[j], unit) for j, unit in drawn]
            count = len(self._pictures)
            half = count if count <= 4 else (count + 1) // 2  # so that no place stays empty
            self._list.element.style(f"--all: {count}; --half: {half}")
        self._list.show(
            *(
                part(
                    f"overview-joint {'selected' if j == session.joint else ''}",
                    part("small ellipsis", f"{j + 1} {name}"),
                    picture,
                    cut_part("muted small ellipsis", ranges),
                    tip=f"joint {j + 1} {name}",
                    action=str(j),
                )
                for j, (name, (picture, ranges)) in enumerate(
                    zip(opened.joint_names, self._pictures, strict=True)
                )
            )
        )


def _joint_svg(
    series: list[Series], joint: int, floor: float | None, unit: str
) -> tuple[Markup, str]:
    """Return a picture of the torque of a joint and of its error with the noise band; ranges."""
    if not series:
        return Markup(), ""
    start, end = series[0].time[0], series[-1].time[-1]
    torques = [torque[:, joint] for s in series for torque in (s.measured, s.predicted)]
    size = max(float(np.abs(torque).max()) for torque in torques) or 1.0
    error = max(float(np.abs(s.error[:, joint]).max()) for s in series) or 1.0
    band = 14.0 * min((floor or 0.0) / error, 1.0)
    lines = [f'<rect x="0" width="200" y="{76 - band:.1f}" height="{2 * band:.1f}" fill="{BAND}"/>']
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
            lines.append(
                f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="{width}"/>'
            )
    ranges = f"±{figures(size, digits=2)}, error ±{figures(error, digits=2)} {unit}"
    return Markup(f'<svg viewBox="0 0 200 92" width="100%">{"".join(lines)}</svg>'), ranges


class WaterfallView(View):
    """Bars: unseen error of the first and the shown model; diamonds: training; dashes: noise."""

    def __init__(self, workbench: Workbench) -> None:
        super().__init__(workbench)
        with ui.column().classes("panel w-full"):
            self._title = text("Error of the models, first model = 1", "panel-title")
            self._chart = Chart("waterfall", **_waterfall([], None))

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
            self._chart.show(**_waterfall(known, playing))


def relative(values: Numbers, first: Numbers) -> list[float | None]:
    """Return values relative to those of the first model, None where one is unknown."""
    return [
        None if value is None or not start else round(value / start, 4)
        for value, start in zip(values, first, strict=True)
    ]


def _waterfall(
    models: list[tuple[str, str, StepErrors]], playing: Numbers | None
) -> dict[str, Any]:
    """Return the bars of models (title, colour, errors); those of the second may be on their way.

    The training error and the noise floor are those of the second model.
    """
    if not models:
        return {"models": [], "training": [], "noise": [], "playing": False}
    first, last = models[0][2], models[min(1, len(models) - 1)][2]
    bars = []
    for k, (title, color, errors) in enumerate(models):
        values = playing if k == 1 and playing is not None else errors.shown
        bars.append(
            {
                "name": shortened(title, LONGEST_TITLE),
                "color": color,
                "errors": relative(values, first.shown),
            }
        )
    return {
        "models": bars,
        "training": relative(last.train, first.train) if any(first.train) else [],
        "noise": relative(last.noise_floor, first.shown),
        "playing": playing is not None,
    }
