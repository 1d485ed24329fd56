"""The commands that reproduce the state, in a dialog from which they are copied."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui

from lieid_casadi.workbench.state.commands import python_lines, shell_lines
from lieid_casadi.workbench.views.elements import named

if TYPE_CHECKING:
    from lieid_casadi.workbench.workbench import Workbench

LANGUAGES = {"Shell": shell_lines, "Python": python_lines}


class CommandsDialog:
    """The shell commands and the Python lines of the step that is shown.

    Parameters
    ----------
    workbench : Workbench
    """

    def __init__(self, workbench: Workbench) -> None:
        self._workbench = workbench
        self._texts: dict[str, ui.label] = {}
        with (
            ui.dialog().props("transition-duration=0") as self._dialog,
            ui.card().classes("commands"),
        ):
            for title in LANGUAGES:
                with ui.row().classes("w-full items-center"):
                    ui.label(title).classes("panel-title grow")
                    button = ui.button("Copy", on_click=lambda title=title: self._copy(title))
                    button.props("dense flat no-caps")
                self._texts[title] = named(ui.label("").classes("code"), f"command-{title.lower()}")
            close = ui.button("Close", on_click=self._dialog.close).props("flat no-caps")
            named(close, "close-commands")

    def show(self) -> None:
        """Show the commands, and copy those for the shell."""
        session, evaluation = self._workbench.session, self._workbench.evaluation
        if session.step is None:
            return
        cutoff = None if evaluation is None else evaluation.cutoff
        for title, text in self._texts.items():
            text.text = LANGUAGES[title](session, cutoff)
        self._copy("Shell")
        self._dialog.open()

    def _copy(self, title: str) -> None:
        ui.clipboard.write(self._texts[title].text)
