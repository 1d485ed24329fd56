"""The joints with their errors, and the history of models."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from nicegui import ui

from lieid_casadi.workbench.elements import UNKNOWN, acting, figures, named, on_action, ratio_colour
from lieid_casadi.workbench.evaluation import SimulationError
from lieid_casadi.workbench.session import ModelStep

if TYPE_CHECKING:
    from lieid_casadi.workbench.workbench import Workbench


class JointsView:
    """One row per joint: name, error in motion, noise floor, and their ratio."""

    def __init__(self, workbench: Workbench) -> None:
        self._workbench = workbench
        self._rows: list[_JointRow] = []
        with ui.column().classes("panel w-full"):
            self._title = ui.label("Error of each joint").classes("panel-title")
            self._list = ui.column().classes("w-full gap-0")
            self._reason = named(ui.label(""), "not-simulated").classes("muted small w-full")
            self._reason.classes("ellipsis")
            with self._reason:
                self._whole_reason = ui.tooltip("")

    def update(self) -> None:
        """Show the errors of the current step."""
        opened = self._workbench.opened
        names = () if opened is None else opened.joint_names
        if [row.name for row in self._rows] != list(names):
            self._list.clear()
            with self._list:
                self._rows = [_JointRow(self._workbench, j, name) for j, name in enumerate(names)]
        self._title.text = self._heading()
        step = self._workbench.session.step
        simulation = None if step is None else self._workbench.details.simulation(step)
        for row in self._rows:
            row.update(simulation)
        reason = "" if simulation is None else simulation.reason
        self._reason.text = reason and f"Not simulated: {reason}."
        self._whole_reason.text = self._reason.text
        self._reason.set_visibility(bool(reason))

    def _heading(self) -> str:
        evaluation, inputs = self._workbench.evaluation, self._workbench.session.inputs
        if inputs.mode == "changed":
            return "RMS error in motion on the new recordings"
        if evaluation is not None and evaluation.test is None:
            return "RMS error in motion, cross-validated (no test)"
        return "RMS error in motion on the test"


class _JointRow:
    def __init__(self, workbench: Workbench, joint: int, name: str) -> None:
        self._workbench, self._joint, self.name = workbench, joint, name
        number = joint + 1
        self._row = named(ui.row(), f"joint-{number}").classes("joint-row")
        self._row.props["role"], self._row.props["tabindex"] = "button", "0"
        self._row.on("click", self._select)
        self._row.on("keydown.enter", self._select)
        with self._row:
            self._swatch = ui.element("span").classes("swatch")
            ui.label(f"{number} {name}").classes("joint-name").tooltip(name)
            self._error = named(ui.label(UNKNOWN), f"error-{number}").classes("number strong")
            self._other = named(ui.label(""), f"compared-{number}").classes("number compared")
            self._other.tooltip("error of the step that is compared")
            self._noise = named(ui.label(UNKNOWN), f"noise-{number}").classes("number muted noise")
            self._ratio = ui.label("").classes("number ratio noise")
            self._simulated = named(ui.label(""), f"simulated-{number}")
            self._simulated.classes("muted small simulated")

    def update(self, simulation: SimulationError | None) -> None:
        """Show the errors of the current step, and the simulation error once it is computed."""
        workbench, j = self._workbench, self._joint
        assert workbench.opened is not None
        step, unit = workbench.session.step, workbench.opened.units[j]
        errors = None if step is None else step.errors
        self._row.classes(
            add="selected" if workbench.session.joint == j else "",
            remove="" if workbench.session.joint == j else "selected",
        )
        # While a changed model is fitted the last errors stay, in grey.
        self._row.classes(
            add="outdated" if errors is None else "", remove="" if errors is None else "outdated"
        )
        if errors is None:
            if not workbench.session.can_undo:
                self._error.text = UNKNOWN
            return
        evaluation = workbench.evaluation
        estimated = evaluation is not None and evaluation.complete
        self._row.classes(  # the noise floor of the last model stays, in grey
            add="" if estimated else "preliminary", remove="preliminary" if estimated else ""
        )
        error, floor = errors.shown[j], errors.noise_floor[j]
        ratio = None if error is None or not floor else error / floor
        self._error.text = f"{figures(error)} {unit}"
        self._noise.text = f"noise {figures(floor, digits=2)}"
        self._ratio.text = "" if ratio is None else f"{ratio:.1f} ×"
        compared = workbench.compared
        self._other.text = "" if compared is None else figures(compared.errors.shown[j])
        self._other.set_visibility(compared is not None)
        self._swatch.style(f"background: {ratio_colour(ratio)}")
        self._simulated.text = "" if simulation is None else self._drift(simulation)
        self._simulated.set_visibility(bool(self._simulated.text))

    def _drift(self, simulation: SimulationError) -> str:
        """Return the simulation error of the joint as text."""
        rms, opened = simulation.rms[self._joint], self._workbench.opened
        if rms is None or opened is None:
            return ""
        turns = opened.revolute[self._joint]
        degrees = turns and self._workbench.session.degrees
        value, unit = (math.degrees(rms), "°") if degrees else (rms, " rad" if turns else " m")
        return f"{figures(value, digits=2)}{unit} off after {simulation.window:g} s of simulation"

    def _select(self) -> None:
        workbench = self._workbench
        workbench.show(replace(workbench.session, joint=self._joint))


class HistoryView:
    """The steps with the error of the selected joint."""

    def __init__(self, workbench: Workbench) -> None:
        self._workbench = workbench
        self._shown: object = None
        with ui.column().classes("panel w-full grow-panel"):
            self._title = ui.label("History").classes("panel-title")
            self._list = ui.column().classes("w-full gap-0 scroll")
        on_action(self._list, self._act)

    async def _act(self, action: str) -> None:
        """Return to a step, or compare it with the one that is shown."""
        kind, number = action.split()
        workbench, k = self._workbench, int(number)
        if kind == "show":
            await workbench.apply(workbench.session.at(k))
        else:
            await workbench.compare_with(None if workbench.view.compared == k else k)

    def update(self) -> None:
        """Show the steps."""
        session = self._workbench.session
        compared = self._workbench.view.compared
        now = (session.history, session.position, session.joint, compared)
        if now == self._shown:
            return
        self._shown = now
        self._title.text = f"History, error of joint {session.joint + 1}"
        self._list.clear()
        with self._list:
            for k, step in enumerate(session.history):
                self._row(k, step)

    def _shown_error(self) -> str:
        """Return of what the error is that the page shows."""
        inputs = self._workbench.session.inputs
        if inputs.mode == "changed":
            return "new"
        return "test" if inputs.paths("test") else "held out"

    def _row(self, k: int, step: ModelStep) -> None:
        workbench = self._workbench
        session = workbench.session
        row = named(ui.row(), f"step-{k + 1}").classes("history-row")
        if k == session.position:
            row.classes("selected")
        elif k > session.position:
            row.classes("undone")
        with acting(row, f"show {k}"):
            ui.label(f"{k + 1}. {step.title}").classes("grow")
            joint, errors = session.joint, step.errors
            if errors is not None:
                train, shown = errors.train[joint], errors.shown[joint]
                ui.label(f"train {figures(train)}").classes("number muted")
                ui.label(f"{self._shown_error()} {figures(shown)}").classes("number")
            other = workbench.view.compared == k
            if not other and k == session.position:
                return
            button = ui.button(icon="compare_arrows").props("flat dense round size=xs")
            button.props["aria-label"] = f"compare with step {k + 1}"
            title = "end the comparison" if other else "compare with the step that is shown"
            button.props["title"] = title
            named(acting(button, f"compare {k}"), f"compare-{k + 1}")
            if other:
                button.props("color=accent")
