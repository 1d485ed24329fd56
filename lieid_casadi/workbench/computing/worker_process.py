"""The loop of a worker process: one request at a time, progress and results through a pipe."""

from __future__ import annotations

import logging
import os
import signal
import threading
import warnings
from dataclasses import dataclass
from multiprocessing import parent_process
from multiprocessing.connection import Connection, wait
from typing import TYPE_CHECKING, Any, Literal

from lieid_casadi.workbench.state.inputs import WorkbenchInputs
from lieid_casadi.workbench.state.session import ModelStep

if TYPE_CHECKING:
    from lieid_casadi.workbench.computing.computation import Computation
    from lieid_casadi.workbench.computing.results import WorkerSetup

Task = Literal["open", "evaluate", "find", "motion", "curves", "simulate", "save"]


@dataclass(frozen=True)
class Request:
    """A task for a worker.

    Attributes
    ----------
    number : int
        Of the request; its replies have it too.
    task : str
    inputs : WorkbenchInputs
        Opened first if the worker has others open.
    step : ModelStep or None
    options : dict
        Further arguments of the task.
    """

    number: int
    task: Task
    inputs: WorkbenchInputs
    step: ModelStep | None
    options: dict[str, Any]


@dataclass(frozen=True)
class Failure:
    """Why a request failed, in one line, and what it is about: ``recordings`` or ``model``."""

    text: str
    about: str


@dataclass(frozen=True)
class Reply:
    """Progress, a result, or an error.

    ``content`` of ``progress`` is a stage and a fraction, of ``found`` an effect, of ``error`` a
    `Failure`.
    """

    number: int
    kind: Literal["progress", "found", "result", "error"]
    content: Any


def run_worker(pipe: Connection, setup: WorkerSetup) -> None:
    """Answer requests until the pipe is closed or the parent process ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    warnings.simplefilter("ignore")  # those of results are on the page
    logging.getLogger("lieid_casadi").addHandler(logging.NullHandler())
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # stdout has the URL and nothing else
    threading.Thread(target=_end_with_parent, daemon=True).start()
    setup_error = _prepared(setup)
    state: Computation | None = None
    while True:
        try:
            request = pipe.recv()
        except (EOFError, OSError):
            return
        if setup_error:
            pipe.send(Reply(request.number, "error", Failure(setup_error, "model")))
            continue
        try:
            if state is None or state.inputs != request.inputs:
                state = None  # its memory is free before the next inputs are read
                state = _opened(setup, request.inputs)
            pipe.send(Reply(request.number, "result", _answer(state, request, pipe)))
        except Exception as error:  # noqa: BLE001 - the outermost frame of this process
            pipe.send(Reply(request.number, "error", _failure(error)))


def _failure(error: BaseException) -> Failure:
    from lieid_casadi.errors import RecordingError

    about = "recordings" if isinstance(error, RecordingError) else "model"
    return Failure(error_line(error), about)


def error_line(error: BaseException) -> str:
    """Return an error as one line."""
    from lieid_casadi.errors import LieidError

    text = " ".join(str(error).split())
    if isinstance(error, LieidError):
        return text
    if isinstance(error, OSError):
        place = "" if error.filename is None else f"{error.filename}: "
        return f"{place}{error.strerror or text}"
    return f"internal error: {type(error).__name__}: {text}"


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(0)


def _prepared(setup: WorkerSetup) -> str:
    """Run the preparation, and import what the first request needs; return an error."""
    try:
        import lieid_casadi.workbench.computing.computation  # noqa: F401 - takes a second

        setup.prepare()
    except Exception as error:  # noqa: BLE001 - reported with the first request
        return error_line(error)
    return ""


def _opened(setup: WorkerSetup, inputs: WorkbenchInputs) -> Computation:
    from lieid_casadi.workbench.computing.computation import Computation

    return Computation(setup, inputs)


def _answer(state: Computation, request: Request, pipe: Connection) -> Any:
    """Return the result of one request."""

    def progress(stage: str, fraction: float) -> None:
        pipe.send(Reply(request.number, "progress", (stage, fraction)))

    if request.task == "open":
        return state.opened()
    if request.task == "motion":
        return state.motion(**request.options)
    assert request.step is not None
    if request.task == "evaluate":
        return state.evaluate(request.step, report=progress, **request.options)
    if request.task == "curves":
        return state.curves(request.step, report=progress, **request.options)
    if request.task == "simulate":
        return state.simulate(request.step, report=progress)
    if request.task == "save":
        from lieid_casadi.workbench.computing.saved_files import saved_file

        return saved_file(state, request.step, report=progress, **request.options)

    def found(proposal: Any) -> None:
        pipe.send(Reply(request.number, "found", proposal))

    return state.find(request.step, report=progress, found=found)
