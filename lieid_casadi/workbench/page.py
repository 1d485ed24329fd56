"""The page: its views, their layout, and what happens when the session changes."""

from __future__ import annotations

from collections.abc import Callable
from importlib import resources

from nicegui import ui

from lieid_casadi.workbench.views.arm_view import ArmView
from lieid_casadi.workbench.views.effects import EffectsView, ProposalsView
from lieid_casadi.workbench.views.elements import named
from lieid_casadi.workbench.views.history import HistoryView
from lieid_casadi.workbench.views.joints import JointsView
from lieid_casadi.workbench.views.open_panel import OpenPanel
from lieid_casadi.workbench.views.residual_plot import ResidualPlot
from lieid_casadi.workbench.views.toolbar import Toolbar
from lieid_casadi.workbench.views.torque_plot import TorquePlot
from lieid_casadi.workbench.views.waterfall import WaterfallView
from lieid_casadi.workbench.workbench import Workbench


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
