"""Which arms have changed by a night, and the statistics over nights that this rests on."""

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
from lieid_casadi.fleet.changes import (
    NightSeries,
    ScatterPrior,
    repeated_finding,
    scatter_prior,
    strongest_change,
    temperature_prior,
)
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


PRIOR = ScatterPrior(1.0, 15.0)


def series(values, *, scales=None, temperature=None, motions=None):
    values = np.asarray(values, dtype=float)
    return NightSeries(
        np.arange(len(values), dtype=float),
        values,
        np.ones(len(values)) if scales is None else scales,
        np.full(len(values), np.nan) if temperature is None else temperature,
        np.zeros(len(values), dtype=int) if motions is None else motions,
    )


@pytest.mark.parametrize("nights", [4, 8, 30])
def test_p_values_are_not_too_small_when_nothing_changes(nights):
    random = np.random.default_rng(nights)
    arms = [
        series(5.0 + 1.3 * np.exp(0.2 * random.normal()) * random.normal(size=nights))
        for _ in range(900 if nights < 30 else 400)
    ]
    prior = scatter_prior(arms)
    assert 1.1**2 < prior.variance < 1.5**2
    p = np.array([strongest_change(each, prior).p_value for each in arms])
    assert np.mean(p < 0.05) < 0.055
    assert np.mean(p < 0.002) <= 0.004


def test_a_step_is_found_at_its_night_with_its_size():
    random = np.random.default_rng(2)
    late = []
    for _ in range(50):
        values = 10.0 + random.normal(size=20) + 4.0 * (np.arange(20) >= 12)
        change = strongest_change(series(values), PRIOR)
        late.append(change.first - 12)
        assert change.p_value < 1e-3
    assert np.mean(np.abs(late) <= 2) > 0.95
    assert abs(change.size - 4.0) < 4.0 * change.std
    assert change.kind == "step"
    assert change.days_of_limit(19.0, 100.0) == [None] * 3


def test_a_drift_has_a_slope_with_an_interval_and_the_day_of_its_limit():
    random = np.random.default_rng(3)
    inside, late = 0, []
    for _ in range(100):
        drift = 1.4 * np.maximum(np.arange(30) - 11, 0)
        change = strongest_change(series(50.0 + random.normal(size=30) + drift), PRIOR)
        late.append(change.first - 12)
        inside += change.slope_low < 1.4 < change.slope_high
        assert change.kind == "drift"
        assert abs(change.size - drift[-1]) < 5.0 * change.std
    assert np.mean(np.abs(late) <= 2) > 0.95
    assert inside >= 93
    day, early, late = change.days_of_limit(29.0, 100.0)
    assert abs(day - (29.0 + (50.0 - drift[-1]) / 1.4)) < 3.0
    assert early < day < late
    assert change.days_of_limit(29.0, 1.0) == [29.0] * 3  # it has been reached


def test_the_dependence_on_temperature_is_not_a_change():
    random = np.random.default_rng(4)

    def arm(noise=0.3):
        temperature = 25.0 + np.cumsum(random.normal(size=20)) + 8.0 * (np.arange(20) >= 10)
        return series(
            10.0 - 2.0 * temperature + noise * random.normal(size=20), temperature=temperature
        )

    arms = [arm() for _ in range(12)]
    warmth, prior = temperature_prior(arms), ScatterPrior(0.1, 10.0)
    assert abs(warmth.slope + 2.0) < 0.1
    assert sum(strongest_change(each, prior).p_value < 1e-3 for each in arms) > 8
    assert all(strongest_change(each, prior, warmth).p_value > 1e-3 for each in arms)
    assert temperature_prior([series(np.arange(9))]) is None


def test_only_rises_of_an_error_count():
    falling = series([5.0, 5.1, 4.9, 5.0, -20.0, -20.0, -20.0])
    assert strongest_change(falling, PRIOR).p_value < 1e-6
    assert strongest_change(falling, PRIOR, rises_only=True).p_value > 0.9


def test_an_effect_that_is_found_again_and_again():
    found = np.array([False] * 6 + [True] * 3)
    p, first = repeated_finding(found, 0.002)
    assert first == 6
    assert p < 1e-4
    once, _ = repeated_finding(np.array([False] * 8 + [True]), 0.002)
    assert once > 1e-3
    always, _ = repeated_finding(np.ones(9, dtype=bool), 0.002)
    assert always > 1e-3


def test_p_values_of_findings_if_the_rates_of_the_arms_differ():
    random = np.random.default_rng(6)
    rate, weight, arms = 0.02, 20.0, 8_000
    rates = random.beta(weight * rate, weight * (1.0 - rate), size=arms)
    found = random.random((arms, 12)) < rates[:, None]
    p = np.array([repeated_finding(each, rate)[0] for each in found if each[4:].any()])
    assert np.sum(p < 0.01) <= 0.01 * arms
    assert np.sum(p < 1e-3) <= 1e-3 * arms


def test_a_change_without_one_of_its_nights():
    values = np.random.default_rng(8).normal(size=16)
    outlier, step = values.copy(), values.copy()
    outlier[14] += 40.0
    step[14:] += 40.0
    for each, seen in ((outlier, False), (step, True)):
        change = strongest_change(series(each), PRIOR)
        assert change.first == 14
        assert change.p_value < 1e-3
        assert (change.p_without_night < 0.01) == seen
    step[14] = values[14]
    assert strongest_change(series(step), PRIOR).p_without_night == 1.0
    drift = values + 1.5 * np.maximum(np.arange(16) - 9, 0)
    assert strongest_change(series(drift), PRIOR).p_without_night < 1e-3


def test_another_motion_is_not_a_change():
    """Estimates depend on the motion: a new motion shifts them like a step."""
    random = np.random.default_rng(5)

    def arm():
        motions = np.repeat(np.arange(4), 7)
        shifts = 1.5 * random.normal(size=4)[motions]
        return series(shifts + 0.7 * random.normal(size=28), motions=motions)

    arms = [arm() for _ in range(60)]
    prior = scatter_prior(arms)
    assert 2.0 < prior.between < 9.0  # (1.5 / 0.7)²
    p = np.array([strongest_change(each, prior).p_value for each in arms])
    blind = [NightSeries(a.days, a.values, a.scales, a.temperature, 0 * a.motions) for a in arms]
    blind_p = [strongest_change(each, scatter_prior(blind)).p_value for each in blind]
    assert np.mean(p < 0.01) <= 0.05 < np.mean(np.array(blind_p) < 0.01)
    drift = series(
        arms[0].values + 1.0 * np.maximum(np.arange(28) - 17, 0), motions=arms[0].motions
    )
    change = strongest_change(drift, prior)
    assert change.p_value < 1e-4
    assert abs(change.first - 18) <= 2
