"""The steps taken so far with their errors; a click returns to one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui

from lieid_casadi.workbench.state.session import ModelStep
from lieid_casadi.workbench.views.elements import acting, figures, named, on_action

if TYPE_CHECKING:
    from lieid_casadi.workbench.workbench import Workbench


class HistoryView:
    """The steps with the error of the selected joint.

    Parameters
    ----------
    workbench : Workbench
    """

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
