"""Arms of one kind compared with each other."""

import json

import numpy as np
from fleet.synthetic_history import write_history

from lieid_casadi.cli.main import main
from lieid_casadi.fleet.history import History
from lieid_casadi.fleet.sisters import extreme, outliers


def test_outliers_of_normal_values_are_rare():
    random = np.random.default_rng(1)
    for count in (6, 12, 40):
        false = sum(bool(extreme(random.normal(size=count), 0.01)) for _ in range(2000))
        assert false <= 0.02 * 2000


def test_two_outliers_do_not_hide_each_other():
    values = np.random.default_rng(2).normal(size=20)
    values[3], values[7] = 12.0, 13.0
    assert sorted(extreme(values, 1e-4)) == [3, 7]
    assert extreme(np.zeros(9), 1e-3) == []
    assert extreme(np.array([0.0, 0.0, 0.0, 0.0, 50.0]), 1e-3) == []


def test_an_arm_unlike_its_sisters_is_found_on_its_first_night(tmp_path, capsys):
    arms = [f"A{k}" for k in range(8)]
    grown = {"grown": {("viscous.f_v", 2): 0.5}}
    path = write_history(tmp_path / "h.duckdb", 1, arms, lambda s, k: grown if s == "A5" else {})
    with History(path, read_only=True) as history:
        (found,) = outliers(history)
        ((robot, count, median),) = history.rows(
            "SELECT robot, arms, median FROM sisters WHERE name = 'viscous.f_v' AND joint = 2"
        )
    assert (found.serial, found.name, found.joint, found.arms) == ("A5", "viscous.f_v", 2, 8)
    assert (robot, count) == ("robot", 8)
    assert found.median == median
    assert abs(found.median - 2.0) < 0.02
    out = tmp_path / "report.json"
    assert main(["fleet", "report", str(path), "--json", str(out)]) == 0
    assert [x["serial"] for x in json.loads(out.read_text("utf-8"))["outliers"]] == ["A5"]
    assert "Arms unlike the others of their kind" in capsys.readouterr().out
