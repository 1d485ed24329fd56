"""A running experiment as a local page: its rounds, and the next motion on the arm.

The experiment runs in the process of the command, the page in another one. What the command sends
through a pipe replaces attributes of `ExperimentState`; the user's answer is sent back as one word.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path

from fastapi import Response
from nicegui import app, ui

from lieid_casadi.errors import LieidError
from lieid_casadi.experiments import Experiment
from lieid_casadi.experiments.folder import STATE, ExperimentFolder
from lieid_casadi.report import data_uri
from lieid_casadi.tables import html
from lieid_casadi.workbench.arm import ArmMesh, ArmMotion
from lieid_casadi.workbench.arm_view import BASE, ArmScene
from lieid_casadi.workbench.elements import (
    button,
    named,
    open_page,
    ratio,
    ratio_colour,
    set_text,
    text,
)
from lieid_casadi.workbench.server import mesh_file, serve_pages

REFRESH = 0.3  # s between looks at what is new
PAUSE_NOTE = "before the next motion; Ctrl-C in the terminal interrupts the one that runs"


@dataclass
class ExperimentState:
    """What the page shows beside the rounds, which are in the folder.

    ``unattended`` motions are run without a question unless the user pauses; ``motion`` is the next
    one or the one that runs, ``sentences`` describe it, and while ``asks`` it waits for an answer.
    """

    robot: str
    folder: Path
    meshes: tuple[ArmMesh, ...]
    unattended: bool
    stage: str = ""
    fraction: float = 0.0
    begun: bool = False
    paused: bool = False
    asks: bool = False
    sentences: tuple[str, ...] = ()
    motion: ArmMotion | None = None
    ended: str = ""


def serve_experiment(pipe: Connection, port: int, state: ExperimentState) -> None:
    """Serve the page; send its URL or an error first, then the answers of the user."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # stdout is the command's

    def received() -> None:
        with suppress(EOFError, OSError):  # the command has ended
            while True:
                vars(state).update(pipe.recv())
        os._exit(0)

    # not as a reader of the event loop, which reads without waiting: a large message comes in parts
    threading.Thread(target=received, daemon=True).start()

    def pages(token: str) -> None:
        @ui.page("/", title="lieid experiment")
        def index() -> None:
            ExperimentView(state, pipe.send)

        @app.get("/mesh/{number}.stl")
        def mesh(number: int) -> Response:
            return mesh_file(state.meshes, number)

    try:
        serve_pages(pages, port, ready=pipe.send, close=lambda: None)
    except LieidError as error:
        pipe.send(error)


class ExperimentView:
    """The page of one tab; ``answer`` sends a word to the experiment."""

    def __init__(self, state: ExperimentState, answer: Callable[[str], None]) -> None:
        self._state, self._answer = state, answer
        self._drawn: float | None = None
        open_page()
        with ui.row().classes("toolbar w-full items-center no-wrap"):
            ui.label("lieid experiment").classes("brand")
            text(f"{state.robot}, {state.folder}", "muted grow ellipsis")
            with ui.column().classes("gap-0 progress"):
                self._stage = text("", "small muted ellipsis w-full", "progress")
                self._bar = ui.linear_progress(show_value=False, size="6px")
            self._start = self._button("Start", "start-experiment", "start")
            self._pause = button("Pause", "pause-experiment", self._toggle, "outline")
            self._pause.props["title"] = PAUSE_NOTE
            self._close = self._button("Close", "close-experiment", "close")
        self._end = named(ui.label(""), "experiment-end").classes("verdict verdict-panel w-full")
        with ui.element("div").classes("top-row experiment"):
            with ui.column().classes("panel w-full"):
                self._title = ui.label("").classes("panel-title")
                self._text = named(ui.label(""), "next-motion").classes("verdict")
                with ui.row() as self._question:
                    self._button("Run it on the robot", "run-motion", "run")
                    button(
                        "End the experiment", "end-experiment", partial(answer, "end"), "outline"
                    )
                self._arm = ArmScene()
            with ui.column().classes("panel w-full"):
                ui.label("Rounds").classes("panel-title")
                self._rounds = named(ui.html("", sanitize=False), "rounds").classes("difference")
                self._picture = ui.image().props('alt="errors over the rounds"').classes("w-full")
        self._arm.build(state.meshes, "/mesh")
        ui.timer(REFRESH, self._update)

    def _button(self, label: str, test_id: str, word: str) -> ui.button:
        return button(label, test_id, partial(self._answer, word), "unelevated color=primary")

    def _toggle(self) -> None:
        """Pause before the next motion, or go on."""
        self._state.paused = not self._state.paused
        self._answer("pause" if self._state.paused else "continue")

    def _update(self) -> None:
        """Show what is new."""
        state = self._state
        set_text(self._stage, state.stage)
        self._bar.value = state.fraction
        self._bar.set_visibility(not state.ended)
        self._start.set_visibility(not (state.begun or state.ended))
        self._pause.set_visibility(state.unattended and state.begun and not state.ended)
        self._pause.text = "Continue" if state.paused else "Pause"
        self._close.set_visibility(bool(state.ended))
        self._end.text = state.ended
        self._end.set_visibility(bool(state.ended))
        self._question.set_visibility(state.asks)
        self._title.text = "Next motion" if state.asks or state.motion is None else "Last motion"
        self._text.text = "\n".join(state.sentences) or "No motion is planned so far."
        if state.motion is not None:
            self._arm.limit(float(state.motion.times[0]), float(state.motion.times[-1]))
            self._arm.show_motion(state.motion)
            self._arm.play(state.asks)
        file = state.folder / STATE
        changed = file.stat().st_mtime if file.is_file() else None
        if changed != self._drawn:
            self._drawn = changed
            self._draw()

    def _draw(self) -> None:
        """Show the rounds of the folder, and colour the arm by the errors of the last one."""
        state = self._state
        rounds = ExperimentFolder(state.folder, {}).rounds()
        result = Experiment(state.robot, rounds, folder=state.folder)
        last = rounds[-1].sentences if rounds else ()
        self._rounds.set_content(html(*last, result.table()))
        diagnosed = tuple(each for each in rounds if each.error)
        if diagnosed:
            multiples = map(ratio, diagnosed[-1].error, diagnosed[-1].noise_floor)
            self._arm.colour([BASE, *map(ratio_colour, multiples)], None)
            self._picture.set_source(data_uri(replace(result, rounds=diagnosed).plot()))
