"""``lieid fleet``: every recording is run once; failures, also of processes, are rows."""

import os
import shutil
import signal
import threading
import time

import numpy as np
import pytest
from benchmarks.fleet_faults import ClusterProcesses, killed_run, lost_or_repeated, run_client
from fleet.simulated_fleet import healthy_arm, recorded, tcp_cluster

from lieid_casadi.cli.main import main
from lieid_casadi.fleet import cluster as arm_nights
from lieid_casadi.fleet.history import History
from lieid_casadi.fleet.night_result import ArmNight, Batch, NightResult


def run(folder, scheduler, *options):
    words = ["fleet", str(folder / "fleet.yaml"), "-o", str(folder / "history.duckdb")]
    return main([*words, "--scheduler", scheduler, "--night", "2026-01-04", *options])


def rows(folder, query):
    with History(folder / "history.duckdb", read_only=True) as history:
        return history.rows(query)


@pytest.fixture(scope="module")
def after_a_run(two_arms, scheduler, tmp_path_factory):
    """Folder of the fleet with the history of all its nights; not to be changed."""
    folder = shutil.copytree(two_arms, tmp_path_factory.mktemp("run") / "fleet")
    assert run(folder, scheduler) == 0
    return folder


def test_every_recording_is_run_once_and_again_only_when_it_changes(
    fleet_folder, scheduler, capsys, sha_of
):
    assert run(fleet_folder, scheduler, "--since", "2026-01-04") == 0
    shown = capsys.readouterr().out
    assert "2 done; 0 were in the history" in shown
    assert run(fleet_folder, scheduler) == 0
    assert "6 done; 2 were in the history" in capsys.readouterr().out
    found = rows(
        fleet_folder,
        "SELECT serial, date, status, reason, recording_sha256, fit_sha256 FROM runs ORDER BY 1, 2",
    )
    assert len(found) == 8
    serial, date, status, reason, recording, fit = found[0]
    assert (serial, str(date), status, reason) == ("A1", "2026-01-01", "done", "")
    assert recording == sha_of(fleet_folder / "nights/A1/2026-01-01.csv")
    assert fit == sha_of(fleet_folder / "fits/A1.json")
    night = fleet_folder / "nights/A1"
    shutil.copy(night / "2026-01-02.csv", night / "2026-01-09.csv")  # the same content
    changed = recorded("two_link", healthy_arm("two_link", 1), motion_seed=7, seed=7, duration=15.0)
    changed.save(night / "2026-01-03.csv")
    assert run(fleet_folder, scheduler) == 0
    assert "1 done, 1 repeated; 7 were in the history" in capsys.readouterr().out
    assert run(fleet_folder, scheduler) == 0
    assert "none; 9 were in the history" in capsys.readouterr().out
    assert rows(fleet_folder, "SELECT count(*) FROM runs") == [(9,)]


def test_parameters_and_errors_of_a_night(after_a_run):
    arm = healthy_arm("two_link", 1)
    found = rows(
        after_a_run,
        "SELECT name, joint, avg(value), avg(std), any_value(unit) FROM parameters "
        "WHERE serial = 'A1' GROUP BY ALL ORDER BY 1, 2",
    )
    assert [(name, joint) for name, joint, *_ in found] == [
        (f"{effect}", joint)
        for effect in ("coulomb.f_c", "offset.f_b", "viscous.f_v")
        for joint in (1, 2)
    ]
    for k, (name, joint, value, std, unit) in enumerate(found):
        truth = getattr(arm.friction, name.partition(".")[0])[joint - 1]
        assert abs(value - truth) < 4.0 * std, found[k]
        assert unit == ("N·m·s/rad" if name == "viscous.f_v" else "N·m")
    errors = rows(after_a_run, "SELECT rms_moving / expected FROM errors")
    assert len(errors) == 16
    assert all(0.7 < ratio < 1.5 for (ratio,) in errors)


def test_failures_are_rows_with_their_reasons(after_a_run, tmp_path, scheduler, capsys):
    fleet_folder = shutil.copytree(after_a_run, tmp_path / "fleet")
    nights = fleet_folder / "nights/A1"
    for k, content in enumerate([b"", b"t,q1\n1,2\nx,y\n", b"\x00\x01\x02" * 999], start=5):
        (nights / f"2026-01-0{k}.csv").write_bytes(content)
    (nights / "undated.csv").write_bytes(b"")
    text = (fleet_folder / "fleet.yaml").read_text("utf-8")
    text = text.replace(
        "nights/A2/*.csv", '[nights/A2/*.csv, "http://127.0.0.1:9/A2/2026-01-05.csv"]'
    )
    (fleet_folder / "fleet.yaml").write_text(text, encoding="utf-8")
    assert run(fleet_folder, scheduler) == 0
    shown = capsys.readouterr().out
    assert "2 failed, 3 refused, 8 repeated" in shown
    assert f"\n  A1: {nights / '2026-01-06.csv'}: " in shown
    found = rows(
        fleet_folder,
        "SELECT serial, status, reason FROM runs WHERE status <> 'done' ORDER BY 1, 2, recording",
    )
    reasons = [
        ("A1", "failed", "does not match this path"),
        ("A1", "refused", "2026-01-05.csv"),
        ("A1", "refused", "2026-01-06.csv"),
        ("A1", "refused", "2026-01-07.csv"),
        ("A2", "failed", "http://127.0.0.1:9/A2/2026-01-05.csv"),
    ]
    for (serial, status, reason), expected in zip(found, reasons, strict=True):
        assert (serial, status) == expected[:2]
        assert expected[2] in reason
        assert "\n" not in reason
    assert run(fleet_folder, scheduler) == 0  # refused recordings are not run again, failed are
    assert "2 failed; 11 were in the history" in capsys.readouterr().out


def test_a_fit_that_cannot_be_used_fails_its_arm_only(fleet_folder, scheduler, capsys):
    (fleet_folder / "fits/A1.json").write_text("{", encoding="utf-8")
    assert run(fleet_folder, scheduler, "--since", "2026-01-04") == 0
    assert "1 done, 1 failed" in capsys.readouterr().out
    ((serial, reason),) = rows(
        fleet_folder, "SELECT serial, reason FROM runs WHERE status = 'failed'"
    )
    assert serial == "A1"
    assert "A1.json" in reason
    (fleet_folder / "fits/A2.json").unlink()
    assert run(fleet_folder, scheduler) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["{}/none.yaml", "-o", "{}/h"], "no such file"),
        (["{}/fleet.yaml"], "no history"),
        (["{}/fleet.yaml", "-o", "{}/h", "--scheduler", "nonsense"], "no Dask scheduler"),
        (["{}/no_fits.yaml", "-o", "{}/h"], "A9.json: no such file"),
        (["{}/fleet.yaml", "-o", "{}/fits/A1.json"], "not a history"),
    ],
)
def test_bad_usage_is_one_line_with_status_2(fleet_folder, capsys, words, message):
    no_fits = (fleet_folder / "fleet.yaml").read_text("utf-8").replace("fits/A1", "fits/A9")
    (fleet_folder / "no_fits.yaml").write_text(no_fits.replace("fits/A2", "fits/A9"), "utf-8")
    assert main(["fleet", *(word.format(fleet_folder) for word in words)]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (fleet_folder / "h").exists()


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
    monkeypatch.setattr(arm_nights, "WORKERS_WAIT", 0.3)
    monkeypatch.setattr(arm_nights, "CHECK_EVERY", 0.1)
    with tcp_cluster(0) as cluster:
        assert run(fleet_folder, cluster.scheduler_address) == 3
    assert "has had no workers for 0.3 s" in capsys.readouterr().err
