"""Which arms have changed by a night: false alarms over the fleet, and single nights."""

import json
from bisect import bisect_left
from dataclasses import replace

import numpy as np
import pytest
from fleet.drawn_arms import drawn_fleet
from fleet.synthetic_history import write_history

from lieid_casadi.cli.main import main
from lieid_casadi.fleet import judging
from lieid_casadi.fleet.alarms import alarms_after
from lieid_casadi.fleet.arm_history import Quantity
from lieid_casadi.fleet.history import History
from lieid_casadi.fleet.judging import extreme, judge_night, outliers
from lieid_casadi.fleet.night_result import Finding

COULOMB = Quantity("coulomb.f_c", 1)


def grown(arm, size, nights, *, quantities=(COULOMB,)):
    """Return an arm whose coefficients are larger on some nights, by a size in scales."""
    series = dict(arm.series)
    for quantity in quantities:
        values = series[quantity].values.copy()
        values[nights] += size * series[quantity].scales[nights]
        series[quantity] = replace(series[quantity], values=values)
    return replace(arm, series=series)


def fleet_of(count, nights, seed):
    return drawn_fleet(np.random.default_rng(seed), count, nights, largest_slope=0.0)


def raised(arms):
    """Return the alarms of a fleet that are raised, night after night."""
    alarms, new = [], []
    for night in sorted({night for arm in arms for night in arm.dates}):
        alarms, now = alarms_after(alarms, arms, night)
        new += now
    return new


def smallest_step(arms, **options):
    """Return the smallest step of the first arm that is significant on the last night."""
    last = arms[0].dates[-1]

    def is_significant(step):
        stepped = grown(arms[0], step, slice(6, None))
        return bool(judge_night([stepped, *arms[1:]], last, **options)[0].changed)

    steps = np.arange(3.0, 12.0, 0.5)
    return steps[bisect_left(steps, True, key=is_significant)]


@pytest.fixture(scope="module")
def partly_changed():
    """A fleet in which a quarter of the arms has changed in all quantities."""
    arms = fleet_of(12, 9, seed=1)
    return [
        grown(arm, 40.0, slice(6, None), quantities=arm.series) if k in (3, 4, 5) else arm
        for k, arm in enumerate(arms)
    ]


def test_changes_of_other_arms_do_not_make_a_change_significant(partly_changed):
    """A rate of false discoveries over all quantities of the fleet would let them."""
    alone = smallest_step(fleet_of(12, 9, seed=1))
    assert alone <= smallest_step(partly_changed) < 11.5


def test_arms_with_an_open_alarm_are_no_discoveries_of_the_night(partly_changed, monkeypatch):
    monkeypatch.setattr(judging, "DISCOVERY_RATE", 1e-4)
    alarmed = {arm.serial: () for arm in partly_changed[3:6]}
    known = smallest_step(partly_changed, alarmed=alarmed)
    assert smallest_step(partly_changed) < known < 11.5
    judged = judge_night(partly_changed, partly_changed[0].dates[-1], alarmed=alarmed)
    assert [bool(each.changed) for each in judged] == [3 <= k < 6 for k in range(12)]


def test_a_change_on_a_joint_with_an_open_alarm_is_not_corrected_for_multiplicity():
    arms = fleet_of(12, 9, seed=1)
    other, known = ({arms[0].serial: {joint}} for joint in (2, 1))
    assert smallest_step(arms, alarmed=known) < smallest_step(arms, alarmed=other)


def test_a_night_that_is_unlike_the_others_raises_no_alarm():
    arms = fleet_of(6, 10, seed=3)
    odd = grown(arms[0], 30.0, [6])
    assert raised([odd, *arms[1:]]) == []
    (alarm,) = raised([grown(arms[0], 30.0, slice(6, None)), *arms[1:]])
    assert (alarm.quantity, alarm.joint, alarm.since) == ("coulomb", 1, arms[0].dates[6])
    assert alarm.raised == arms[0].dates[7]


def test_the_diagnosis_of_the_joint_confirms_a_change_of_the_last_night():
    arms = fleet_of(6, 10, seed=3)
    stepped = grown(arms[0], 30.0, slice(6, None))
    for joint, night in ((1, 6), (None, 6), (2, 7)):
        found = list(stepped.found)
        found[6] = {("coulomb", joint): Finding("coulomb", joint, 0.3, 0.01, "N·m", 0.1, "found")}
        (alarm,) = raised([replace(stepped, found=tuple(found)), *arms[1:]])
        assert alarm.raised == arms[0].dates[night]


@pytest.mark.slow
@pytest.mark.parametrize("largest_slope", [0.0, 0.8, 3.0])
def test_false_alarms_of_arms_in_which_nothing_changes(largest_slope):
    """Temperatures that vary over two weeks, on 30 % of the arms not recorded; heavy tails."""
    count, nights, fleets = 45, 25, 2
    random = np.random.default_rng(9)
    total = sum(
        len(raised(drawn_fleet(random, count, nights, largest_slope=largest_slope)))
        for _ in range(fleets)
    )
    assert total <= 1e-3 * count * nights * fleets


def test_outliers_of_normal_values_are_rare():
    random = np.random.default_rng(1)
    for count in (6, 12, 40):
        false = sum(bool(extreme(random.normal(size=count), 0.01)) for _ in range(300))
        assert false <= 0.025 * 300


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
