"""Statistics over nights: p-values, beginnings, drifts, temperature, repeated findings."""

import numpy as np
import pytest

from lieid_casadi.fleet.changes import (
    NightSeries,
    ScatterPrior,
    repeated_finding,
    scatter_prior,
    strongest_change,
    temperature_prior,
)

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
