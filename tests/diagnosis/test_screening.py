"""Gains of candidates against least squares on stacked matrices."""

import numpy as np
import pytest

from lieid_casadi.diagnosis.residual.unexplained import Smooth
from lieid_casadi.diagnosis.screening.candidate_columns import assemble
from lieid_casadi.diagnosis.screening.screen import Baseline, screen
from lieid_casadi.diagnosis.search.evidence import Family
from lieid_casadi.diagnosis.search.forward_selection import Price, best_set, column_stack
from lieid_casadi.diagnosis.search.rivals import cross_validated_gain, rivals_of
from lieid_casadi.identification.uncertainty.noise_model import Noise, Runs, noise_of

ROWS = 300


def runs():
    return [Runs((np.arange(ROWS),), np.zeros(ROWS)) for _ in range(2)]


def arena(seed=0, groups=6, width=2):
    """Two joints, a model of three columns, groups of two columns on one joint each."""
    random = np.random.default_rng(seed)
    matrices = [random.normal(size=(ROWS, 3)) for _ in range(2)]
    tried, on_joint, first = [], [[], []], 0
    for k in range(groups):
        joint = k % 2
        tried.append(Smooth(joint, (f"q{k}",), width))
        on_joint[joint].append((first, random.normal(size=(ROWS, width))))
        first += width
    bank = assemble(tried, range(groups), [0] * groups, [width] * groups, on_joint, runs())
    return random, matrices, bank


def misfit(columns, torque):
    return np.sum((torque - columns @ np.linalg.lstsq(columns, torque, rcond=None)[0]) ** 2)


def test_gain_is_the_fall_of_the_sum_of_squares():
    random, matrices, bank = arena()
    torques = [random.normal(size=ROWS) for _ in range(2)]
    screening = screen(bank, Baseline.of(matrices, torques))
    model, torque = np.concatenate(matrices), np.concatenate(torques)
    for group in range(6):
        both = np.column_stack([model, column_stack(bank, group)])
        assert screening.gain[group] == pytest.approx(misfit(model, torque) - misfit(both, torque))


def test_what_the_model_spans_is_absorbed():
    random, matrices, bank = arena(groups=2)
    bank.parts[0].matrix[:, 0] = matrices[0] @ [1.0, -2.0, 0.5]
    matrices[1][:] = 0.0  # else the other joint tells them apart
    torques = [random.normal(size=ROWS) for _ in range(2)]
    bank.parts[0].matrix[:, 1] = bank.parts[0].matrix[:, 0] * 2.0
    screening = screen(bank, Baseline.of(matrices, torques))
    assert screening.remaining[0] < 1e-6
    assert screening.gain[0] == 0.0
    assert screening.remaining[1] > 0.9


def test_a_pair_that_hides_behind_a_proxy_is_found():
    random, matrices, bank = arena(seed=3)
    first, second = bank.parts[0].matrix[:, 0], bank.parts[0].matrix[:, 2]
    # the third group of joint 1 is nearly the sum of the two that are there
    bank.parts[0].matrix[:, 4] = first + second + 0.3 * random.normal(size=ROWS)
    torques = [first + second + 0.05 * random.normal(size=ROWS), 0.05 * random.normal(size=ROWS)]
    baseline = Baseline.of(matrices, torques)
    alone = screen(bank, baseline).gain
    assert np.argmax(alone) == 4
    assert set(best_set(bank, baseline, Price(each=0.05, part=0.0))) == {0, 2}


def test_family_wise_p_values_are_uniform_where_nothing_is():
    random, matrices, bank = arena(groups=30)
    family = Family.of(screen(bank, Baseline.of(matrices, [np.ones(ROWS)] * 2)), seed=1)
    assert 15 < family.tests < 45
    small = 0
    for _ in range(300):
        torques = [random.normal(size=ROWS) for _ in range(2)]
        screening = screen(bank, Baseline.of(matrices, torques))
        best = int(np.argmax(screening.gain))
        small += family.log10_p(screening.gain[best], 2) < np.log10(0.1)
    assert 15 <= small <= 47  # 30 of 300 expected; binomial, four deviations


def test_far_tails_keep_their_order():
    family = Family(100.0)
    values = [family.log10_p(gain, 2) for gain in (10.0, 100.0, 1e3, 1e5, 1e6)]
    assert np.all(np.diff(values) < 0.0)
    assert np.all(np.isfinite(values))
    assert values[3] == pytest.approx((-5e4 + np.log(100.0)) / np.log(10.0), rel=1e-6)


def test_rivals_are_those_that_the_data_cannot_tell():
    random, matrices, bank = arena(seed=5)
    true = bank.parts[0].matrix[:, :2]
    bank.parts[0].matrix[:, 2:4] = true @ [[1.0, 0.5], [0.3, 2.0]]  # the same span
    bank.parts[0].matrix[:, 4:6] = true + 0.02 * random.normal(size=true.shape)
    torques = [true @ [0.2, 0.2] + random.normal(size=ROWS), random.normal(size=ROWS)]
    blocks = np.tile(np.arange(ROWS) // 10, 2)
    found = rivals_of(bank, Baseline.of(matrices, torques), [], 0, blocks)
    assert [(r.group, r.kind) for r in found] == [(2, "exact"), (4, "data")]


def test_cross_validation_does_not_reward_noise():
    random, matrices, bank = arena(seed=7)
    torques = [random.normal(size=ROWS) for _ in range(2)]
    baseline, folds = Baseline.of(matrices, torques), np.tile(np.arange(ROWS) // 30 % 5, 2)
    noise = [cross_validated_gain(column_stack(bank, g), baseline, folds) for g in range(6)]
    assert np.mean(noise) < 0.0
    torques[0] = torques[0] + bank.parts[0].matrix[:, 0]
    baseline = Baseline.of(matrices, torques)
    assert cross_validated_gain(column_stack(bank, 0), baseline, folds) > 200.0


def test_autoregression_whitens_its_own_noise():
    random = np.random.default_rng(2)
    series, white = np.zeros(4000), random.normal(size=4000)
    for k in range(2, 4000):
        series[k] = 1.2 * series[k - 1] - 0.5 * series[k - 2] + 0.3 * white[k]
    runs_ = Runs((np.arange(2500), np.arange(2500, 4000)), np.zeros(4000))
    noise = noise_of(series, runs_, 1.0)
    assert noise.order >= 2
    np.testing.assert_allclose(noise.filter[1:3], [-1.2, 0.5], atol=0.06)
    whitened = noise.whiten(series, runs_)
    assert np.std(whitened) == pytest.approx(1.0, abs=0.03)
    assert abs(np.mean(whitened[1:] * whitened[:-1])) < 0.05
    assert len(whitened) == len(noise.instants(runs_))


def test_white_noise_stays_as_it_is():
    noise = Noise.white(2.0)
    np.testing.assert_allclose(
        noise.whiten(np.arange(5.0), Runs((np.arange(5),), np.zeros(5))), np.arange(5) / 2
    )


def test_rows_in_doubt_count_for_as_much_as_they_are_sure():
    random = np.random.default_rng(5)
    doubt = np.where(np.arange(20_000) % 4 == 0, 3.0, 0.0)
    series = random.standard_normal(20_000) * np.hypot(0.5, doubt)
    runs_ = Runs((np.arange(20_000),), doubt)
    noise = noise_of(series, runs_)
    assert noise.spread == pytest.approx(0.5, rel=0.03)
    whitened = noise.whiten(series, runs_)
    rows = noise.instants(runs_)
    for sure in (doubt[rows] == 0.0, doubt[rows] > 0.0):
        assert np.std(whitened[sure]) == pytest.approx(1.0, abs=0.05)


def test_a_column_of_zeros_does_not_hide_its_group():
    """A planar arm shows but some columns of a payload, a wrench or a tilt."""
    random, matrices, bank = arena(seed=9)
    bank.parts[0].matrix[:, 1] = 0.0
    torques = [bank.parts[0].matrix[:, 0] + random.normal(size=ROWS), random.normal(size=ROWS)]
    screening = screen(bank, Baseline.of(matrices, torques))
    assert screening.gain[0] > 100.0
    assert screening.rank[0] == 1
