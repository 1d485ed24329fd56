"""The bar at the top: what is open, undo and redo, the search, commands and files."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from nicegui import ui

from lieid_casadi.workbench.views.commands_dialog import CommandsDialog
from lieid_casadi.workbench.views.elements import named

if TYPE_CHECKING:
    from lieid_casadi.workbench.state.session import Session
    from lieid_casadi.workbench.workbench import Workbench

EXPORTS = {
    "report": "Report (HTML)",
    "c": "C code (zip)",
    "urdf": "URDF and MuJoCo joints (zip)",
    "mjcf": "MuJoCo model (zip)",
}


class Toolbar:
    """Actions on the whole session.

    Parameters
    ----------
    workbench : Workbench
    open_panel : callable
        Shows or hides the form of what is open.
    """

    def __init__(self, workbench: Workbench, open_panel: Callable[[], None]) -> None:
        self._workbench = workbench
        with ui.row().classes("toolbar w-full items-center no-wrap"):
            ui.label("lieid workbench").classes("brand")
            button = ui.button("Open", on_click=open_panel)
            named(button.props("dense no-caps outline"), "open-files-panel")
            self._what = ui.label("").classes("muted grow ellipsis")
            self._spinner = ui.spinner(size="20px")
            self._undo = self._icon("undo", "undo", lambda: workbench.session.undone())
            self._redo = self._icon("redo", "redo", lambda: workbench.session.redone())
            self._find = ui.button("Find what is missing", on_click=workbench.find_missing)
            named(self._find.props("dense no-caps unelevated color=primary"), "find-missing")
            self._stop = ui.button("Stop", on_click=workbench.stop)
            named(self._stop.props("dense no-caps outline color=negative"), "stop")
            with ui.column().classes("gap-0 progress") as self._progress:
                self._stage = ui.label("").classes("small muted ellipsis")
                self._bar = ui.linear_progress(show_value=False, size="6px")
            copy = ui.button("Copy as command", on_click=CommandsDialog(workbench).show)
            named(copy.props("dense no-caps outline"), "copy-command")
            save = ui.button("Save fit", on_click=lambda: self._save("fit"))
            named(save.props("dense no-caps outline"), "save-fit")
            export = ui.dropdown_button("Export", auto_close=True)
            export.props("dense no-caps outline transition-duration=0")
            with named(export, "export"):
                for kind, text in EXPORTS.items():
                    item = ui.item(text, on_click=lambda kind=kind: self._save(kind))
                    named(item, f"save-{kind}")

    def update(self) -> None:
        """Show what is possible now."""
        workbench = self._workbench
        session, opened = workbench.session, workbench.opened
        if opened is not None:
            kinds = {"train": "fitted", "test": "test"}
            if session.inputs.mode == "changed":
                kinds["test"] = "new"
            names = [
                f"{r.name} ({kinds[given.role]})"
                for r, given in zip(opened.recordings, session.inputs.recordings, strict=True)
            ]
            self._what.text = f"{opened.robot}: {', '.join(names) or 'no recordings'}"
        searching = workbench.search.activity is not None
        changed = session.inputs.mode == "changed"
        self._find.text = "Find what has changed" if changed else "Find what is missing"
        self._undo.set_enabled(session.can_undo)
        self._redo.set_enabled(session.can_redo)
        self._find.set_visibility(not searching)
        self._find.set_enabled(session.step is not None)
        self._stop.set_visibility(searching)
        self._progress.set_visibility(searching)
        if workbench.search.activity is not None:
            self._stage.text, self._bar.value = workbench.search.activity
        self._spinner.set_visibility(workbench.computing)

    def _icon(self, name: str, test_id: str, change: Callable[[], Session]) -> ui.button:
        workbench = self._workbench
        button = ui.button(icon=name, on_click=lambda: workbench.apply(change()))
        button.props["aria-label"] = test_id
        return named(button.props("dense flat round"), test_id).tooltip(test_id)

    async def _save(self, kind: str) -> None:
        made = await self._workbench.save(kind)
        if made is not None:
            name, content = made
            ui.download.content(content, name)
