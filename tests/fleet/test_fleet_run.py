"""``lieid fleet``: every recording is run once, and every failure is a row with its reason."""

import shutil

import pytest
from fleet.simulated_fleet import healthy_arm, recorded

from lieid_casadi.cli.main import main
from lieid_casadi.fleet.history import History


def run(folder, scheduler, *options):
    words = ["fleet", str(folder / "fleet.yaml"), "-o", str(folder / "history.duckdb")]
    return main([*words, "--scheduler", scheduler, "--night", "2026-01-04", *options])


def rows(folder, query):
    with History(folder / "history.duckdb", read_only=True) as history:
        return history.rows(query)


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


def test_parameters_and_errors_of_a_night(fleet_folder, scheduler):
    run(fleet_folder, scheduler)
    arm = healthy_arm("two_link", 1)
    found = rows(
        fleet_folder,
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
    errors = rows(fleet_folder, "SELECT rms_moving / expected FROM errors")
    assert len(errors) == 16
    assert all(0.7 < ratio < 1.5 for (ratio,) in errors)


def test_failures_are_rows_with_their_reasons(fleet_folder, scheduler, capsys):
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
    assert "8 done, 2 failed, 3 refused" in shown
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
