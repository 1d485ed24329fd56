"""Processes of a fleet's run, to be killed at random moments, and what must be true afterwards."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil

from lieid_casadi.fleet.history import History

PATIENCE = 900.0  # s


class ClusterProcesses:
    """A Dask scheduler and a worker with its nanny as processes of this machine."""

    def __init__(self, folder: Path) -> None:
        self.file = folder / "scheduler.json"
        self.scheduler: subprocess.Popen[bytes] | None = None
        self.worker: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start what is not running."""
        if self.scheduler is None or self.scheduler.poll() is not None:
            if self.worker is not None:
                self.worker.kill()
                self.worker.wait()
            self.file.unlink(missing_ok=True)
            self.scheduler = _process(
                "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0",
                "--no-dashboard", "--scheduler-file", str(self.file),
            )  # fmt: skip
            _wait(self._is_written)
        if self.worker is None or self.worker.poll() is not None:
            self.worker = _process(
                "distributed.cli.dask_worker", "--scheduler-file", str(self.file),
                "--nthreads", "1", "--nworkers", "1", "--no-dashboard",
            )  # fmt: skip

    def _is_written(self) -> bool:
        """Whether the scheduler has written its file; it does so in place."""
        with contextlib.suppress(OSError, ValueError):
            return bool(self.address)
        return False

    @property
    def address(self) -> str:
        """Of the scheduler."""
        return str(json.loads(self.file.read_text("utf-8"))["address"])

    def wait_for_worker(self) -> None:
        """Wait until the worker has begun: a nanny does not replace one that dies before."""
        from distributed import Client

        with Client(self.address) as client:
            client.wait_for_workers(1, timeout=PATIENCE)

    def kill_worker(self) -> None:
        """Kill the process that computes; its nanny starts another one."""
        children = psutil.Process(self.worker.pid).children()
        for child in children:
            with contextlib.suppress(psutil.NoSuchProcess):
                if "spawn_main" in " ".join(child.cmdline()):
                    child.kill()

    def kill_scheduler(self) -> None:
        """Kill the scheduler; the next start replaces it."""
        self.scheduler.kill()
        self.scheduler.wait()

    def stop(self) -> None:
        """End both."""
        for process in (self.worker, self.scheduler):
            if process is not None:
                with contextlib.suppress(psutil.NoSuchProcess):
                    for child in psutil.Process(process.pid).children(recursive=True):
                        child.kill()
                process.kill()
                process.wait()


def run_client(folder: Path, *options: str) -> subprocess.Popen[bytes]:
    """Start ``lieid fleet`` on the fleet of a folder."""
    return _process(
        "lieid_casadi.cli.main", "fleet", str(folder / "fleet.yaml"),
        "-o", str(folder / "history.duckdb"), *options,
    )  # fmt: skip


def killed_run(folder: Path, cluster: ClusterProcesses, victim: str, delay: float) -> None:
    """Run the fleet, kill one of the processes after a delay, and run it again until it is done.

    ``victim`` is ``worker``, ``scheduler`` or ``client``.
    """
    cluster.start()
    cluster.wait_for_worker()
    client = run_client(folder, "--scheduler", cluster.address)
    time.sleep(delay)
    if victim == "client":
        client.send_signal(signal.SIGKILL)
    elif victim == "scheduler":
        cluster.kill_scheduler()
    else:
        cluster.kill_worker()
    client.wait(PATIENCE)
    while client.returncode != 0:
        cluster.start()
        client = run_client(folder, "--scheduler", cluster.address)
        client.wait(PATIENCE)


def lost_or_repeated(folder: Path, nights: int) -> list[str]:
    """Return what is wrong with the history of a run of so many arm-nights."""
    wrong = []
    with History(folder / "history.duckdb", read_only=True) as history:
        done = history.rows("SELECT serial, date FROM runs WHERE status = 'done'")
        if len(done) != nights or len(set(done)) != nights:
            wrong.append(f"{len(done)} runs, {len(set(done))} different; expected {nights}")
        for table, key in (("parameters", "(name, joint)"), ("errors", "joint")):
            counts = history.rows(
                f"SELECT DISTINCT count(joint), count(DISTINCT {key}) FROM runs "
                f"LEFT JOIN {table} USING (run_id) WHERE status = 'done' GROUP BY run_id"
            )
            if not counts or any(rows != different or not rows for rows, different in counts):
                wrong.append(f"{table}: rows per run {counts}")
        failed = history.rows("SELECT reason FROM runs WHERE status <> 'done'")
        wrong += [f"failed: {reason}" for (reason,) in failed]
    return wrong


def _process(module: str, *words: str) -> subprocess.Popen[bytes]:
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    root = str(Path(__file__).parents[2])
    environment["PYTHONPATH"] = os.pathsep.join([root, environment.get("PYTHONPATH", "")])
    return subprocess.Popen(
        [sys.executable, "-m", module, *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=environment,
    )


def _wait(condition) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)
