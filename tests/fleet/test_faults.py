"""Worker, scheduler and client are killed: no arm-night is lost, none is recorded twice."""

import os
import signal
import threading
import time

import numpy as np
import pytest
from benchmarks.fleet_faults import ClusterProcesses, killed_run, lost_or_repeated, run_client

from lieid_casadi.cli.main import main
from lieid_casadi.fleet import cluster as arm_nights
from lieid_casadi.fleet.history import History
from lieid_casadi.fleet.night_result import ArmNight, Batch, NightResult


@pytest.mark.slow
@pytest.mark.parametrize("victim", ["worker", "scheduler", "client"])
def test_a_killed_process_loses_nothing(fleet_folder, tmp_path, victim):
    cluster = ClusterProcesses(tmp_path)
    try:
        killed_run(fleet_folder, cluster, victim, delay=5.0)
    finally:
        cluster.stop()
    assert lost_or_repeated(fleet_folder, 8) == []


@pytest.mark.slow
def test_ctrl_c_keeps_what_is_finished(fleet_folder):
    client = run_client(fleet_folder, "--workers", "1")
    path = fleet_folder / "history.duckdb"
    deadline = time.monotonic() + 120.0
    while time.monotonic() < deadline and client.poll() is None:
        if path.exists() and path.stat().st_size > 0:
            time.sleep(3.0)
            client.send_signal(signal.SIGINT)
            break
        time.sleep(0.1)
    # 0: it had finished; -SIGINT: while Python exited, for which a shell reports 130 as well
    assert client.wait(120.0) in (130, 0, -signal.SIGINT)
    assert main(["fleet", str(fleet_folder / "fleet.yaml"), "-o", str(path), "--workers", "1"]) == 0
    assert lost_or_repeated(fleet_folder, 8) == []


@pytest.mark.slow
def test_an_arm_night_beyond_the_memory_of_a_worker_fails_alone(monkeypatch):
    """Nights that wait on the same worker are not given up with it."""

    def greedy(nights, fits, expected):
        if any(night.date == "2026-01-02" for night in nights):
            kept = np.ones(10**8)
            time.sleep(60.0 + kept[0])
        return Batch.of([(night, NightResult("done")) for night in nights])

    monkeypatch.setattr(arm_nights, "run_arm_nights", greedy)
    monkeypatch.setattr(arm_nights, "BATCHES_PER_THREAD", 1)  # all nights in one
    nights = [ArmNight("A1", f"2026-01-0{k}", f"{k}.csv", "", "f") for k in (1, 2, 3)]
    options, found = arm_nights.RunOptions(workers=1, memory="500MB"), {}
    with arm_nights.dask_client(options) as client:
        limits = {w["memory_limit"] for w in client.scheduler_info()["workers"].values()}
        assert limits == {500_000_000}
        trimmed = client.run(os.environ.get, "MALLOC_TRIM_THRESHOLD_")
        assert all(int(size) >= 2**20 for size in trimmed.values())  # Dask's 64 kB are slow
        arm_nights.run_on_cluster(
            client, nights, {"f": b""}, options,
            finished=lambda batch: found.update({day[-1]: rest for _, day, *rest in batch.lines}),
        )  # fmt: skip
    assert [found[day][0] for day in "123"] == ["done", "failed", "done"]
    assert "out of memory" in found["2"][1]


def run(folder, scheduler, *options):
    words = ["fleet", str(folder / "fleet.yaml"), "-o", str(folder / "history.duckdb")]
    return main([*words, "--scheduler", scheduler, "--night", "2026-01-04", *options])


def reasons(folder):
    with History(folder / "history.duckdb", read_only=True) as history:
        return history.rows("SELECT status, reason FROM runs WHERE status <> 'done'")


def test_an_exception_in_one_arm_night_fails_its_row_only(fleet_folder, scheduler, monkeypatch):
    def broken(night, content):
        if night.date == "2026-01-02":
            raise ZeroDivisionError("in a library")
        return NightResult("done", recording_sha256=f"{night.serial}{night.date}")

    monkeypatch.setattr(arm_nights, "run_arm_night", broken)
    assert run(fleet_folder, scheduler) == 0
    assert reasons(fleet_folder) == [("failed", "ZeroDivisionError: in a library")] * 2


def test_an_arm_night_that_takes_too_long_fails(fleet_folder, scheduler, monkeypatch):
    recorded, add = threading.Event(), History.add

    def slow(night, content):
        if night.date == "2026-01-02" and night.serial == "A1":
            recorded.wait(300.0)  # its worker takes the other nights after it
        return NightResult("done", recording_sha256=f"{night.serial}{night.date}")

    def noted(self, batch):
        if ("A1", "2026-01-02", "failed") in [line[:3] for line in batch.lines]:
            recorded.set()
        add(self, batch)

    monkeypatch.setattr(arm_nights, "run_arm_night", slow)
    monkeypatch.setattr(arm_nights, "CHECK_EVERY", 0.1)
    monkeypatch.setattr(History, "add", noted)
    assert run(fleet_folder, scheduler, "--timeout", "0.8") == 0
    assert recorded.is_set()
    assert ("failed", "not finished after 0.8 s (--timeout)") in reasons(fleet_folder)


def test_a_cluster_without_workers_ends_with_status_3(fleet_folder, monkeypatch, capsys):
    from distributed import LocalCluster

    monkeypatch.setattr(arm_nights, "WORKERS_WAIT", 0.3)
    monkeypatch.setattr(arm_nights, "CHECK_EVERY", 0.1)
    with LocalCluster(
        n_workers=0,
        processes=False,
        protocol="tcp",
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
    ) as cluster:
        assert run(fleet_folder, cluster.scheduler_address) == 3
    assert "has had no workers for 0.3 s" in capsys.readouterr().err
