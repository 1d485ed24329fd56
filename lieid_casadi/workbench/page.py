"""The page: toolbar, views, layout, the commands that reproduce it, and what changes do."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable

from nicegui import ui

from lieid_casadi.effects import parse_effects
from lieid_casadi.effects.placement import labels
from lieid_casadi.workbench import joints
from lieid_casadi.workbench.arm_view import ArmView
from lieid_casadi.workbench.effects import EffectsView, FindingsView
from lieid_casadi.workbench.elements import (
    View,
    button,
    icon_button,
    named,
    open_page,
    set_text,
    text,
)
from lieid_casadi.workbench.open_panel import OpenPanel
from lieid_casadi.workbench.plots import CorrelationPlot, ResidualPlot, SpectrumPlot, TorquePlot
from lieid_casadi.workbench.premises import PremisesView
from lieid_casadi.workbench.session import ModelStep, Role, Session, WorkbenchInputs, kept_parts
from lieid_casadi.workbench.workbench import SOON, Work, Workbench

EXPORTS = {
    "report": "Report (HTML)",
    "c": "C code (zip)",
    "urdf": "URDF and MuJoCo joints (zip)",
    "mjcf": "MuJoCo model (zip)",
}


def build_page(workbench: Workbench, token: str) -> Callable[[], None]:
    """Build the page of a workbench; return the function that updates it."""
    open_page()
    address = f"/?token={token}&session={workbench.name}"
    ui.add_head_html(f"<script>history.replaceState(null, '', {address!r})</script>")
    toolbar = Toolbar(workbench, lambda: panel.toggle())
    panel = OpenPanel(workbench)
    error = named(ui.label(""), "error").classes("error-line")
    views: list[View] = [toolbar, panel, PremisesView(workbench), FindingsView(workbench)]
    with ui.element("div").classes("columns"):
        with ui.column().classes("side"):
            views.append(joints.JointsView(workbench))
            views.append(ArmView(workbench, lambda time: torque.move_cursor(time)))
            views += [joints.HistoryView(workbench), joints.DifferenceView(workbench)]
        with ui.column().classes("middle"):
            views += [joints.WaterfallView(workbench), joints.Overview(workbench)]
            views += [torque := TorquePlot(workbench), ResidualPlot(workbench)]
            with ui.element("div").classes("pair"):
                views += [CorrelationPlot(workbench), SpectrumPlot(workbench)]
        with ui.column().classes("side"):
            views.append(EffectsView(workbench))

    def update() -> None:
        error.text = workbench.error
        error.set_visibility(bool(workbench.error))
        for view in views:
            view.update()

    workbench.listen(update)
    update()
    return update


class Toolbar(View):
    """Actions on the whole session; ``open_panel`` shows or hides the form of what is open."""

    def __init__(self, workbench: Workbench, open_panel: Callable[[], None]) -> None:
        super().__init__(workbench)
        outline = "outline"
        with ui.row().classes("toolbar w-full items-center no-wrap"):
            ui.label("lieid workbench").classes("brand")
            button("Open", "open-files-panel", open_panel, outline)
            self._what = text("", "muted grow ellipsis")
            self._spinner = ui.spinner(size="20px")
            self._undo, self._redo = self._step("undo", -1), self._step("redo", 1)
            self._find = button(
                "Find what is missing", "find-missing", workbench.find_missing,
                "unelevated color=primary",
            )  # fmt: skip
            self._stop = button("Stop", "stop", workbench.stop, "outline color=negative")
            with ui.column().classes("gap-0 progress") as self._progress:
                self._stage = text("", "small muted ellipsis w-full", "progress")
                self._bar = ui.linear_progress(show_value=False, size="6px")
            self._timer = ui.timer(SOON, self._show_progress, active=False)
            button("Copy as command", "copy-command", CommandsDialog(workbench).show, outline)
            self._save_fit = button("Save fit", "save-fit", lambda: self._save("fit"), outline)
            export = ui.dropdown_button("Export", auto_close=True)
            export.props("dense no-caps outline transition-duration=0")
            with named(export, "export"):
                for kind, content in EXPORTS.items():
                    item = ui.item(content, on_click=lambda kind=kind: self._save(kind))
                    named(item, f"save-{kind}")

    def update(self) -> None:
        """Show what is possible now."""
        workbench = self.workbench
        session, opened = workbench.session, workbench.opened
        if opened is not None:
            kinds = {"train": "fitted", "test": "test"}
            both = zip(opened.recordings, session.inputs.recordings, strict=True)
            names = [f"{r.name} ({kinds[given.role]})" for r, given in both]
            set_text(self._what, f"{opened.robot}: {', '.join(names) or 'no recordings'}")
        searching = workbench.searching
        activity = self._show_progress()
        self._undo.set_enabled(session.can_undo)
        self._redo.set_enabled(session.can_redo)
        self._find.set_visibility(searching is None)
        self._find.set_enabled(session.step is not None)
        self._stop.set_visibility(activity is not None)
        self._progress.set_visibility(activity is not None)
        self._timer.active = activity is not None
        self._save_fit.set_enabled(workbench.saving is None)
        # of opening; while a model is fitted the last errors are grey, and moving pictures slow
        self._spinner.set_visibility(workbench.computing and workbench.fitting is None)

    def _show_progress(self) -> Work | None:
        """Show the stage of long work and the time that is left, and return the work."""
        workbench, fitting = self.workbench, self.workbench.fitting
        activity = workbench.searching or workbench.saving
        if fitting is not None and fitting.seconds >= SOON:
            activity = fitting
        if activity is not None:
            set_text(self._stage, activity.text)
            self._bar.value = activity.fraction
        return activity

    def _step(self, name: str, by: int) -> ui.button:
        workbench = self.workbench
        return icon_button(name, name, name, "").on_click(
            lambda: workbench.apply(workbench.session.at(workbench.session.position + by))
        )

    async def _save(self, kind: str) -> None:
        client, workbench = self._what.client, self.workbench
        made = await workbench.save(kind)
        if made is not None and not client.is_deleted:  # the tab may be closed meanwhile
            name, content = made
            ui.download.content(content, name)


class CommandsDialog:
    """The shell commands of the step that is shown, to be copied."""

    def __init__(self, workbench: Workbench) -> None:
        self._workbench = workbench
        with (
            ui.dialog().props("transition-duration=0") as self._dialog,
            ui.card().classes("commands"),
        ):
            self._text = named(ui.label("").classes("code"), "command-shell")
            with ui.row():
                button("Copy", "copy-shell", self._copy)
                button("Close", "close-commands", self._dialog.close)

    def show(self) -> None:
        """Show the commands, and copy them."""
        session, evaluation = self._workbench.session, self._workbench.evaluation
        if session.step is None:
            return
        self._text.text = shell_lines(session, None if evaluation is None else evaluation.cutoff)
        self._copy()
        self._dialog.open()

    def _copy(self) -> None:
        # a browser may refuse; the text is in the dialog
        text = json.dumps(self._text.text)
        ui.run_javascript(f"navigator.clipboard?.writeText({text}).catch(() => {{}})")


def shell_lines(session: Session, cutoff: float | None = None) -> str:
    """Return ``lieid`` commands that fit the model of the current step and diagnose it."""
    inputs, step = session.inputs, session.step
    assert step is not None  # there is nothing to reproduce before inputs are open
    train, test = _paths(inputs, step, "train"), _paths(inputs, step, "test")
    options = [*inputs.words, *([] if cutoff is None else ["--cutoff", repr(cutoff)])]
    source = inputs.fit or inputs.robot
    given = [*(["--test", *test] if test else []), "--effects", _effects(step), *options]
    identify = shlex.join(["lieid", "identify", source, *train, *given, "-o", "fit.json"])
    if inputs.fit:  # lieid diagnose FIT looks for changes since the fit
        return identify
    return f"{identify}\n{shlex.join(['lieid', 'diagnose', source, '--train', *train, *given])}"


def _effects(step: ModelStep) -> str:
    """Return the effects as written on the command line, as short as possible."""
    joints = [int(j) for e in step.effects for j in e.partition(":")[2].split("<") if j]
    n = max(joints, default=1)
    return ",".join(labels(parse_effects(step.effects, n), n))


def _paths(inputs: WorkbenchInputs, step: ModelStep, role: Role) -> list[str]:
    """Return the recordings of a role as ``FILE@T0:T1`` without what is excluded."""
    paths = []
    for k, recording in enumerate(inputs.recordings):
        if recording.role != role:
            continue
        file, _, stated = recording.path.rpartition("@") if "@" in recording.path else (
            recording.path, "", ":",
        )  # fmt: skip
        low, _, high = stated.partition(":")
        for start, end in kept_parts(step.excluded, k):
            first = low if start is None else f"{start:.12g}"
            last = high if end is None else f"{end:.12g}"
            paths.append(file if not first and not last else f"{file}@{first}:{last}")
    return paths
