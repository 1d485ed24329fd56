"""A worker process ends with the server, and yields to others with what nobody waits for."""

import asyncio
import functools
import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import pytest

from lieid_casadi.workbench import computation
from lieid_casadi.workbench.session import Session, WorkbenchInputs, WorkerSetup
from lieid_casadi.workbench.workbench import Workbench
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


class Export:
    """In place of `Computation`: exports, the first kind without end."""

    def __init__(self, setup, inputs):
        self.inputs = inputs

    def save(self, step, kind, report):
        if kind == "urdf":
            return "arm_urdf.zip", b"zip"
        half = Path(tempfile.mkdtemp(prefix="lieid-")) / "controller.c"
        half.write_text("int main(")
        report(str(half), 0.8)
        time.sleep(SECONDS)
        return None


def prepare_export():
    computation.Computation = Export


def test_an_export_that_is_stopped_leaves_no_files(tmp_path, monkeypatch):
    """No traceback, nothing to save, and the next export is answered by another process."""
    monkeypatch.setenv("LIEID_WORKBENCH_DIR", str(tmp_path / "sessions"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    failures = []

    async def run():
        asyncio.get_running_loop().set_exception_handler(lambda _, f: failures.append(f))
        workbench = Workbench("0" * 16, WorkerSetup(prepare_export, robot=None, read=None))
        workbench.session = Session().opened(WorkbenchInputs(), ["coulomb:1"])
        saved = asyncio.create_task(workbench.save("c"))
        while workbench.saving is None or workbench.saving.fraction == 0.0:
            await asyncio.sleep(0.02)
        half = Path(workbench.saving.stage)
        assert half.is_file()
        assert tmp_path in half.parents
        workbench.stop()
        assert await saved is None
        assert (workbench.saving, workbench.error, list(tmp_path.rglob("*"))) == (None, "", [])
        assert await workbench.save("urdf") == ("arm_urdf.zip", b"zip")
        workbench.close()

    asyncio.run(run())
    assert failures == []
    assert [f for f in tmp_path.rglob("*") if f.is_file()] == []


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
