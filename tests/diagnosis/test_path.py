"""Paths and held-out errors by inner products, compared with least squares on the rows."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from lieid_casadi.diagnosis import path
from lieid_casadi.diagnosis.candidates import Candidate
from lieid_casadi.diagnosis.columns import assemble
from lieid_casadi.diagnosis.evidence import HeldOut, judge
from lieid_casadi.diagnosis.folds import Folds
from lieid_casadi.diagnosis.gates import elsewhere
from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.path import Paths, Rules, Span, forward
from lieid_casadi.diagnosis.smooth_functions import cost_of
from lieid_casadi.effects import Placement, make

ROWS, MODEL, GROUPS = 400, 5, 12


def problem(seed, *, signal=(), size=0.5):
    """Two joints, columns of one or two, the residual with a torque of some groups."""
    random = np.random.default_rng(seed)
    model = [random.normal(size=(ROWS, MODEL)) for _ in range(2)]
    effects = [make("viscous_asymmetric"), make("viscous_polynomial")]
    owners, pieces, sizes, first = [], [[], []], [], 0
    for k in range(GROUPS):
        effect, joint = effects[k % 2], (k // 2) % 2
        owners.append(Candidate(Placement(effect, joint), np.zeros((1, 0))))
        values = random.normal(size=(ROWS, len(effect.coefficients)))
        pieces[joint].append((first, values))
        sizes.append(values.shape[1])
        first += values.shape[1]
    columns = assemble(owners, range(GROUPS), [0] * GROUPS, sizes, pieces, [ROWS, ROWS])
    residual = random.normal(size=2 * ROWS)
    for group in signal:
        residual += size * columns.stacked(group).sum(axis=1)
    return model, residual, columns


def parts(count=5):
    block = np.tile(np.arange(ROWS) * count // ROWS, 2)
    held = np.array([block == k for k in range(count)])
    return Folds(held, held, 0.0, True, np.array([100, 100]))


def rules(columns, penalty=20.0):
    count = len(columns.size)
    return Rules(
        np.full(count, penalty), np.ones(count, bool), np.zeros(count, bool), lambda g, v: True, 8
    )


@pytest.mark.parametrize("part", [-1, 0, 3])
def test_gains_along_a_path_are_those_of_least_squares(part):
    model, residual, columns = problem(1, signal=(2, 5))
    span, folds = Span.of(model, np.split(residual, 2)), parts()
    paths = Paths(span, columns, folds.out)
    used = np.ones(2 * ROWS, bool) if part < 0 else ~folds.out[part]
    base = np.concatenate(model)[used]
    state = paths.state(part).with_group(5).with_group(2).without(5).with_group(7)
    have = np.hstack([base, columns.stacked(2)[used], columns.stacked(7)[used]])

    def squares(matrix):
        return float(
            np.sum((residual[used] - matrix @ np.linalg.lstsq(matrix, residual[used])[0]) ** 2)
        )

    gains, values = state.gains()
    for group in (0, 1, 5, 9):
        more = np.hstack([have, columns.stacked(group)[used]])
        assert gains[group] == pytest.approx(squares(have) - squares(more), rel=1e-3, abs=1e-6)
        solution = np.linalg.lstsq(more, residual[used])[0][-int(columns.size[group]) :]
        np.testing.assert_allclose(values[columns.of_group(group)], solution, rtol=2e-3, atol=1e-6)


def test_a_coefficient_stays_near_the_one_at_which_its_column_was_evaluated():
    """Of a kept model; the gain is that of bounded least squares, halfway to the neighbours."""
    random, values = np.random.default_rng(9), np.array([0.0, 0.01, 0.02, 0.04])
    delay = Candidate(Placement(make("torque_delay"), 0), values[:, None])
    pieces = [[(k, random.normal(size=(ROWS, 1))) for k in range(4)], []]
    columns = assemble([delay], [0] * 4, range(4), [1] * 4, pieces, [ROWS, ROWS])
    halfway = [-np.inf, 0.005, 0.015, 0.03, np.inf]
    model, prior = [np.ones((ROWS, 1)), np.ones((ROWS, 1))], np.ones((1, 1))
    for group, size in ((1, 0.004), (1, 0.012), (2, 0.05), (3, 0.5), (0, -0.01)):
        torque = np.split(size * columns.stacked(group)[:, 0], 2)
        for kept in (prior, None):
            span = Span.of(model, torque, kept)
            state = Paths(span, columns, parts().out).state(-1)
            column, square = span.outside(columns.stacked(group)), span.residual @ span.residual
            bounds = (halfway[group], halfway[group + 1]) if kept is not None else (-1.0, 1.0)
            bounded, free = (
                square - 2.0 * lsq_linear(column, span.residual, bounds=of).cost
                for of in (bounds, (-1.0, 1.0))
            )
            assert state.gains()[0][group] == pytest.approx(bounded, rel=1e-3, abs=1e-6)
            assert state.gains(free=True)[0][group] == pytest.approx(free, rel=1e-3, abs=1e-6)


@pytest.mark.parametrize("prior", [np.zeros((0, MODEL)), 5.0 * np.eye(MODEL)], ids=["free", "kept"])
def test_held_out_errors_are_those_of_a_fit_to_the_other_rows(prior):
    """Rows of a prior are in every fit, and an equal part of their squares in every part."""
    model, residual, columns = problem(2, signal=(3,))
    span, folds = Span.of(model, np.split(residual, 2), prior), parts()
    groups = (3, 4)
    outside = {g: span.outside(columns.stacked(g)) for g in groups}
    kept = np.pad(prior, ((0, 0), (0, sum(columns.size[g] for g in groups))))
    for k in range(folds.count):
        matrix = np.hstack([np.concatenate(model), *(columns.stacked(g) for g in groups)])
        rest, held = ~folds.out[k], folds.held[k]
        torque = np.append(residual[rest], np.zeros(len(prior)))
        values = np.linalg.lstsq(np.concatenate([matrix[rest], kept]), torque)[0]
        error = residual[held] - matrix[held] @ values
        expected = np.bincount(span.joint_of[held], weights=error**2)
        moved = np.sum((kept @ values) ** 2) / folds.count
        part = HeldOut(span, folds, k, outside)
        found = part.squares(part.errors(groups))
        np.testing.assert_allclose(found, [*expected, moved], rtol=1e-6)


def test_parameters_of_a_kept_model_that_move_in_its_place_are_no_reason_against_an_effect():
    """Held-out rows are predicted equally well by a parameter that has moved; the prior is not."""
    model, residual, columns = problem(4, signal=(0,), size=0.5)
    model[0][:, 0] = columns.stacked(0)[:ROWS, 0]  # the effect is a change of this parameter
    for scale, supported in ((0.1, False), (20.0, True)):
        span, folds = Span.of(model, np.split(residual, 2), scale * np.eye(MODEL)), parts(10)
        paths = Paths(span, columns, folds.out)
        (slot,), _ = judge(paths, folds, [0], [[0]] * 10, {})
        assert (slot.evidence.deviations > 5.0) == supported
        assert (slot.fall > 0.05) == supported


def test_a_group_that_the_others_nearly_contain_stays_where_its_own_part_is_needed():
    """Only 2 % of its column are its own; without it the path has nearly the whole error again."""
    _, one, other, own = np.linalg.qr(np.random.default_rng(6).normal(size=(ROWS, 4)))[0].T
    both = np.sqrt(1.0 - 0.3**2 - 0.02**2) * one + 0.3 * other + 0.02 * own
    owner = Candidate(Placement(make("armature"), 0), np.zeros((1, 0)))
    pieces = [[(k, column[:, None]) for k, column in enumerate((both, one, other))], []]
    columns = assemble([owner] * 3, range(3), [0] * 3, [1] * 3, pieces, [ROWS, ROWS])
    torque = 1000.0 * both - 30.0 * one + 95.0 * other + 25.0 * own
    span = Span.of([np.zeros((ROWS, 1))] * 2, [torque, np.zeros(ROWS)])
    assert forward(Paths(span, columns), -1, rules(columns)) == (0, 1, 2)


def test_effects_that_are_there_are_selected_in_every_path_and_noise_is_not_supported():
    model, residual, columns = problem(3, signal=(2, 5), size=0.4)
    span, folds = Span.of(model, np.split(residual, 2)), parts(10)
    paths = Paths(span, columns, folds.out)
    loose = rules(columns, penalty=1.0)  # so loose that paths contain noise
    whole = forward(paths, -1, loose)
    parts_of = [forward(paths, k, loose) for k in range(10)]
    slots, _ = judge(paths, folds, whole, parts_of, {})
    found = {slot.group: slot for slot in slots}
    assert {2, 5} <= set(found)
    for group, slot in found.items():
        if group in (2, 5):
            assert slot.evidence.selected == 1.0
            assert slot.evidence.deviations > 3.0
        else:
            assert slot.evidence.deviations < 2.0


@pytest.mark.parametrize(
    "expected",
    [
        [0.1] * 10,
        [0.0, 0.01, 0.01, 0.02, 0.05, 0.05, 0.1, 0.3, 0.02, 0.04],
        [0.3, 0.3, 0.3, *[0.01] * 7],
        [0.5, 0.3, *[0.005] * 8],
    ],
)
def test_noise_exceeds_a_deviation_as_often_as_with_equal_parts(expected):
    """Student's distribution with nine degrees of freedom exceeds two in 3.8 and three in 0.7 %."""
    folds, random = parts(10), np.random.default_rng(11)
    gains = random.normal(size=(8000, 10)) * np.sqrt(expected)
    found = np.array([folds.deviations(own, np.array(expected), 0)[1] for own in gains])
    assert 0.02 < np.mean(found > 2.0) < 0.047
    assert 0.001 < np.mean(found > 3.0) < 0.01


def test_gains_in_few_parts_count_where_the_effect_is_expected_there():
    folds = parts(10)
    gains = np.array([0.0, 0.07, -0.06, 0.12, -0.02, 0.04, 0.04, 0.62, 0.33, 0.0])
    equal, own = np.full(10, 0.1), np.maximum(gains, 0.01)
    student = gains.mean() / (gains.std(ddof=1) / np.sqrt(10))
    assert folds.deviations(gains, equal, 0) == pytest.approx([student] * 2)
    deviations, certainty = folds.deviations(gains, own, 0)
    assert 2.0 * student < certainty < deviations
    assert folds.deviations(gains, own[::-1], 0)[0] < student
    assert folds.deviations(-gains, equal, 0) == pytest.approx([-student] * 2)
    assert folds.deviations(np.zeros(10), np.zeros(10), 0) == (0.0, 0.0)  # in no path


def test_a_part_whose_path_lacks_the_effect_counts_against_it():
    model, residual, columns = problem(3, signal=(2,), size=0.4)
    span, folds = Span.of(model, np.split(residual, 2)), parts(10)
    paths = Paths(span, columns, folds.out)
    found = (judge(paths, folds, [2], own, {}) for own in ([[2]] * 10, [[2]] * 6 + [[]] * 4))
    every, some = (slot.evidence for (slot,), _ in found)
    assert not any(some.gains[6:])
    assert min(some.expected[6:]) > 0.0
    assert some.deviations < every.deviations
    present = np.where(np.arange(10) < 6, some.expected, 0.0)
    assert some.deviations < 0.9 * folds.deviations(np.array(some.gains), present, 1)[0]


@pytest.mark.parametrize(("with_all", "expected"), [(1, 0), (0, 1)])
def test_an_effect_is_in_one_recording_only_if_every_path_says_so(with_all, expected):
    random = np.random.default_rng(5)
    own, second = random.normal(size=(ROWS, 1)), np.arange(ROWS)[:, None] >= ROWS // 4
    of_arm = Candidate(Placement(make("viscous_asymmetric"), 0), np.zeros((1, 0)))
    owners, pieces = [of_arm, replace(of_arm, recording=1)], [[(0, own), (1, own * second)]]
    columns = assemble(owners, [0, 1], [0, 0], [1, 1], pieces, [ROWS])
    residual = random.normal(size=ROWS) + 0.5 * own[:, 0]
    span = Span.of([random.normal(size=(ROWS, MODEL))], [residual])
    held = np.array([np.arange(ROWS) * 10 // ROWS == k for k in range(10)])
    folds = Folds(held, held, 0.0, True, np.array([100]))
    paths = Paths(span, columns, folds.out)
    parts_of = [[0]] * with_all + [[1]] * (10 - with_all)
    (found,), _ = judge(paths, folds, [1], parts_of, {})
    assert found.group == expected


def test_a_compromise_of_two_causes_gives_way_to_them():
    model, residual, columns = problem(4)
    # The first column resembles the sum of two others and explains most alone.
    owners, pieces = columns.owners[:3], [[], []]
    random = np.random.default_rng(0)
    a, b = random.normal(size=(2, ROWS))
    mixture = (a + b) / np.sqrt(2.0) + 0.2 * random.normal(size=ROWS)
    for first, values in enumerate((mixture, a, b)):
        pieces[0].append((first, values[:, None]))
    owners = [Candidate(Placement(make("viscous_asymmetric"), 0), np.zeros((1, 0)))] * 3
    columns = assemble(owners, [0, 1, 2], [0] * 3, [1] * 3, pieces, [ROWS, ROWS])
    residual[:ROWS] += 3.0 * (a + b)
    span = Span.of(model, np.split(residual, 2))
    paths = Paths(span, columns, np.zeros((0, 2 * ROWS), bool))
    assert set(forward(paths, -1, rules(columns))) == {1, 2}


@pytest.mark.parametrize("prior", [None, np.eye(MODEL)])
def test_a_path_has_one_delay_or_filter_of_the_same_torque(prior):
    """Two that nearly cancel resemble friction of another form, and neither is needed alone."""
    model, residual, columns = problem(3, signal=(0, 2, 4))
    names = {0: ("torque_delay", 0), 2: ("torque_delay", 1), 4: ("torque_lowpass", 0)}
    owners = [
        replace(c, placement=Placement(make(names[k][0]), names[k][1])) if k in names else c
        for k, c in enumerate(columns.owners)
    ]
    span = Span.of(model, np.split(residual, 2), prior)
    columns = replace(columns, owners=tuple(owners))
    paths = Paths(span, columns, np.zeros((0, len(span.residual)), dtype=bool))
    found = forward(paths, -1, rules(columns))
    assert len({0, 2, 4}.intersection(found)) == 2
    assert 2 in found


def test_an_effect_of_the_arm_counts_where_the_error_falls_most():
    """The zero of a joint's position was not added: its own error hardly depends on it."""
    random = np.random.default_rng(6)
    own, other = random.normal(size=(2, ROWS, 1))
    arm = Candidate(Placement(make("encoder_offset"), 0), np.zeros((1, 0)))
    columns = assemble([arm], [0], [0], [1], [[(0, 0.01 * own)], [(0, other)]], [ROWS, ROWS])
    residual = [random.normal(size=ROWS), random.normal(size=ROWS) + 2.0 * other[:, 0]]
    span = Span.of([random.normal(size=(ROWS, MODEL)) for _ in range(2)], residual)
    held = np.tile([np.arange(ROWS) * 10 // ROWS == k for k in range(10)], 2)
    folds = Folds(held, held, 0.0, True, np.array([100, 100]))
    paths = Paths(span, columns, folds.out)
    (found,), _ = judge(paths, folds, [0], [[0]] * 10, {})
    assert (columns.candidate(found.group).joint, found.joint) == (0, 1)
    assert found.reason(DiagnosisOptions()) is None


def test_one_part_with_a_large_error_does_not_decide():
    """A gain certain to 24 standard errors was refused: the sum of squares was that of one part."""
    random = np.random.default_rng(8)
    held = np.array([np.arange(ROWS) * 10 // ROWS == k for k in range(10)])
    own, model = random.normal(size=(ROWS, 1)), random.normal(size=(ROWS, MODEL))
    own[held[0]], model[held[0]] = 0.0, 0.0
    candidate = Candidate(Placement(make("viscous_asymmetric"), 0), np.zeros((1, 0)))
    columns = assemble([candidate], [0], [0], [1], [[(0, own)]], [ROWS])
    residual = np.where(held[0], 30.0, 1.0) * random.normal(size=ROWS) + 2.0 * own[:, 0]
    span = Span.of([model], [residual])
    folds = Folds(held, held, 0.0, True, np.array([100]))
    paths = Paths(span, columns, folds.out)
    (found,), _ = judge(paths, folds, [0], [[0]] * 10, {})
    assert found.reason(DiagnosisOptions()) is None
    assert found.before[0] > 0.9 * found.before.sum()  # of which it lowers none
    assert 0.1 < found.fall < 0.5


def test_a_path_ends_where_groups_replace_each_other(monkeypatch):
    """A hang on a recording of 0.3 s correlated noise: an exchange took back what was added."""
    model, residual, columns = problem(4, signal=(2, 5))
    paths = Paths(Span.of(model, np.split(residual, 2)), columns, parts().out)
    monkeypatch.setattr(path, "_exchanged", lambda state, *_: state.without(state.groups[-1]))
    assert len(forward(paths, -1, rules(columns))) == 1


@pytest.mark.parametrize("count", [2, 10, 16])
def test_noise_seldom_gains_the_cost_of_a_function_beside_a_kept_model(count):
    random, rows, runs = np.random.default_rng(count), 400, 20_000
    columns = np.linalg.qr(random.normal(size=(rows, count)))[0]
    gains = ((random.normal(size=(runs, rows)) @ columns) ** 2).sum(axis=1)
    seldom = 25  # in place of 400 rows, so that noise does so often enough to be counted
    part = np.mean(gains > cost_of(count, seldom, whole=True))
    assert part == pytest.approx(1.0 / seldom, abs=0.005)
    plain = cost_of(count, rows, whole=False)
    assert plain == pytest.approx(count * np.log(rows))
    assert cost_of(count, rows, whole=True) <= plain * (1.0 + 1e-9)


@pytest.mark.parametrize(("name", "others"), [("presliding", 2), ("transmission_coupling", 0)])
def test_couplings_of_other_joints_are_no_evidence_for_one(name, others):
    effect, none = make(name), np.zeros((1, 0))
    sources = [(j + 1) % 3 if effect.couples else None for j in range(3)]
    every = [Candidate(Placement(effect, j, source), none) for j, source in enumerate(sources)]
    assert elsewhere(every[0], every) == others


@pytest.mark.parametrize(
    ("name", "alike"),
    [("deadband", True), ("stribeck", True), ("smooth/dq", True), ("presliding", False)],
)
def test_an_effect_like_friction_at_rest_must_explain_more_than_this_does(name, alike):
    random = np.random.default_rng(7)
    own = random.normal(size=(ROWS, 1))
    effect = Candidate(Placement(make(name), 0), np.zeros((1, 0)))
    columns = assemble([effect], [0], [0], [1], [[(0, own)]], [ROWS])
    near_rest = own * (np.arange(ROWS)[:, None] % 10 < 3)  # where alone the residual follows it
    span = Span.of(
        [random.normal(size=(ROWS, MODEL))], [random.normal(size=ROWS) + 5.0 * near_rest[:, 0]]
    )
    held = np.array([np.arange(ROWS) * 10 // ROWS == k for k in range(10)])
    folds = Folds(held, held, 0.0, True, np.array([100]))
    paths, none = Paths(span, columns, folds.out), np.zeros((ROWS, 1))
    friction = {"late": none, "early": none, "rest": near_rest}
    (slot,), _ = judge(paths, folds, [0], [[0]] * 10, friction)
    assert bool(slot.evidence.deviations < 2.0) is alike
    assert bool(slot.fall < 0.03) is alike
