"""A worker process ends with the server, and yields to others with what nobody waits for."""

import asyncio
import functools
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from lieid_casadi.workbench import computation
from lieid_casadi.workbench.session import WorkbenchInputs, WorkerSetup
from lieid_casadi.workbench.worker import NICE, Worker

SECONDS = 60.0  # that the worker computes if nothing ends it


def hold(begun):
    """Keep the lock of the interpreter, as a long call of a C library does."""
    import ctypes

    Path(begun).touch()
    ctypes.PyDLL(None).sleep(int(SECONDS))


def serve(begun):
    """Start a worker that computes; print its process."""
    worker = Worker(WorkerSetup(prepare=functools.partial(hold, begun), robot=None, read=None))
    worker.start()
    os.write(1, f"{worker._process.pid}\n".encode())
    time.sleep(SECONDS)


def state(process):
    """Return the state of a process, Z also if there is none."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return "Z"


@pytest.mark.skipif(sys.platform != "linux", reason="needs Linux")
def test_a_worker_that_computes_ends_with_its_server(tmp_path):
    begun = tmp_path / "begun"
    code = f"from workbench.test_worker import serve; serve({str(begun)!r})"
    tests = str(Path(__file__).parents[1])
    path = os.pathsep.join([tests, os.environ.get("PYTHONPATH", "")])
    server = subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE, text=True, env=os.environ | {"PYTHONPATH": path},
    )  # fmt: skip
    with server:
        worker = int(server.stdout.readline())
        while not begun.exists():
            assert state(worker) != "Z"
            time.sleep(0.05)
        server.kill()
    killed = time.monotonic()
    while state(worker) != "Z":
        assert time.monotonic() - killed < 0.5 * SECONDS
        time.sleep(0.05)


class Priority:
    """In place of `Computation`: the priority of the thread that computes."""

    def __init__(self, setup, inputs):
        self.inputs = inputs

    def evaluate(self, report):
        return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())

    find = evaluate


def prepare():
    computation.Computation = Priority


@pytest.mark.skipif(sys.platform != "linux", reason="needs Linux")
def test_what_nobody_waits_for_leaves_the_processor_to_others():
    async def priorities(background):
        worker = Worker(WorkerSetup(prepare=prepare, robot=None, read=None), background=background)
        found = [await worker.request(t, WorkbenchInputs()) for t in ("evaluate", "find")]
        worker.stop()
        return found

    own = os.getpriority(os.PRIO_PROCESS, 0)
    assert asyncio.run(priorities(False)) == [own, own]
    assert asyncio.run(priorities(True)) == [min(own + NICE, 19), own]
