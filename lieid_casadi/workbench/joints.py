"""The joints with their errors, and the history of models."""

from __future__ import annotations

import math
from dataclasses import replace

from nicegui import ui

from lieid_casadi.workbench.elements import (
    UNKNOWN,
    View,
    acting,
    figures,
    icon_button,
    named,
    on_action,
    ratio,
    ratio_colour,
    set_text,
    text,
    toggle_class,
)
from lieid_casadi.workbench.evaluation import SimulationError
from lieid_casadi.workbench.session import ModelStep, StepErrors
from lieid_casadi.workbench.workbench import Workbench

HEADINGS = {
    "new": "RMS error in motion on the new recordings",
    "held out": "RMS error in motion, cross-validated (no test)",
    "test": "RMS error in motion on the test",
}


class JointsView(View):
    """Two lines per joint: its name and error; noise floor, ratio, fit, simulation error."""

    def __init__(self, workbench: Workbench) -> None:
        super().__init__(workbench)
        self._rows: list[_JointRow] = []
        with ui.column().classes("panel w-full"):
            self._title = ui.label("Error of each joint").classes("panel-title")
            self._list = ui.column().classes("w-full gap-0")
            self._reason = text("", "muted small w-full ellipsis", "not-simulated")
        on_action(self._list, self._select)

    async def _select(self, joint: str) -> None:
        self.workbench.show(replace(self.workbench.session, joint=int(joint)))

    def update(self) -> None:
        """Show the errors of the current step."""
        opened = self.workbench.opened
        names = [] if opened is None else list(opened.joint_names)
        if [row.name for row in self._rows] != names:
            self._list.clear()
            with self._list:
                self._rows = [_JointRow(self.workbench, j, name) for j, name in enumerate(names)]
        set_text(self._title, HEADINGS[self.workbench.session.error_name])
        simulation = self.workbench.simulation
        for row in self._rows:
            row.update(simulation)
        reason = "" if simulation is None else simulation.reason
        set_text(self._reason, reason and f"Not simulated: {reason}.")
        self._reason.set_visibility(bool(reason))


class _JointRow:
    def __init__(self, workbench: Workbench, joint: int, name: str) -> None:
        self._workbench, self._joint, self.name = workbench, joint, name
        number = joint + 1
        self._row = acting(named(ui.row(), f"joint-{number}").classes("joint-row"), str(joint))
        self._row.props["role"], self._row.props["tabindex"] = "button", "0"
        with self._row:
            self._swatch = ui.element("span").classes("swatch")
            text(f"{number} {name}", "joint-name")
            self._other = text("", "number compared", f"compared-{number}")
            self._error = text(UNKNOWN, "number strong", f"error-{number}")
            with ui.row().classes("joint-facts muted small"):
                self._noise = text(UNKNOWN, "number noise", f"noise-{number}")
                self._ratio = text("", "number noise")
                self._fit = text("", "number", f"fit-percent-{number}")
                self._simulated = text("", "number ellipsis", f"simulated-{number}")

    def update(self, simulation: SimulationError | None) -> None:
        """Show the errors of the current step, and the simulation error once it is computed."""
        workbench, j = self._workbench, self._joint
        step = workbench.session.step
        errors = None if step is None else step.errors
        toggle_class(self._row, "selected", workbench.session.joint == j)
        # While a changed model is fitted the last errors stay, in grey.
        toggle_class(self._row, "outdated", errors is None)
        if errors is None:
            if not workbench.session.can_undo:
                set_text(self._error, UNKNOWN)
            return
        evaluation = workbench.evaluation
        # The noise floor of the last model stays, in grey, until that of this one is computed.
        preliminary = evaluation is None or not evaluation.complete
        toggle_class(self._row, "preliminary", preliminary)
        self._show(errors, "" if simulation is None else self._drift(simulation))

    def _show(self, errors: StepErrors, drift: str) -> None:
        workbench, j = self._workbench, self._joint
        assert workbench.opened is not None
        error, floor, fit = errors.shown[j], errors.noise_floor[j], errors.fit_percent(j)
        multiple, compared = ratio(error, floor), workbench.compared
        set_text(self._error, f"{figures(error)} {workbench.opened.units[j]}")
        set_text(self._noise, f"noise {figures(floor, digits=2)}")
        set_text(self._ratio, "" if multiple is None else f"{multiple:.1f} ×")
        set_text(self._fit, "" if fit is None else f"{fit:.1f} % fit")
        other = None if compared is None else compared.errors.shown[j]
        set_text(self._other, "" if compared is None else _difference(other, error))
        self._other.set_visibility(compared is not None)
        self._swatch.style(f"background: {ratio_colour(multiple)}")
        set_text(self._simulated, drift)

    def _drift(self, simulation: SimulationError) -> str:
        """Return the simulation error of the joint as text."""
        rms, opened = simulation.rms[self._joint], self._workbench.opened
        if rms is None or opened is None:
            return ""
        turns = opened.revolute[self._joint]
        degrees = turns and self._workbench.session.degrees
        value, unit = (math.degrees(rms), "°") if degrees else (rms, " rad" if turns else " m")
        return f"{figures(value, digits=2)}{unit} off after {simulation.window:g} s"


def _difference(other: float | None, error: float | None) -> str:
    """Return the error of the compared model, and how much that of the shown one differs."""
    if other is None or error is None or not other:
        return figures(other)
    return f"{figures(other)} ({100.0 * (error / other - 1.0):+.0f} %)"


class HistoryView(View):
    """The steps taken so far with the error of the selected joint; a click returns to one."""

    def __init__(self, workbench: Workbench) -> None:
        super().__init__(workbench)
        with ui.column().classes("panel w-full"):
            self._title = ui.label("History").classes("panel-title")
            self._list = ui.column().classes("w-full gap-0 scroll")
        on_action(self._list, self._act)

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
        session, compared = self.workbench.session, self.workbench.view.compared
        if not self.is_new(session.history, session.position, session.joint, compared):
            return
        set_text(self._title, f"History, error of joint {session.joint + 1} [N·m]")
        self._list.clear()
        with self._list:
            for k, step in enumerate(session.history):
                self._row(k, step)

    def _row(self, k: int, step: ModelStep) -> None:
        session = self.workbench.session
        row = named(ui.row(), f"step-{k + 1}").classes("history-row")
        row.props["role"], row.props["tabindex"] = "button", "0"
        toggle_class(row, "selected", k == session.position)
        toggle_class(row, "undone", k > session.position)
        with acting(row, f"show {k}"):
            text(f"{k + 1}. {step.title}", "grow ellipsis")
            if step.errors is not None:
                trained, shown = (e[session.joint] for e in (step.errors.train, step.errors.shown))
                ui.label(f"train {figures(trained)}").classes("number muted")
                ui.label(f"{session.error_name} {figures(shown)}").classes("number")
            other = self.workbench.view.compared == k
            if k == session.position and not other:
                return
            meaning = "end the comparison" if other else "compare with the step that is shown"
            look = "size=xs color=accent" if other else "size=xs"
            acting(icon_button("compare_arrows", f"compare-{k + 1}", meaning, look), f"compare {k}")
