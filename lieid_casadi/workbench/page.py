"""The page: toolbar, views, layout, and what happens when the session changes."""

from __future__ import annotations

from collections.abc import Callable
from importlib import resources
from typing import TYPE_CHECKING

from nicegui import ui

from lieid_casadi.workbench.arm_view import ArmView
from lieid_casadi.workbench.commands import python_lines, shell_lines
from lieid_casadi.workbench.effects import EffectsView, ProposalsView
from lieid_casadi.workbench.elements import named
from lieid_casadi.workbench.error_plots import ResidualPlot, WaterfallView
from lieid_casadi.workbench.joints import HistoryView, JointsView
from lieid_casadi.workbench.open_panel import OpenPanel
from lieid_casadi.workbench.torque_plot import TorquePlot
from lieid_casadi.workbench.workbench import Workbench

if TYPE_CHECKING:
    from lieid_casadi.workbench.session import Session
    from lieid_casadi.workbench.workbench import Workbench

LANGUAGES = {"Shell": shell_lines, "Python": python_lines}


class CommandsDialog:
    """The shell commands and the Python lines of the step that is shown."""

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


def build_page(workbench: Workbench, token: str) -> Callable[[], None]:
    """Build the page of a workbench; return the function that updates it."""
    style = resources.files("lieid_casadi.workbench").joinpath("page.css").read_text("utf-8")
    ui.add_css(style)
    ui.colors(primary="#0b4f8a")
    address = f"/?token={token}&session={workbench.name}"
    ui.add_head_html(f"<script>history.replaceState(null, '', {address!r})</script>")
    toolbar = Toolbar(workbench, lambda: panel.toggle())
    panel = OpenPanel(workbench)
    error = named(ui.label(""), "error").classes("error-line")
    verdict = named(ui.label(""), "verdict").classes("verdict")
    with ui.element("div").classes("columns"):
        with ui.column().classes("side"):
            joints = JointsView(workbench)
            effects = EffectsView(workbench)
        with ui.column().classes("middle"):
            with ui.element("div").classes("top-row"):
                arm = ArmView(workbench, lambda time: torque.move_cursor(time))
                waterfall = WaterfallView(workbench)
            torque = TorquePlot(workbench)
            residual = ResidualPlot(workbench)
        with ui.column().classes("side"):
            proposals = ProposalsView(workbench)
            history = HistoryView(workbench)
    views = (toolbar, panel, joints, effects, torque, arm, waterfall, residual, proposals, history)

    def update() -> None:
        found, evaluation = workbench.session.found, workbench.evaluation
        step = workbench.session.step
        error.text = workbench.error
        error.set_visibility(bool(workbench.error))
        if found is not None and step is not None and found.effects == step.effects:
            verdict.text = found.sentence
        elif evaluation is not None:
            exact = "" if evaluation.exact else " Preliminary; the exact fit is computed."
            verdict.text = evaluation.sentence + exact
        if evaluation is not None:  # for tests and the benchmark of the latency
            verdict.props["data-complete"] = str(evaluation.complete).lower()
            verdict.props["data-seconds"] = f"{evaluation.seconds:.4f} {evaluation.cpu_seconds:.4f}"
        for view in views:
            view.update()

    workbench.listen(update)
    update()
    return update
