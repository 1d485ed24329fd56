"""A worker process: one request at a time; progress, results and errors through a pipe."""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import itertools
import logging
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import parent_process
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Literal

from lieid_casadi.errors import LieidError
from lieid_casadi.workbench.session import Progress, WorkbenchInputs, WorkerSetup

Task = Literal["opened", "premises", "evaluate", "find", "adopt", "motion", "curves", "save"]
UNHURRIED = ("evaluate", "curves")  # tasks that nobody waits for, if a background worker has them
NICE = 10  # of the threads that do them
PR_SET_PDEATHSIG = 1  # of Linux's prctl: the signal that a process gets when its parent ends


@dataclass(frozen=True)
class _Request:
    """A task: a method of `Computation` with its arguments; other inputs are opened first."""

    number: int
    task: Task
    inputs: WorkbenchInputs
    arguments: dict[str, Any]
    unhurried: bool


@dataclass(frozen=True)
class _Reply:
    """Progress (a stage and a fraction), a result, or an error in one line."""

    number: int
    kind: Literal["progress", "result", "error"]
    content: Any


class WorkerError(LieidError):
    """A request that failed; its text is one line for the page."""


class WorkerStopped(LieidError):
    """A request that was stopped by the user."""


class Worker:
    """A process that computes; it is started with the first request, or by `start`."""

    def __init__(self, setup: WorkerSetup, *, background: bool = False) -> None:
        self._setup, self._background = setup, background
        self._numbers = itertools.count()
        #: Requests without a result so far, and what is called with their progress.
        self._waiting: dict[int, tuple[asyncio.Future[Any], Progress | None]] = {}
        self._process: BaseProcess | None = None
        self._pipe: Connection | None = None
        self._listening = False
        self._folder: tempfile.TemporaryDirectory[str] | None = None

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
        self._folder = tempfile.TemporaryDirectory(prefix="lieid-", ignore_cleanup_errors=True)
        self._process = context.Process(
            target=_run, args=(theirs, self._setup, self._folder.name), daemon=True,
            name="lieid workbench",
        )  # fmt: skip
        self._process.start()
        theirs.close()

    async def request(
        self,
        task: Task,
        inputs: WorkbenchInputs,
        *,
        progress: Progress | None = None,
        **arguments: Any,
    ) -> Any:
        """Return the result of a task; raises `WorkerError` or `WorkerStopped`."""
        self.start()
        assert self._pipe is not None
        loop = asyncio.get_running_loop()
        number = next(self._numbers)
        result = loop.create_future()
        self._waiting[number] = result, progress
        if not self._listening:
            self._listening = True
            listener = (loop, self._pipe, self._process)
            threading.Thread(target=self._listen, args=listener, daemon=True).start()
        unhurried = self._background and task in UNHURRIED
        self._pipe.send(_Request(number, task, inputs, arguments, unhurried))
        return await result

    def stop(self) -> None:
        """End the process, and delete its files; its requests raise `WorkerStopped`."""
        if self._process is not None and self._folder is not None:
            self._process.kill()
            self._process.join(0.5)  # its memory takes a moment
            self._folder.cleanup()
        self._process = None
        self._fail(WorkerStopped("stopped"))

    def _fail(self, error: LieidError) -> None:
        waiting, self._waiting = self._waiting, {}
        for result, _ in waiting.values():
            if not result.done():
                result.set_exception(error)

    def _listen(
        self, loop: asyncio.AbstractEventLoop, pipe: Connection, process: BaseProcess | None
    ) -> None:
        """Pass replies on to the event loop until the process ends; runs in a thread."""
        with contextlib.suppress(RuntimeError):  # the event loop is closed
            while True:
                try:
                    reply: _Reply = pipe.recv()
                except (EOFError, OSError):
                    loop.call_soon_threadsafe(self._lost, process)
                    return
                loop.call_soon_threadsafe(self._received, reply)

    def _received(self, reply: _Reply) -> None:
        result, progress = self._waiting.get(reply.number, (None, None))
        if result is None:
            return
        if reply.kind == "progress":
            if progress is not None:
                progress(*reply.content)
            return
        del self._waiting[reply.number]
        if result.done():
            return
        if reply.kind == "result":
            result.set_result(reply.content)
        else:
            result.set_exception(WorkerError(reply.content))

    def _lost(self, process: BaseProcess | None) -> None:
        if self._process is process and self._waiting:
            self._process = None
            text = "the computing process ended unexpectedly (memory?); try again"
            self._fail(WorkerError(text))


def _run(pipe: Connection, setup: WorkerSetup, folder: str) -> None:
    """Answer requests until the pipe is closed or the parent process ends.

    Temporary files are in ``folder``, which whoever ends this process at any time deletes.
    """
    tempfile.tempdir = folder
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    warnings.simplefilter("ignore")  # those of results are on the page
    logging.getLogger("lieid_casadi").addHandler(logging.NullHandler())
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # stdout has the URL and nothing else
    with contextlib.suppress(
        OSError, AttributeError
    ):  # Linux: even while it computes without Python
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    failure, state = _prepared(setup), None
    with contextlib.suppress(EOFError, OSError):  # the page has gone
        while True:
            request: _Request = pipe.recv()
            reply = failure and _Reply(request.number, "error", failure)
            try:
                if reply is None and (state is None or state.inputs != request.inputs):
                    from lieid_casadi.workbench.computation import Computation

                    state = None  # its memory is free before the next inputs are read
                    state = Computation(setup, request.inputs)
                reply = reply or _Reply(request.number, "result", _answer(state, request, pipe))
            except Exception as error:  # noqa: BLE001 - the outermost frame of this process
                reply = _Reply(request.number, "error", _failure(error))
            pipe.send(reply)


def _prepared(setup: WorkerSetup) -> str | None:
    """Run the preparation, and import what the first request needs; return an error."""
    try:
        import lieid_casadi.workbench.computation  # noqa: F401 - takes a second

        setup.prepare()
    except Exception as error:  # noqa: BLE001 - reported with every request
        return _failure(error)
    return None


def _answer(state: Any, request: _Request, pipe: Connection) -> Any:
    """Return the result of one request; what reports progress can do so."""

    def report(stage: str, fraction: float) -> None:
        pipe.send(_Reply(request.number, "progress", (stage, fraction)))

    reports = {} if request.task in ("opened", "adopt", "motion") else {"report": report}
    task = partial(getattr(state, request.task), **request.arguments, **reports)
    if not request.unhurried:
        return task()
    with ThreadPoolExecutor(1, initializer=_low_priority) as pool:
        return pool.submit(task).result()


def _low_priority() -> None:
    """Lower the priority of this thread, and of those that it starts, where threads have one."""
    if sys.platform == "linux":
        os.nice(NICE)  # there, of the calling thread


def _failure(error: BaseException) -> str:
    """Return an error as one line."""
    text = " ".join(str(error).split())
    if isinstance(error, OSError):
        place = "" if error.filename is None else f"{error.filename}: "
        text = f"{place}{error.strerror or text}"
    elif not isinstance(error, LieidError):
        text = f"internal error: {type(error).__name__}: {text}"
    return text


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(0)
