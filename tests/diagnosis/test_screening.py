"""Gains of candidates against least squares on stacked matrices."""

from dataclasses import replace

import numpy as np
import pytest

from lieid_casadi.diagnosis.options import DiagnosisOptions, Penalty
from lieid_casadi.diagnosis.screening import screen as screening_module
from lieid_casadi.diagnosis.screening.baseline import with_groups
from lieid_casadi.diagnosis.screening.candidate_columns import assemble_columns
from lieid_casadi.diagnosis.screening.cross_validation import cross_validated_gain
from lieid_casadi.diagnosis.screening.evidence import HypothesisFamily
from lieid_casadi.diagnosis.screening.model_factor import ModelFactor
from lieid_casadi.diagnosis.screening.smooth_functions import SmoothFunction
from lieid_casadi.diagnosis.search.forward_selection import best_set
from lieid_casadi.diagnosis.search.rivals import find_rivals
from lieid_casadi.identification.uncertainty.noise_model import Noise, Runs, noise_of

ROWS = 300
OPTIONS = DiagnosisOptions()


def screen(candidates, baseline):
    return screening_module.screen(candidates, baseline, OPTIONS)


def runs():
    return [Runs((np.arange(ROWS),), np.zeros(ROWS)) for _ in range(2)]


def random_problem(seed=0, groups=6, width=2):
    """Two joints, a model of three columns, groups of two columns on one joint each."""
    random = np.random.default_rng(seed)
    matrices = [random.normal(size=(ROWS, 3)) for _ in range(2)]
    functions, on_joint, first = [], [[], []], 0
    for k in range(groups):
        joint = k % 2
        functions.append(SmoothFunction(joint, (f"q{k}",), width))
        on_joint[joint].append((first, random.normal(size=(ROWS, width))))
        first += width
    candidates = assemble_columns(
        functions, range(groups), [0] * groups, [width] * groups, on_joint, runs()
    )
    return random, matrices, candidates


def misfit(columns, torque):
    return np.sum((torque - columns @ np.linalg.lstsq(columns, torque, rcond=None)[0]) ** 2)


def test_gain_is_the_fall_of_the_sum_of_squares():
    random, matrices, candidates = random_problem()
    torques = [random.normal(size=ROWS) for _ in range(2)]
    screening = screen(candidates, ModelFactor.of(matrices, torques).baseline())
    model, torque = np.concatenate(matrices), np.concatenate(torques)
    for group in range(6):
        both = np.column_stack([model, candidates.stacked(group)])
        assert screening.gain[group] == pytest.approx(misfit(model, torque) - misfit(both, torque))


def test_gain_given_added_groups_is_the_fall_of_the_sum_of_squares():
    random, matrices, candidates = random_problem(seed=4)
    torques = [random.normal(size=ROWS) for _ in range(2)]
    baseline = with_groups(ModelFactor.of(matrices, torques).baseline(), candidates, [1, 2])
    assert baseline.rank == 3 + 2 * 2
    columns = [np.concatenate(matrices), candidates.stacked(1), candidates.stacked(2)]
    model, torque = np.column_stack(columns), np.concatenate(torques)
    screening = screen(candidates, baseline)
    for group in (0, 3, 4, 5):
        both = np.column_stack([model, candidates.stacked(group)])
        assert screening.gain[group] == pytest.approx(misfit(model, torque) - misfit(both, torque))
    assert screening.rank[1] == screening.rank[2] == 0


@pytest.mark.parametrize("selected", [[], [1], [2, 1], [0, 3, 4]])
def test_gains_from_stored_inner_products_are_those_of_a_new_baseline(selected):
    random, matrices, candidates = random_problem(seed=6)
    candidates.joints[0].matrix[:, 4] = candidates.joints[0].matrix[:, 0]  # groups 0 and 4 overlap
    torques = [random.normal(size=ROWS) for _ in range(2)]
    baseline = ModelFactor.of(matrices, torques).baseline()
    found = screening_module.SelectionState(candidates, baseline, OPTIONS).given(selected)
    expected = screen(candidates, with_groups(baseline, candidates, selected))
    np.testing.assert_allclose(found.gain, expected.gain, atol=1e-9)
    np.testing.assert_allclose(found.remaining, expected.remaining, atol=1e-6)
    np.testing.assert_array_equal(found.rank, expected.rank)


def test_stored_inner_products_allow_for_columns_left_out_of_and_added_to_the_model():
    random, matrices, candidates = random_problem(seed=7)
    torques = [random.normal(size=ROWS) for _ in range(2)]
    factor = ModelFactor.of(matrices, torques)
    baseline = with_groups(factor.baseline(without=[1]), candidates, [5])
    found = screening_module.SelectionState(candidates, baseline, OPTIONS).given([0, 3])
    model = [np.concatenate(matrices)[:, [0, 2]], *map(candidates.stacked, (5, 0, 3))]
    model, torque = np.column_stack(model), np.concatenate(torques)
    for group in (1, 2, 4):
        both = np.column_stack([model, candidates.stacked(group)])
        assert found.gain[group] == pytest.approx(misfit(model, torque) - misfit(both, torque))


def test_white_rows_would_give_the_gains_of_a_screening_of_their_part_outside_the_span():
    random, matrices, candidates = random_problem(seed=8)
    factor = ModelFactor.of(matrices, [random.normal(size=ROWS) for _ in range(2)])
    baseline = with_groups(factor.baseline(without=[2]), candidates, [4])
    white = random.normal(size=(2 * ROWS, 3))
    found = screen(candidates, baseline).statistic(white)
    for draw, rest in enumerate(baseline.project_out(white).T):
        expected = screen(candidates, replace(baseline, residual=rest)).gain
        np.testing.assert_allclose(found[:, draw], expected, atol=1e-9)


def test_columns_of_some_candidates_have_the_gains_that_they_have_among_all():
    random, matrices, candidates = random_problem(seed=9)
    baseline = ModelFactor.of(matrices, [random.normal(size=ROWS) for _ in range(2)]).baseline()
    some = candidates.of_owners([4, 1, 3])
    assert [some.owner(g) for g in range(3)] == [candidates.owners[k] for k in (1, 3, 4)]
    expected = screen(candidates, baseline).gain[[1, 3, 4]]
    np.testing.assert_allclose(screen(some, baseline).gain, expected)
    assert candidates.of_owners([]).count == 0


def test_the_part_outside_the_span_is_free_of_rounding_errors_of_the_projection():
    random, matrices, _ = random_problem(groups=2)
    baseline = ModelFactor.of(matrices, [random.normal(size=ROWS) for _ in range(2)]).baseline()
    inside, other = np.concatenate(matrices) @ np.ones(3), random.normal(size=2 * ROWS)
    rest = baseline.outside(np.column_stack([inside + 1e-9 * other, other]))
    for column in rest.T:  # one projection leaves 1e-16 of the column, 1e-7 of the first's part
        assert np.abs(baseline.model.T @ column).max() < 1e-14 * np.linalg.norm(column)


def test_columns_in_the_span_of_the_model_are_absorbed():
    random, matrices, candidates = random_problem(groups=2)
    candidates.joints[0].matrix[:, 0] = matrices[0] @ [1.0, -2.0, 0.5]
    matrices[1][:] = 0.0  # otherwise the rows of the other joint separate the two columns
    torques = [random.normal(size=ROWS) for _ in range(2)]
    candidates.joints[0].matrix[:, 1] = candidates.joints[0].matrix[:, 0] * 2.0
    screening = screen(candidates, ModelFactor.of(matrices, torques).baseline())
    assert screening.remaining[0] < 1e-6
    assert screening.gain[0] == 0.0
    assert screening.remaining[1] > 0.9


def test_a_pair_is_selected_instead_of_a_proxy_of_both():
    random, matrices, candidates = random_problem(seed=3)
    first, second = candidates.joints[0].matrix[:, 0], candidates.joints[0].matrix[:, 2]
    # the third group of joint 1 is nearly the sum of the two that are there
    candidates.joints[0].matrix[:, 4] = first + second + 0.3 * random.normal(size=ROWS)
    torques = [first + second + 0.05 * random.normal(size=ROWS), 0.05 * random.normal(size=ROWS)]
    baseline = ModelFactor.of(matrices, torques).baseline()
    alone = screen(candidates, baseline).gain
    assert np.argmax(alone) == 4
    state = screening_module.SelectionState(candidates, baseline, OPTIONS)
    assert set(best_set(state, Penalty(0.05, 0.0), OPTIONS)) == {0, 2}


def test_family_wise_p_values_are_uniform_under_the_null_hypothesis():
    random, matrices, candidates = random_problem(groups=30)
    family = HypothesisFamily.of(
        screen(candidates, ModelFactor.of(matrices, [np.ones(ROWS)] * 2).baseline()),
        seed=1,
        draws=200,
    )
    assert 15 < family.tests < 45
    small = 0
    for _ in range(300):
        torques = [random.normal(size=ROWS) for _ in range(2)]
        screening = screen(candidates, ModelFactor.of(matrices, torques).baseline())
        best = int(np.argmax(screening.gain))
        small += family.log10_p(screening.gain[best], 2) < np.log10(0.1)
    assert 15 <= small <= 47  # 30 of 300 expected; binomial, four deviations


def test_p_values_far_in_the_tail_keep_their_order():
    family = HypothesisFamily(100.0)
    values = [family.log10_p(gain, 2) for gain in (10.0, 100.0, 1e3, 1e5, 1e6)]
    assert np.all(np.diff(values) < 0.0)
    assert np.all(np.isfinite(values))
    assert values[3] == pytest.approx((-5e4 + np.log(100.0)) / np.log(10.0), rel=1e-6)


def test_rivals_cannot_be_separated_from_the_selected_group():
    random, matrices, candidates = random_problem(seed=5)
    true = candidates.joints[0].matrix[:, :2]
    candidates.joints[0].matrix[:, 2:4] = true @ [[1.0, 0.5], [0.3, 2.0]]  # the same span
    candidates.joints[0].matrix[:, 4:6] = true + 0.02 * random.normal(size=true.shape)
    torques = [true @ [0.2, 0.2] + random.normal(size=ROWS), random.normal(size=ROWS)]
    blocks = np.tile(np.arange(ROWS) // 10, 2)
    baseline = ModelFactor.of(matrices, torques).baseline()
    state = screening_module.SelectionState(candidates, baseline, OPTIONS)
    found = find_rivals(state, [], 0, excluded=[], blocks=blocks, options=OPTIONS)
    assert [(r.group, r.kind) for r in found] == [(2, "exact"), (4, "data")]


def test_held_out_gain_of_noise_is_negative():
    random, matrices, candidates = random_problem(seed=7)
    torques = [random.normal(size=ROWS) for _ in range(2)]
    baseline, folds = (
        ModelFactor.of(matrices, torques).baseline(),
        np.tile(np.arange(ROWS) // 30 % 5, 2),
    )
    noise = [cross_validated_gain(candidates.stacked(g), baseline, folds) for g in range(6)]
    assert np.mean(noise) < 0.0
    torques[0] = torques[0] + candidates.joints[0].matrix[:, 0]
    baseline = ModelFactor.of(matrices, torques).baseline()
    assert cross_validated_gain(candidates.stacked(0), baseline, folds) > 200.0


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


def test_white_noise_is_only_scaled():
    noise = Noise.white(2.0)
    np.testing.assert_allclose(
        noise.whiten(np.arange(5.0), Runs((np.arange(5),), np.zeros(5))), np.arange(5) / 2
    )


def test_rows_with_uncertain_friction_are_weighted_by_their_variance():
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


def test_a_column_of_zeros_does_not_exclude_its_group():
    """On a planar arm some columns of a payload, a wrench or a tilt are zero."""
    random, matrices, candidates = random_problem(seed=9)
    candidates.joints[0].matrix[:, 1] = 0.0
    torques = [
        candidates.joints[0].matrix[:, 0] + random.normal(size=ROWS),
        random.normal(size=ROWS),
    ]
    screening = screen(candidates, ModelFactor.of(matrices, torques).baseline())
    assert screening.gain[0] > 100.0
    assert screening.rank[0] == 1


@pytest.mark.parametrize("dependent", [False, True])
@pytest.mark.parametrize("without", [[], [2], [0, 4]])
def test_baselines_of_parts_of_a_model_are_those_of_their_own_columns(dependent, without):
    random, matrices, candidates = random_problem(seed=5)
    matrices = [np.column_stack([m, random.normal(size=(ROWS, 2))]) for m in matrices]
    if dependent:
        matrices = [np.column_stack([m, m[:, 0] + m[:, 2], np.zeros(ROWS)]) for m in matrices]
    torques = [random.normal(size=ROWS) for _ in range(2)]
    part = ModelFactor.of(matrices, torques).baseline(without)
    own = ModelFactor.of([np.delete(m, without, axis=1) for m in matrices], torques).baseline()
    assert part.rank == own.rank
    np.testing.assert_allclose(part.residual, own.residual, atol=1e-12)
    columns = candidates.stacked(1)
    np.testing.assert_allclose(part.outside(columns), own.outside(columns), atol=1e-12)
    found, expected = (screen(candidates, baseline).gain for baseline in (part, own))
    np.testing.assert_allclose(found, expected, rtol=1e-9)
