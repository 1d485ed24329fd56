"""A worker process: requests, progress, stopping."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import multiprocessing
import os
import signal
import threading
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import parent_process
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import TYPE_CHECKING, Any, Literal

from lieid_casadi.errors import LieidError
from lieid_casadi.workbench.recordings import WorkerSetup
from lieid_casadi.workbench.session import ModelStep, WorkbenchInputs

if TYPE_CHECKING:
    from lieid_casadi.workbench.computation import Computation
    from lieid_casadi.workbench.recordings import WorkerSetup

Task = Literal["open", "evaluate", "find", "motion", "curves", "simulate", "save"]


@dataclass(frozen=True)
class Request:
    """A task for a worker.

    Attributes
    ----------
    number : int
        Of the request; its replies have it too.
    inputs : WorkbenchInputs
        Opened first if the worker has others open.
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
        import lieid_casadi.workbench.computation  # noqa: F401 - takes a second

        setup.prepare()
    except Exception as error:  # noqa: BLE001 - reported with the first request
        return error_line(error)
    return ""


def _opened(setup: WorkerSetup, inputs: WorkbenchInputs) -> Computation:
    from lieid_casadi.workbench.computation import Computation

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
        from lieid_casadi.workbench.computation import saved_file

        return saved_file(state, request.step, report=progress, **request.options)

    def found(proposal: Any) -> None:
        pipe.send(Reply(request.number, "found", proposal))

    return state.find(request.step, report=progress, found=found)


class WorkerError(LieidError):
    """A request that failed.

    Parameters
    ----------
    failure : Failure
        Its text is one line for the page.
    """

    def __init__(self, failure: Failure) -> None:
        super().__init__(failure.text)
        self.failure = failure


class WorkerStopped(LieidError):
    """A request that was stopped by the user."""


@dataclass(frozen=True, eq=False)
class _Waiting:
    """A request without a result so far."""

    result: asyncio.Future[Any]
    progress: Callable[[str, float], None] | None
    found: Callable[[Any], None] | None


class Worker:
    """A process that computes; it is started with the first request, or by `start`."""

    def __init__(self, setup: WorkerSetup) -> None:
        self._setup = setup
        self._numbers = itertools.count()
        self._waiting: dict[int, _Waiting] = {}
        self._process: BaseProcess | None = None
        self._pipe: Connection | None = None
        self._listening = False

    @property
    def busy(self) -> bool:
        """Whether a request has no result so far."""
        return bool(self._waiting)

    def start(self) -> None:
        """Start the process if it does not run; its imports take a second or two."""
        if self._process is not None and self._process.is_alive():
            return
        context = multiprocessing.get_context("spawn")
        self._listening = False
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=run_worker, args=(theirs, self._setup), daemon=True, name="lieid workbench"
        )
        self._process.start()
        theirs.close()

    async def request(
        self,
        task: Task,
        inputs: WorkbenchInputs,
        step: ModelStep | None = None,
        *,
        progress: Callable[[str, float], None] | None = None,
        found: Callable[[Any], None] | None = None,
        **options: Any,
    ) -> Any:
        """Return the result of a task.

        Parameters
        ----------
        progress, found : callable, optional
            Called in this thread with the stage and fraction, and with what was found.
        **options
            Further arguments of the task.

        Raises
        ------
        WorkerError
            It failed; the text says why.
        WorkerStopped
            `stop` was called.
        """
        self.start()
        assert self._pipe is not None
        loop = asyncio.get_running_loop()
        number = next(self._numbers)
        waiting = _Waiting(loop.create_future(), progress, found)
        self._waiting[number] = waiting
        if not self._listening:
            self._listening = True
            listener = (loop, self._pipe, self._process)
            threading.Thread(target=self._listen, args=listener, daemon=True).start()
        self._pipe.send(Request(number, task, inputs, step, options))
        return await waiting.result

    def stop(self) -> None:
        """End the process; its requests raise `WorkerStopped`."""
        if self._process is not None:
            self._process.kill()
        self._process = None
        self._fail(WorkerStopped("stopped"))

    def _fail(self, error: LieidError) -> None:
        waiting, self._waiting = self._waiting, {}
        for each in waiting.values():
            if not each.result.done():
                each.result.set_exception(error)

    def _listen(
        self, loop: asyncio.AbstractEventLoop, pipe: Connection, process: BaseProcess | None
    ) -> None:
        """Pass replies on to the event loop until the process ends; runs in a thread."""
        with contextlib.suppress(RuntimeError):  # the event loop is closed
            while True:
                try:
                    reply: Reply = pipe.recv()
                except (EOFError, OSError):
                    loop.call_soon_threadsafe(self._lost, process)
                    return
                loop.call_soon_threadsafe(self._received, reply)

    def _received(self, reply: Reply) -> None:
        waiting = self._waiting.get(reply.number)
        if waiting is None:
            return
        if reply.kind == "progress" and waiting.progress is not None:
            waiting.progress(*reply.content)
        elif reply.kind == "found" and waiting.found is not None:
            waiting.found(reply.content)
        elif reply.kind in ("result", "error"):
            del self._waiting[reply.number]
            if waiting.result.done():
                return
            if reply.kind == "result":
                waiting.result.set_result(reply.content)
            else:
                waiting.result.set_exception(WorkerError(reply.content))

    def _lost(self, process: BaseProcess | None) -> None:
        if self._process is process and self._waiting:
            self._process = None
            text = "the computing process ended unexpectedly (memory?); try again"
            self._fail(WorkerError(Failure(text, "model")))
