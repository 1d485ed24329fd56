"""A worker process ends with the server, whatever it computes."""

import functools
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

SECONDS = 60.0  # that the worker computes if nothing ends it


def hold(begun):
    """Keep the lock of the interpreter, as a long call of a C library does."""
    import ctypes

    Path(begun).touch()
    ctypes.PyDLL(None).sleep(int(SECONDS))


def serve(begun):
    """Start a worker that computes; print its process."""
    from lieid_casadi.workbench.session import WorkerSetup
    from lieid_casadi.workbench.worker import Worker

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
