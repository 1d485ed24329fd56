"""A worker process as an asynchronous object: requests, progress, stopping."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import multiprocessing
import threading
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from lieid_casadi.errors import LieidError
from lieid_casadi.workbench.computing.results import WorkerSetup
from lieid_casadi.workbench.computing.worker_process import (
    Failure,
    Reply,
    Request,
    Task,
    run_worker,
)
from lieid_casadi.workbench.state.inputs import WorkbenchInputs
from lieid_casadi.workbench.state.session import ModelStep


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
    """A process that computes; it is started with the first request, or by `start`.

    Parameters
    ----------
    setup : WorkerSetup
    """

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
        task : str
        inputs : WorkbenchInputs
        step : ModelStep, optional
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
