"""Diagnosis of simulated arms: hidden effects are named, and nothing else."""

import json
from dataclasses import replace
from functools import cache
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from experiments.arms import arm as stribeck_arm
from experiments.arms import sines
from hypothesis import example, given
from hypothesis import strategies as st
from plant.recordings import recorded
from robot.random_arms import random_arm
from scipy.signal import lfilter
from scipy.stats import false_discovery_control, norm
from scipy.stats import t as student

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.cli.main import main
from lieid_casadi.diagnosis import (
    DiagnosisOptions,
    evidence,
    gates,
    missing,
    rivals,
    search,
    smooth_functions,
)
from lieid_casadi.diagnosis.candidates import (
    Candidate,
    implausible_value,
    shape_grid,
    unresolved_shape,
)
from lieid_casadi.diagnosis.columns import scan_peaks
from lieid_casadi.diagnosis.findings import finding
from lieid_casadi.diagnosis.folds import folds_of, places
from lieid_casadi.diagnosis.result import alias_sentence
from lieid_casadi.diagnosis.rows import Rows
from lieid_casadi.diagnosis.smooth_functions import followed_signals
from lieid_casadi.diagnosis.step import Evidence, Rival
from lieid_casadi.diagnosis.steps import (
    Accepted,
    absorbed_and_weak,
    beside_smooth_functions,
    other_forms,
)
from lieid_casadi.effects import Placement, make
from lieid_casadi.effects.placement import place
from lieid_casadi.errors import (
    EffectError,
    IdentificationError,
    LateFrictionWarning,
    SameRecordingWarning,
)
from lieid_casadi.messages import in_unit
from lieid_casadi.recording import process
from lieid_casadi.tables import std_text, value_text

ROBOT = lieid.robots.two_link()
MODEL = lieid.Model(ROBOT, "coulomb,viscous,offset")


@cache
def arm_with(*hidden, seed=0):
    arm = plant.demo_arm(ROBOT, seed=seed, hidden=None)
    return arm.with_effects(*(plant.hidden_effect(arm, n, j, strength=s) for n, j, s in hidden))


@cache
def run(arm, seed, name="", scale=1.0, sensors=None):
    t = np.arange(0.0, 15.0, 0.001)
    motion = [
        scale * x for x in plant.FourierTrajectory(ROBOT, base_frequency=1 / 15, seed=seed).at(t)
    ]
    return plant.measure_along(
        arm, t, *motion, sensors=sensors or plant.demo_sensors(ROBOT), seed=seed, name=name
    )


@cache
def two_runs(*hidden, seed=0):
    arm = arm_with(*hidden, seed=seed)
    return run(arm, seed + 1, "train"), run(arm, seed + 2, "test")


@cache
def diagnosis_of(*hidden, seed=0):
    return lieid.diagnose(MODEL, *two_runs(*hidden, seed=seed))


LOAD_FRICTION = ("load_friction", 0, 2.0)


def test_parts_are_apart_by_the_correlation_of_the_noise():
    """Noise correlated over 0.5 s is correlated for 1 s in all; a part of 15 s has 1.5 s."""
    fit = lieid.identify(MODEL, run(arm_with(), 1))
    rows = Rows.of(fit, process([run(arm_with(), 1)], fit.processing), with_candidates=False)
    random, residual = np.random.default_rng(0), []
    for use in rows.runs:
        kept = np.exp(-np.diff(rows.times[use.all]) / 0.5)
        noise = [0.0]
        for part in kept:
            noise.append(part * noise[-1] + np.sqrt(1.0 - part**2) * random.normal())
        residual.append(np.array(noise))
    folds = folds_of(rows, residual, 10)
    assert 0.7 < folds.gap < 1.5
    times = np.concatenate([rows.times[use.all] for use in rows.runs])
    for held, out in zip(folds.held, folds.out, strict=True):
        apart = np.abs(times[~out][:, None] - times[held]).min()
        assert apart >= folds.gap


def test_parts_of_periodic_motion_with_a_gap_are_stretches_of_the_period():
    t = np.arange(0.0, 40.0, 0.002)
    motion = plant.FourierTrajectory(ROBOT, base_frequency=0.1, seed=3).at(t % 10.0)
    arm = arm_with()
    whole = plant.measure_along(arm, t, *motion, sensors=plant.demo_sensors(ROBOT), seed=1)
    kept = (whole.t < 13.0) | (whole.t > 14.5)
    signals = whole.q[kept], whole.dq[kept], whole.tau[kept]
    recording = lieid.Recording.from_arrays(whole.t[kept] + 100.0, *signals)
    fit = lieid.identify(MODEL, recording)
    rows = Rows.of(fit, process([recording], fit.processing), with_candidates=False)
    part = places(rows, 10)
    phase = rows.clock % 10.0
    for k in range(10):
        inside = (phase > k + 0.1) & (phase < k + 0.9)
        assert len(np.unique(part[inside])) == 1


def test_an_effect_of_periodic_motion_is_found_in_noise_that_lasts_longer_than_its_parts():
    """Parts are tenths of a period of 4 s, and the noise is correlated over 1 s."""
    arm, t = arm_with(LOAD_FRICTION), np.arange(0.0, 24.0, 0.002)
    motion = plant.FourierTrajectory(ROBOT, base_frequency=0.25, seed=3).at(t % 4.0)
    recording = plant.measure_along(arm, t, *motion, sensors=plant.demo_sensors(ROBOT), seed=1)
    kept = np.exp(-0.002)
    white = np.random.default_rng(0).normal(0.0, np.sqrt(1.0 - kept**2), recording.tau.shape)
    slow = 0.1 * lfilter([1.0], [1.0, -kept], white, axis=0)
    diagnosis = lieid.diagnose(MODEL, replace(recording, tau=recording.tau + slow))
    assert [step.label for step in diagnosis.steps] == ["load_friction:1"]  # and no drift


def test_a_search_that_ends_at_its_rounds_says_so(monkeypatch):
    assert diagnosis_of(LOAD_FRICTION).limits_reached == ()
    monkeypatch.setattr(missing, "ROUNDS", 1)
    cut = lieid.diagnose(MODEL, *two_runs(LOAD_FRICTION))
    assert cut.limits_reached == ("rounds",)
    assert "The search ended at its limit (rounds); further effects may be missing" in cut.sentence


@pytest.mark.parametrize(
    ("name", "joint", "strength"),
    [
        ("load_friction", 0, 2.0),
        ("viscous_polynomial", 1, 10.0),  # it shows only near the top speed
        ("stribeck", 0, 2.0),
        ("torque_ripple", 1, 2.0),
        ("torque_delay", 1, 2.0),
        ("transmission_coupling", 1, 2.0),
    ],
)
def test_one_hidden_effect_is_named(name, joint, strength):
    train, test = two_runs((name, joint, strength))
    diagnosis = diagnosis_of((name, joint, strength))
    assert [(s.effect, s.joints[0]) for s in diagnosis.steps] == [(name, joint)]
    (step,) = diagnosis.steps
    assert step.errors["rms_test"][joint] < 0.8 * diagnosis.baseline["rms_test"][joint]
    printed = lieid.Model(ROBOT, ",".join(diagnosis.fit.model.effects))
    again = lieid.identify(printed, train, processing=diagnosis.fit.processing)
    np.testing.assert_array_equal(again.values, diagnosis.fit.values)
    np.testing.assert_array_equal(again.shapes, diagnosis.fit.shapes)
    compared = lieid.compare(diagnosis.fit, test)
    np.testing.assert_array_equal(diagnosis.noise_floor, compared.noise_floor)
    np.testing.assert_array_equal(step.errors["rms_test_moving"], compared.rms_moving)
    assert step.confirmed
    assert step.evidence.deviations > 3.0


@pytest.mark.parametrize("cutoff", [1.5, 2.5])
def test_an_effect_of_one_fast_move_in_slow_motion_is_found(cutoff):
    """Few rows have its torque: it was no candidate, and others imitated it."""

    def moved(seed):
        t = np.arange(0.0, 15.0, 0.001)
        slow = plant.FourierTrajectory(ROBOT, base_frequency=1 / 15, seed=seed).at(t)
        q, dq, ddq = (0.3 * x for x in slow)
        z = (t - 7.0) / 0.25
        speed = 5.0 * np.exp(-0.5 * z**2)
        q[:, 1] += 0.25 * 5.0 * np.sqrt(2.0 * np.pi) * norm.cdf(z)
        dq[:, 1] += speed
        ddq[:, 1] -= speed * z / 0.25
        return plant.measure_along(arm, t, q, dq, ddq, sensors=plant.demo_sensors(ROBOT), seed=seed)

    arm = arm_with(("viscous_polynomial", 1, 10.0))
    found = lieid.diagnose(MODEL, moved(1), moved(2), processing=lieid.Processing(cutoff=cutoff))
    assert [step.label for step in found.steps] == ["viscous_polynomial:2"]
    assert found.verdict == "effect_found"


def test_every_number_of_a_step_is_that_of_the_final_fit():
    train, test = two_runs(LOAD_FRICTION)
    diagnosis = diagnosis_of(LOAD_FRICTION)
    (step,) = diagnosis.steps
    table = {(row["name"], row["joint"]): row for row in diagnosis.fit.parameter_table()}
    row = table["load_friction.f_tau", 1]
    assert (step.parameters["f_tau"], step.std["f_tau"]) == (row["value"], row["std"])
    without = lieid.identify(MODEL, train, processing=diagnosis.fit.processing)
    fall = without.rms_cv[0] - diagnosis.fit.rms_cv[0]
    assert step.fall.cv == pytest.approx(fall, rel=1e-6)
    unseen = [lieid.compare(fit, test).rms_moving[0] for fit in (without, diagnosis.fit)]
    assert step.fall.test == pytest.approx(unseen[0] - unseen[1], rel=1e-6)
    _, (before, after) = diagnosis.shown  # as in the table of errors
    assert step.fall.test == pytest.approx(before[0] - after[0], rel=1e-6)
    value, std = value_text(row["value"], row["std"]), std_text(row["std"])  # as in its table
    assert f"(load_friction: {value} ± {std} N·m per N·m; " in diagnosis.sentence


def test_two_hidden_effects_are_named():
    hidden = ("load_friction", 0, 1.5), ("viscous_polynomial", 1, 10.0)
    diagnosis = diagnosis_of(*hidden)
    assert {s.label for s in diagnosis.steps} == {"load_friction:1", "viscous_polynomial:2"}
    train, _ = two_runs(*hidden)
    for step in diagnosis.steps:
        others = ",".join(s.label for s in diagnosis.steps if s is not step)
        without = lieid.identify(
            MODEL.with_effect(others), train, processing=diagnosis.fit.processing
        )
        # Shapes are not in these models, so that a fit without the step is the linear one.
        fall = without.rms_cv[step.joint] - diagnosis.fit.rms_cv[step.joint]
        assert step.fall.cv == pytest.approx(fall, rel=3e-2)


def with_breaks(arm, seed):
    """Return a recording of motion that pauses for half of the time, where friction is unknown."""
    t = np.arange(0.0, 25.0, 0.001)
    pace = 2.0 * np.maximum(np.sin(2.0 * np.pi * t / 5.0), 0.0) ** 2
    path = plant.FourierTrajectory(ROBOT, base_frequency=1 / 15, seed=seed)
    q, dq, ddq = path.at(np.cumsum(pace) * 0.001)
    change = np.gradient(pace, t)[:, None]
    motion = q, dq * pace[:, None], ddq * pace[:, None] ** 2 + dq * change
    return plant.measure_along(arm, t, *motion, sensors=plant.demo_sensors(ROBOT), seed=seed)


def test_errors_of_every_row_are_those_of_a_fit_of_its_model():
    """Of all samples, as of the first and last model, but for the weights, of the final fit.

    Falls are in motion, which has breaks.
    """
    hidden = ("load_friction", 0, 2.0), ("viscous_polynomial", 1, 10.0)
    train, test = (with_breaks(arm_with(*hidden), seed) for seed in (1, 2))
    diagnosis = lieid.diagnose(MODEL, train, test)
    assert {s.label for s in diagnosis.steps} == {"load_friction:1", "viscous_polynomial:2"}

    def with_effects(*labels):
        return lieid.Model(ROBOT, ["coulomb", "viscous", "offset", *labels])

    added, processing = [], diagnosis.fit.processing
    for step in diagnosis.steps:
        added.append(step.label)
        fit = lieid.identify(with_effects(*added), train, processing=processing)
        compared = lieid.compare(fit, test)
        assert compared.rms[0] > 1.2 * compared.rms_moving[0]  # friction is not known at rest
        np.testing.assert_allclose(step.errors["rms_train"], fit.rms_train, rtol=5e-2)
        np.testing.assert_allclose(step.errors["rms_test"], compared.rms, rtol=5e-2)
        moving = step.errors["rms_test_moving"]
        assert moving[0] == pytest.approx(compared.rms_moving[0], rel=5e-2)
        (other,) = {s.label for s in diagnosis.steps} - {step.label}
        without = lieid.identify(with_effects(other), train, processing=processing)
        before, after = (
            lieid.compare(f, train).rms_moving[step.joint] for f in (without, diagnosis.fit)
        )
        assert step.fall.train == pytest.approx(before - after, rel=0.2)


def test_errors_after_a_fit_are_those_of_a_comparison():
    fit = lieid.identify(MODEL, with_breaks(arm_with(), 1))
    more = arm_with().with_effects(plant.ForeignTorque(0, lambda s: 1.5 * s.sign[..., 0]))
    new = with_breaks(more, 2)
    diagnosis = lieid.diagnose(fit, new)
    (step,) = diagnosis.steps
    assert step.label == "coulomb:1"
    parameters, k = fit.parameters.copy(), [p.label for p in MODEL.columns].index("coulomb.f_c:1")
    parameters[10 * MODEL.n + k] += step.parameters["f_c"]
    values = MODEL.base.combination @ parameters
    before, after = (
        lieid.compare(f, new) for f in (fit, replace(fit, parameters=parameters, values=values))
    )
    assert before.rms[0] < 0.95 * before.rms_moving[0]
    for errors, compared in ((diagnosis.baseline, before), (step.errors, after)):
        np.testing.assert_allclose(errors["rms_test"], compared.rms, rtol=5e-2)
        np.testing.assert_allclose(errors["rms_test_moving"], compared.rms_moving, rtol=1e-6)
    assert (step.before, step.after) == pytest.approx(
        (before.rms_moving[0], after.rms_moving[0]), rel=1e-6
    )


@pytest.mark.parametrize("seed", [10, 20, 30])
def test_nothing_hidden_is_sufficient(seed):
    diagnosis = diagnosis_of(seed=seed)
    assert diagnosis.steps == ()
    assert diagnosis.verdict == "sufficient"


def test_a_robot_stands_for_its_model_without_effects():
    """Two effects of its path have the same simplest rival, which is added once."""
    diagnosis = lieid.diagnose(ROBOT, sines(stribeck_arm()))
    labels = [step.label for step in diagnosis.steps]
    assert labels
    assert len(set(labels)) == len(labels)
    assert all(
        after < before
        for after, before in zip(diagnosis.fit.rms_cv, diagnosis.baseline["rms_cv"], strict=True)
    )


def test_a_torque_that_is_no_effect_is_a_smooth_function_of_its_signals():
    arm = plant.demo_arm(ROBOT, hidden=None)
    size = 0.2 * float(plant.torque_scale(ROBOT)[1])
    odd = plant.ForeignTorque(1, lambda s: size * np.sin(2.0 * s.q[..., 0]))
    arm = arm.with_effects(odd)
    train = [run(arm, seed, f"run {seed}") for seed in (1, 3, 4)]
    diagnosis = lieid.diagnose(MODEL, train, run(arm, 2))
    shapes = [step for step in diagnosis.steps if step.status == "shape"]
    assert [step.effect for step in diagnosis.steps] == ["smooth"] * len(shapes)
    assert shapes[0].depends_on == ("q1",)
    assert shapes[0].joints == (1,)
    assert shapes[0].confirmed
    amplitude, _, rest = shapes[0].formula.partition("·")
    assert rest.startswith("sin(2·q1)")
    assert float(amplitude) == pytest.approx(size, rel=0.1)
    again = lieid.identify(
        lieid.Model(ROBOT, ",".join(diagnosis.fit.model.effects)),
        train,
        processing=diagnosis.fit.processing,
    )
    np.testing.assert_array_equal(again.values, diagnosis.fit.values)


@given(strong=st.lists(st.floats(2.0, 6.0), max_size=8), candidates=st.integers(10, 300))
@example(strong=[3.2], candidates=300)  # both kinds of evidence suffice for a name, neither here
def test_effects_that_remain_have_the_stated_part_of_false_ones(strong, candidates):
    """Gain and coefficients count by their geometric mean, in Benjamini-Hochberg's procedure."""
    placements = [Placement(make("stribeck"), k % 2) for k in range(len(strong))]
    left = [
        SimpleNamespace(
            candidate=Candidate(placement, np.zeros((1, 0))),
            placement=SimpleNamespace(label=str(k)),
            evidence=SimpleNamespace(gain_certainty=value**2 / coefficients),
            coefficient_deviations=lambda fit, coefficients=coefficients: coefficients,
            value=value,
        )
        for k, (placement, value) in enumerate(zip(placements, strong, strict=True))
        for coefficients in [max(2.0, 0.8 * value) if k % 2 else 1.2 * value]
    ]
    search = SimpleNamespace(options=DiagnosisOptions(), candidates=range(candidates))
    while out := gates.undetermined_effect(gates.State(search, None, tuple(left))):
        assert all(each.deviations < 3.0 for each in out.values())  # more data may change it
        left = [a for a in left if a.placement.label not in out]
    others = [1.0] * (candidates - len(strong))
    rates = false_discovery_control([*(2.0 * norm.sf(x) for x in strong), *others])
    expected = [x for x, rate in zip(strong, rates, strict=False) if rate <= 0.1]
    assert [a.value for a in left] == expected


@pytest.mark.parametrize(
    ("rivals", "asked", "left"),
    [
        ((), [], ["torque_ripple:1"]),
        (("stribeck:1",), [], ["torque_ripple:1"]),  # not among the candidates
        (("coulomb:2", "presliding:2"), ["coulomb:2"], ["coulomb:2", "torque_ripple:1"]),
        (("time_shift", "presliding:2"), ["presliding:2"], ["presliding:2", "torque_ripple:1"]),
        (("viscous:2",), ["viscous:2"], ["torque_ripple:1"]),  # the user rejects it
        (("viscous:2", "coulomb:2"), ["viscous:2", "coulomb:2"], ["coulomb:2", "torque_ripple:1"]),
    ],
)
def test_the_nearest_rival_stands_for_an_effect_that_is_implausible(rivals, asked, left):
    def agree(label, joint, errors):
        questions.append(label)
        return label != "viscous:2"

    questions = []
    joints = {"time_shift": (), "stribeck:1": (0,)}
    stated = [Rival(r, r.partition(":")[0], joints.get(r, (1,)), "data") for r in rivals]
    kept, refused = accepted_as("torque_ripple:1"), accepted_as("stribeck:2", *stated)
    state = searched(refused, "coulomb:2", "viscous:2", "presliding:2", "time_shift", agree=agree)
    found = gates.plausible(state, [refused, kept])
    assert found.fit == [a.placement.label for a in found.accepted] == left
    assert questions == asked
    assert found.refused == {"stribeck:2"}
    assert not state.refused


def test_one_delay_or_filter_of_a_torque_is_searched_for():
    """Of two a fit may leave either; rivals are compared in the place of the one that is found."""
    labels = "torque_delay:2", "torque_delay:1", "torque_lowpass/common", "time_shift", "stribeck:2"
    tried = candidates_of(*labels).values()
    one = replace(searched(None), accepted=(accepted_as("torque_lowpass:2"),))
    assert [c.label for c in tried if one.wants(c)] == ["torque_delay:1", "stribeck:2"]
    whole = replace(one, accepted=(accepted_as("time_shift"),))
    assert [c.label for c in tried if whole.wants(c)] == ["stribeck:2"]


def test_nothing_more_stands_for_an_effect_that_is_implausible_again():
    stated = [Rival(r, r.partition(":")[0], (1,), "data") for r in ("coulomb:2", "presliding:2")]
    first, again = accepted_as("coulomb:2"), accepted_as("stribeck:2", *stated)
    state = searched(again, "coulomb:2", "presliding:2", agree=lambda *_: True)
    found = gates.plausible(replace(state, refused=frozenset({"stribeck:2"})), [first, again])
    assert found.fit == ["coulomb:2"]


def test_effects_return_where_the_form_in_their_place_is_implausible():
    viscous, ripple = accepted_as("viscous_polynomial:1"), accepted_as("torque_ripple:2")
    form = replace(accepted_as("stribeck/exponent:1"), replaced=(viscous,))
    found = gates.plausible(searched(form), [form, ripple])
    assert found.accepted == (viscous, ripple)
    assert found.fit == ["viscous_polynomial:1", "torque_ripple:2"]
    assert found.refused == {"stribeck/exponent:1"}


def test_effects_return_where_the_form_in_their_place_is_not_needed(monkeypatch):
    def not_needed(state):
        leaving = gates.Rejection("not needed")
        return {form.placement.label: leaving} if form in state.accepted else {}

    viscous, ripple = accepted_as("viscous_polynomial:1"), accepted_as("torque_ripple:2")
    form = replace(accepted_as("stribeck/exponent:1"), replaced=(viscous,))
    monkeypatch.setattr(gates, "GATES", (not_needed,))
    found = gates.passed(replace(searched(None), accepted=(ripple, form)))
    assert found.accepted == (ripple, viscous)
    assert found.fit == ["torque_ripple:2", "viscous_polynomial:1"]
    assert found.rejected["stribeck/exponent:1"].reason == "not needed"


def test_an_effect_that_returns_for_two_others_is_fitted_once():
    viscous, ripple = accepted_as("viscous_polynomial:1"), accepted_as("torque_ripple:2")
    found = gates.plausible(searched(None), [viscous, ripple, replace(viscous, replaced=(ripple,))])
    assert found.fit == ["viscous_polynomial:1", "torque_ripple:2"]


def test_an_effect_is_tried_again_beside_what_the_next_round_finds(monkeypatch):
    """Alone it had taken over another torque, by which its values were implausible."""

    hidden = ("load_friction", 0, 1.5), ("viscous_polynomial", 1, 10.0)
    rounds, search = [], missing.search

    def first_without(rows, options, *, wanted, **how):
        rounds.append(wanted)
        other = "viscous_polynomial:2" if len(rounds) == 1 else ""
        return search(rows, options, wanted=lambda c: wanted(c) and c.label != other, **how)

    def implausible(self, fit, found):
        alone = "viscous_polynomial:2" not in fit.model.effects
        return "implausible" if alone and found.placement.label == "load_friction:1" else None

    monkeypatch.setattr(missing, "search", first_without)
    monkeypatch.setattr(gates.Search, "reason_against", implausible)
    diagnosis = lieid.diagnose(MODEL, *two_runs(*hidden))
    assert len(rounds) == 2
    assert {s.label for s in diagnosis.steps} == {"load_friction:1", "viscous_polynomial:2"}


def searched(implausible, *labels, agree=None):
    """Return the state of a search whose fits are the labels of effects."""

    def labels_of(added):
        return [a.placement.label for a in added]

    shared = SimpleNamespace(
        candidates=candidates_of(*labels),
        agreed=agree,
        fitted=labels_of,
        complete=labels_of,
        reason_against=lambda fit, a: "implausible" if a is implausible else None,
    )
    return gates.State(shared, None)


def test_noise_exceeds_deviations_of_coefficients_as_often_as_a_normal_number():
    """Of three coefficients, whose covariance is known by ten independent stretches."""
    random = np.random.default_rng(3)
    root = random.normal(size=(3, 3))
    covariance, stretches, draws = root @ root.T, 10, 20_000
    values = random.normal(size=(draws, 3)) @ root.T
    known = random.chisquare(stretches, draws) / stretches
    found = [
        evidence.coefficient_deviations(v, k * covariance, stretches, 1.0)
        for v, k in zip(values, known, strict=True)
    ]
    for limit in (1.0, 2.0, 3.0):
        expected = 2.0 * norm.sf(limit)
        error = np.sqrt(expected / draws)
        assert np.mean(np.array(found) > limit) == pytest.approx(expected, abs=4.0 * error)
    known = evidence.coefficient_deviations(np.array([3.0]), np.eye(1), 1e9, 1.0)
    assert known == pytest.approx(3.0)


def test_rounding_beside_a_combination_that_is_not_determined_hides_no_coefficient():
    """Of a spline whose ends the data do not reach; the smallest variance is rounding."""
    axes = np.linalg.qr(np.random.default_rng(2).normal(size=(4, 4)))[0]
    covariance = axes * [2e4, 1e-4, 1e-4, -3e-4] @ axes.T
    assert evidence.coefficient_deviations(axes @ [0.0, 1.0, 1.0, 9.0], covariance, 1e3, 1.0) > 20.0
    assert (
        evidence.coefficient_deviations(axes @ [100.0, 0.0, 0.0, 0.0], covariance, 1e3, 1.0) < 1.0
    )


def test_a_ripple_in_noise_is_the_best_of_all_orders_that_were_tried():
    """Of white noise the largest fall at any order exceeds a limit as often as is stated."""
    recording = run(arm_with(), 1)
    fit = lieid.identify(MODEL, recording)
    segments = process([recording], fit.processing)
    rows, effect = Rows.of(fit, segments, with_candidates=False), make("torque_ripple")
    (signals,), angle = rows.signals, rows.signals[0].values["q"][:, 0]
    angle = angle[signals.segment.kept][rows.runs[0].all]
    random, tails = np.random.default_rng(5), []
    for _ in range(150):
        noise = random.normal(size=len(angle))
        grid, tried = scan_peaks(effect, 0, rows.signals, rows.runs[0], noise, rows.store)
        waves = [np.column_stack([np.sin(k * angle), np.cos(k * angle)]) for k in grid[:, 0]]
        largest = max(float(np.sum((np.linalg.qr(w)[0].T @ noise) ** 2)) for w in waves)
        value = np.array([np.sqrt(largest), 0.0])  # of two coefficients in standard deviations
        tails.append(evidence.coefficient_deviations(value, np.eye(2), 1e9, tried))
    assert tried > 10.0
    for limit in (1.0, 2.0):
        expected = 2.0 * norm.sf(limit)
        assert 0.3 * expected < np.mean(np.array(tails) > limit) < 2.0 * expected


def test_a_hysteresis_narrower_than_a_sample_at_rest_resolves_is_refused():
    """Dry friction that builds up sooner reverses at another instant, as late friction does."""
    recording = two_runs(LOAD_FRICTION)[0]
    segments = process([recording], lieid.identify(MODEL, recording).processing)
    candidate = Candidate(Placement(make("presliding"), 0), np.zeros((1, 1)))
    sample = max(s.dead_zone[0] / s.rate for s in segments)  # rad, at the speed of the dead zone
    assert 2.9 * sample > 1.03e-4  # the least width of the effect itself
    for samples, resolved in ((2.9, False), (3.1, True)):
        reason = unresolved_shape(
            candidate, np.array([samples * sample]), np.array([1.0]), segments
        )
        assert (reason is None) == resolved
    assert shape_grid(candidate.effect, segments, 0).min() < 6.0 * sample  # narrow ones compete


def test_a_deflection_between_two_counts_of_the_encoder_is_refused():
    """Though the recorded velocity is finer."""
    count, whole = 4e-4, run(arm_with(), 1)
    coarse = replace(whole, q=count * np.round(whole.q / count))
    fit = lieid.identify(MODEL, whole)
    (segment,) = process([coarse], fit.processing)
    (placement,) = place("presliding:1", 2)
    candidate, one = Candidate(placement, np.array([[count]])), np.ones(1)
    reasons = [
        unresolved_shape(candidate, np.array([w]), one, [segment]) for w in (1.5 * count, 0.02)
    ]
    assert reasons == ["w = 0.0006 rad is below what this motion can resolve", None]


def test_an_effect_needs_evidence_together_and_its_name_each(monkeypatch):
    train = two_runs(("stribeck", 0, 1.0))[0]
    (step,) = lieid.diagnose(MODEL, train).steps
    ratio = step.parameters["f_s-f_c"] / step.std["f_s-f_c"]
    assert step.status == "named"
    tail = student.sf(ratio, step.evidence.independent)  # of one coefficient
    assert step.evidence.coefficient_deviations == pytest.approx(norm.isf(tail), rel=1e-9)
    monkeypatch.setattr(Accepted, "coefficient_deviations", lambda self, fit: 2.75)
    assert step.evidence.gain_certainty > 3.0
    doubtful = lieid.diagnose(MODEL, train)
    assert [(s.label, s.status, s.rivals) for s in doubtful.steps] == [(step.label, "one_of", ())]
    assert "it is only 2.8 standard deviations from zero" in doubtful.sentences[0]
    assert doubtful.to_dict()["steps"][0]["evidence"]["coefficient_deviations"] == 2.75
    text = "its coefficients are 2.8 standard deviations from zero"
    for least, false_effects, expected, known in (
        (2.9, 0.1, f"{text} (limit 2.9)", 2.75),
        (2.0, 0.0, f"standard errors and {text} (geometric mean, limit inf)", 0.0),
    ):
        monkeypatch.setattr(evidence, "FALSE_EFFECTS", false_effects)
        options = DiagnosisOptions(gain_deviations=least)
        without = lieid.diagnose(MODEL, train, options=options)
        assert without.steps == ()
        assert dict(without.rejected)[step.label].endswith(expected)
        assert dict(without.undecided)[step.label] == known  # more data would decide


@pytest.mark.parametrize(
    ("function", "rival"),
    [
        ("tau2", True),
        ("dq2", True),
        ("dq.dq2", True),
        ("dq", False),
        ("q2", False),
        ("tau3", False),
    ],
)
def test_functions_of_the_signals_of_its_cause_are_rivals_of_a_coupling(function, rival):
    coupling, smooth = (
        Candidate(placed, np.zeros((1, 0)))
        for placed in (
            Placement(make("transmission_coupling"), 0, source=1),
            Placement(make(f"smooth/{function}"), 0),
        )
    )
    assert rivals._same_kind(coupling, smooth) != rival
    assert not rivals._same_kind(smooth, coupling)


def test_a_sentence_states_the_joint_whose_error_falls_if_it_is_another_than_the_effects():
    (step,) = lieid.diagnose(MODEL, two_runs(("stribeck", 0, 1.0))[0]).steps
    here, there = (finding([replace(step, joint=j)], "missing") for j in (0, 1))
    assert "held-out error" in here
    assert "held-out error of joint" not in here
    assert "of the held-out error of joint 2" in there
    both = [step, replace(step, joints=(1,), joint=0, label="stribeck:2")]
    assert "of the held-out error of joint 1" in finding(both, "missing")


def test_a_smooth_function_leaves_the_name_of_an_earlier_larger_effect():
    (step,) = lieid.diagnose(MODEL, two_runs(("stribeck", 0, 1.0))[0]).steps
    effect = replace(step, before=3.0, after=1.0)
    shape = replace(step, label="smooth/dq:1", status="shape", before=1.5, after=1.0)
    larger = replace(shape, before=3.5)
    for steps in ((effect, shape), (effect, replace(larger, joint=1))):
        assert [s.status for s in beside_smooth_functions(steps)] == ["named", "shape"]
    for steps in ((effect, larger), (shape, effect)):
        assert {s.status for s in beside_smooth_functions(steps)} == {"one_of", "shape"}
    doubtful, _ = beside_smooth_functions([effect, larger])
    assert "; its form is not certain beside the function smooth/dq" in finding(
        [doubtful], "missing"
    )


@pytest.mark.parametrize(
    ("size", "ratio", "status"), [(0.1, 9.0, "one_of"), (0.1, 1.0, "named"), (0.3, 9.0, "named")]
)
def test_an_effect_that_explains_less_than_is_left_is_not_certain(size, ratio, status, monkeypatch):
    monkeypatch.setattr(missing, "over_floor", lambda _: np.full(ROBOT.n, ratio))
    train = two_runs(("stribeck", 0, size))[0]
    options = DiagnosisOptions(name_deviations=0.0, rival_deviations=-1e3)
    found = lieid.diagnose(MODEL, train, options=options)
    (step,) = found.steps
    assert (step.before**2 > 2.0 * step.after**2) == (size > 0.2)
    assert step.status == status
    text = "more than it explains of the error is left unexplained"
    assert any(text in sentence for sentence in found.sentences) == (status == "one_of")


@pytest.mark.parametrize(
    ("size", "largest", "status"),
    [(0.2, 0.01, "one_of"), (0.2, 1.5, "named"), (0.5, 0.01, "named")],
)
def test_a_change_that_explains_less_than_is_left_is_not_certain(size, largest, status):
    fit = lieid.identify(MODEL, run(arm_with(), 1))
    options = DiagnosisOptions(
        name_deviations=0.0, rival_deviations=-1e3, largest_error=largest, worth_of_change=0.01
    )
    found = lieid.diagnose(fit, run(arm_with(("viscous_asymmetric", 0, size)), 2), options=options)
    (step,) = found.steps
    assert (step.before**2 > 2.0 * step.after**2) == (size > 0.3)
    assert step.status == status


def test_smooth_functions_are_chosen_beside_the_path(monkeypatch):
    """A refined grid numbers groups anew: those of the path are not the same numbers of later."""

    def compared(rows, span, residuals, spread, *, whole):
        np.testing.assert_allclose(rows.spread(residuals[0]), spread, rtol=1e-9)
        raise KeyError

    monkeypatch.setattr(search, "smooth_candidates", compared)
    with pytest.raises(KeyError):
        diagnosis_of(("stribeck", 0, 2.0), ("load_friction", 1, 2.0), seed=5)


def test_functions_come_first_beside_held_out_parts_where_they_need_not(monkeypatch):
    """Without a part many effects of the library stand in the place of the same function."""
    alike, places = [], []
    judged, forward = search._judged, search.forward

    def seen(paths, chosen, *others):
        joints = {paths.columns.candidate(g).joint for g in chosen[0] if others[0].smooth[g]}
        alike.append(joints if set(chosen[0]) == set(chosen[1]) else set())
        return judged(paths, chosen, *others)

    def along(paths, part, rules, *, smooth_first=()):
        if alike and alike[-1] and part >= 0:
            places.append(alike[-1] == set(smooth_first))
        return forward(paths, part, rules, smooth_first=smooth_first)

    monkeypatch.setattr(search, "_judged", seen)
    monkeypatch.setattr(search, "forward", along)
    torque = plant.ForeignTorque(1, lambda s: 0.5 * np.sign(s.q[..., 0] - 0.3))
    lieid.diagnose(MODEL, run(arm_with().with_effects(torque), 1))
    assert places
    assert all(places)


@pytest.mark.parametrize(("joint", "other", "gain"), [(1, 0, 0.1), (0, 1, 0.3)])
def test_cross_talk_of_torque_sensors_is_a_function_of_the_other_joints_torque(joint, other, gain):
    """The columns of joint 1 alone contain much of joint 2's load: links act on both."""

    def torque(s):
        of = arm.friction
        return gain * (s.load + of.coulomb * s.sign + of.viscous * s.dq + of.offset)[..., other]

    arm = arm_with()
    sensed = arm.with_effects(plant.ForeignTorque(joint, torque))
    (step,) = lieid.diagnose(MODEL, run(sensed, 1), run(sensed, 2)).steps
    assert step.label == f"smooth/tau{other + 1}:{joint + 1}"
    assert f"depends on the torque of joint {other + 1}" in finding([step], "missing")
    before = lieid.compare(lieid.identify(MODEL, run(sensed, 1)), run(sensed, 2)).rms[joint]
    assert step.errors["rms_test"][joint] < 0.5 * before
    (changed,) = lieid.diagnose(lieid.identify(MODEL, run(arm, 1)), run(sensed, 2)).steps
    assert (changed.label, changed.status) == (step.label, "shape")


@pytest.mark.parametrize("joints", [2, 3])
def test_a_function_pays_for_how_many_functions_are_tried(joints):
    """Chen and Chen 2008: log of the number of alternatives, twice, beside those of parameters."""
    robot = random_arm(np.random.default_rng(1), joints, mixed=False)
    arm = plant.Arm(robot, robot.link_parameters, plant.JointFriction(*np.full((3, joints), 0.5)))
    fit = lieid.identify(lieid.Model(robot, "coulomb,viscous"), recorded(arm, 1, seconds=8.0))
    segments = process([recorded(arm, 1, seconds=8.0)], fit.processing)
    rows = Rows.of(fit, segments, with_candidates=False)
    own, others = ["q", "dq", "ddq", "load"], [f"{x}{joints}" for x in ("q", "dq", "load")]
    others += [f"{x}2" for x in ("q", "dq", "load")] if joints == 3 else []
    torques = joints - 1  # of other joints, each a signal that stands alone
    pairs = list(combinations(own + others, 2))
    owners = [
        Candidate(Placement(make("armature"), 0), np.zeros((1, 0))),
        Candidate(Placement(make("transmission_coupling"), 0, source=1), np.zeros((1, 0))),
        *(
            smooth_functions._candidate(rows, signals, 0, whole=False)
            for signals in (("q",), (f"q{joints}",), ("q", "dq"), ("q", f"load{joints}"))
        ),
    ]
    of_joint = sum(set(pair) <= set(own) for pair in pairs)
    alike = [1, joints - 1, len(own), len(others) + torques, of_joint, len(pairs) - of_joint]
    rows = rows.with_candidates(owners)
    penalty = search._rules(rows.columns, rows, DiagnosisOptions()).penalty
    cost = rows.columns.parameters * np.log(rows.runs[0].count)
    np.testing.assert_allclose(penalty, cost + 2.0 * np.log(alike))


def test_a_delay_that_resembles_late_friction_is_added_without_a_certain_name():
    arm = arm_with().with_effects(plant.TorqueDelay(1, delay=0.006))
    diagnosis = lieid.diagnose(MODEL, run(arm, 1), run(arm, 2))
    (step,) = diagnosis.steps
    assert (step.label, step.status) == ("torque_delay:2", "one_of")
    assert step.parameters["delta"] == pytest.approx(0.006, abs=0.001)
    assert step.errors["rms_test"][1] < 0.97 * diagnosis.baseline["rms_test"][1]
    assert any(isinstance(w, LateFrictionWarning) for w in diagnosis.warnings)
    alone = replace(diagnosis, steps=(replace(step, rivals=()),))
    assert "a joint that sticks for a moment at each reversal may look the same" in alone.sentence


def test_a_torque_that_leads_one_joint_has_no_certain_name():
    """Drives are late, not early; LuGre's friction, imitated by two effects, left such a torque."""
    arm = arm_with().with_effects(plant.TorqueDelay(1, delay=-0.03))
    diagnosis = lieid.diagnose(MODEL, run(arm, 1), run(arm, 2))
    (step,) = diagnosis.steps
    assert (step.label, step.status, step.rivals) == ("torque_delay:2", "one_of", ())
    assert step.parameters["delta"] == pytest.approx(-0.03, abs=0.002)
    assert step.evidence.certainty > 3.0
    assert "friction of another form at reversals may look the same" in diagnosis.sentence


def test_friction_that_changes_at_one_instant_is_no_warm_up():
    """A gradual change is one; a sudden one, which is no effect of the library, looks similar."""
    gradual = plant.WarmUp(0, change=-0.6, time_constant=4.0)
    sudden = plant.ForeignTorque(
        0, function=lambda s: -0.6 * np.where(s.t > 6.0, 1.0, 0.0) * np.sign(s.dq[..., 0])
    )
    found = []
    for hidden in (gradual, sudden):
        arm = plant.demo_arm(ROBOT, hidden=None).with_effects(hidden)
        found.append(lieid.diagnose(MODEL, [run(arm, 1, "one"), run(arm, 2, "two")]))
    of_gradual, of_sudden = found
    assert ("warm_up:1", "named") in [(s.label, s.status) for s in of_gradual.steps]
    assert not of_gradual.differing
    assert not of_sudden.steps
    (change,) = of_sudden.differing
    assert (change.label, change.recording) == ("coulomb:1", "each recording")
    assert change.since == pytest.approx(6.0, abs=0.5)
    assert change.parameters["f_c"] < -0.3  # beside the rest of the path


def spot(q, place, width):
    return 1.0 / (1.0 + ((q[..., 1] - place) / width) ** 2)


@pytest.mark.parametrize(
    ("torque", "labels", "remains"),
    [
        # three effects of the library imitate an end stop, none of which helps much
        (lambda s: 3.0 * np.maximum(s.q[..., 1] - 0.5, 0.0), ["smooth/q:2"], 0.3),
        # a ripple would make the spline of a bump finer
        (lambda s: 1.5 * spot(s.q, -0.4, 0.15), ["smooth/q:2"], 0.9),
        (lambda s: 2.0 * np.sin(4.0 * s.q[..., 1]) * s.dq[..., 1], ["smooth/q.dq:2"], 0.5),
        (
            lambda s: s.sign[..., 1] * spot(s.q, -0.4, 0.2),
            ["position_friction:2", "smooth/q.dq:2"],
            0.9,
        ),
    ],
    ids=["end stop", "bump", "friction along a turn", "rough spot"],
)
def test_a_torque_of_the_own_signals_is_one_smooth_function(torque, labels, remains):
    arm = arm_with().with_effects(plant.ForeignTorque(1, function=torque))
    diagnosis = lieid.diagnose(MODEL, run(arm, 1), run(arm, 2))
    assert diagnosis.steps[0].label in labels
    assert len(diagnosis.steps) == 1 or labels[0] != "smooth/q:2"
    before, after = (e["rms_test"][1] for e in (diagnosis.baseline, diagnosis.steps[-1].errors))
    assert after < remains * before


def test_an_effect_has_no_certain_form_where_a_function_of_its_signals_is_better():
    def rough(s):
        return s.sign[..., 1] * spot(s.q, -0.4, 0.2)

    odd = arm_with().with_effects(plant.ForeignTorque(1, rough))
    (found,) = lieid.diagnose(MODEL, run(odd, 1)).steps
    assert (found.label, found.status) == ("position_friction:2", "one_of")
    assert [rival.label for rival in found.rivals] == ["smooth/q.dq:2"]
    known = ("position_friction", 1, 2.0)
    (step,) = lieid.diagnose(MODEL, run(arm_with(known), 1)).steps
    assert (step.label, step.status, step.rivals) == ("position_friction:2", "named", ())


@pytest.mark.parametrize("speed", [0.6, pytest.param(1.0, marks=pytest.mark.slow)])
def test_friction_with_a_peak_at_one_speed_is_a_smooth_function_of_the_velocity(speed):
    size = float(plant.torque_scale(ROBOT)[0])

    def peak(s):
        v = s.dq[..., 0]
        return size * np.sign(v) * np.exp(-(((np.abs(v) / speed - 1.0) / 0.25) ** 2))

    arm = arm_with().with_effects(plant.ForeignTorque(0, peak))
    train = [run(arm, seed, scale=0.8) for seed in (1, 3)]
    (step,) = lieid.diagnose(MODEL, train, run(arm, 2)).steps
    assert step.label == "smooth/dq:1"
    before = lieid.compare(lieid.identify(MODEL, train), run(arm, 2)).rms[0]
    assert step.errors["rms_test"][0] < 0.35 * before


@pytest.mark.parametrize("speed", [0.1, pytest.param(0.2, marks=pytest.mark.slow), 0.4])
def test_another_form_of_friction_over_speed_is_in_the_place_of_what_imitates_it(speed):
    """Friction that falls as e^{−|q̇|/v}, neither Gaussian nor a polynomial of the velocity."""
    size = 0.4 * float(plant.torque_scale(ROBOT)[0])
    odd = plant.ForeignTorque(
        0, lambda s: size * np.tanh(s.dq[..., 0] / 0.005) * np.exp(-np.abs(s.dq[..., 0]) / speed)
    )
    arm = arm_with().with_effects(odd)
    diagnosis = lieid.diagnose(MODEL, run(arm, 1), run(arm, 2))
    (step,) = diagnosis.steps
    assert step.label == "stribeck/exponent:1"
    expected = {"f_s-f_c": size, "v_s": speed, "delta_s": 1.0}
    assert step.parameters == pytest.approx(expected, rel=0.1)


def test_the_user_is_asked_about_each_effect_once():
    def ask(proposal):
        asked.append(proposal.label)
        assert proposal.after < proposal.before
        return proposal.label != "load_friction:1"

    asked = []
    train, _ = two_runs(LOAD_FRICTION, ("torque_ripple", 1, 3.0), seed=10)
    diagnosis = lieid.diagnose(MODEL, train, ask=ask)
    assert {"load_friction:1", "torque_ripple:2"} <= set(asked)
    assert len(set(asked)) == len(asked)
    labels = [step.label for step in diagnosis.steps]
    assert "torque_ripple:2" in labels
    assert "load_friction:1" not in labels
    assert dict(diagnosis.rejected)["load_friction:1"] == "rejected by the user"


def test_the_user_is_asked_before_another_form_takes_the_place_of_effects():
    size = 0.4 * float(plant.torque_scale(ROBOT)[0])
    odd = plant.ForeignTorque(
        0, lambda s: size * np.tanh(s.dq[..., 0] / 0.005) * np.exp(-np.abs(s.dq[..., 0]) / 0.4)
    )
    asked = []

    def ask(proposal):
        asked.append(proposal)
        return "/exponent" not in proposal.label

    diagnosis = lieid.diagnose(MODEL, run(arm_with().with_effects(odd), 1), ask=ask)
    (form,) = (proposal for proposal in asked if "/exponent" in proposal.label)
    assert form.joint == 0
    labels = {step.label for step in diagnosis.steps}
    assert labels
    assert not any("/exponent" in label for label in labels)
    assert not labels & {effect for effect, _ in diagnosis.rejected}


def test_effects_whose_gain_is_not_certain_are_undecided():
    """With a limit of 50 standard errors no gain of this recording is certain."""
    options = DiagnosisOptions(gain_deviations=50.0)
    diagnosis = lieid.diagnose(MODEL, sines(stribeck_arm()), options=options)
    assert diagnosis.steps == ()
    deviations = dict(diagnosis.undecided)["stribeck:1"]
    reason = dict(diagnosis.rejected)["stribeck:1"]
    assert (
        reason
        == f"the gain on held-out parts is {deviations:.1f} of its standard errors (limit 50)"
    )


def test_an_effect_whose_gain_is_doubtful_is_added_without_a_name(monkeypatch):
    monkeypatch.setattr(Accepted, "coefficient_deviations", lambda self, fit: 1e6)
    certain = diagnosis_of(LOAD_FRICTION)
    doubtful = lieid.diagnose(
        MODEL, *two_runs(LOAD_FRICTION), options=DiagnosisOptions(name_deviations=1000.0)
    )
    (named,), (step,) = certain.steps, doubtful.steps
    assert (step.label, step.parameters) == (named.label, named.parameters)
    assert (named.status, step.status, step.rivals) == ("named", "one_of", ())
    text = f"its gain is certain to only {step.evidence.gain_certainty:.1f} standard errors"
    assert any(text in sentence for sentence in doubtful.sentences)


def test_a_smooth_function_leaves_gravity_to_the_links():
    """A function of an angle resembles gravity: what the data do not decide must not be large."""
    stop = plant.ForeignTorque(0, lambda s: 8.0 * np.maximum(s.q[..., 0] - 0.5, 0.0))
    arm = arm_with().with_effects(stop)
    plain, fit = (
        lieid.identify(lieid.Model(ROBOT, ["coulomb", "viscous", "offset", *more]), run(arm, 1))
        for more in ((), ("smooth/q:1",))
    )
    values = dict(zip([p.name for p in fit.fitted], fit.values, strict=False))
    assert all(abs(v) < 5.0 for name, v in values.items() if name.startswith("smooth"))
    before, after = (lieid.compare(f, run(arm, 2)).rms_moving[0] for f in (plain, fit))
    assert after < 0.3 * before


@pytest.mark.parametrize(
    ("torque", "signals"),
    [
        (lambda s: 2.0 * np.sin(0.8 * s.t), ("t",)),
        (lambda s: 2.0 * np.sin(2.0 * s.q[..., 1]), ("q2",)),
        (lambda s: 2.0 * s.dq[..., 0] * s.dq[..., 1], ("dq1", "dq2")),
        (lambda s: 2.0 * (s.t > 8.0) * s.sign[..., 0], ("t", "dq1")),
    ],
)
def test_the_signals_that_an_error_follows_are_stated(torque, signals):
    recording = run(arm_with().with_effects(plant.ForeignTorque(0, function=torque)), 1)
    fit = lieid.identify(MODEL, recording)
    segments = process([recording], fit.processing)
    rows = Rows.of(fit, segments, with_candidates=False)
    spread = rows.spread()
    assert followed_signals(rows, rows.span(spread), 0, spread) == signals


def test_json_has_the_stated_keys():
    content = diagnosis_of(LOAD_FRICTION).to_dict()
    json.dumps(content, allow_nan=False)
    assert {"mode", "verdict", "noise_floor", "baseline", "steps", "unexplained"} <= set(content)
    errors = {"rms_train", "rms_cv", "rms_test", "rms_test_moving"}
    assert set(content["baseline"]) == {"effects"} | errors
    (step,) = content["steps"]
    assert step["effect"] == "load_friction"
    assert step["joints"] == [1]
    assert len(step["rms_test"]) == 2
    assert isinstance(step["indistinguishable"], list)
    assert content["mode"] == "missing"
    assert 0.0 < step["share"] < 1.0
    assert (step["confirmed"], step["group"]) == (True, 1)


def test_without_a_test_errors_are_cross_validated():
    train, _ = two_runs(LOAD_FRICTION)
    diagnosis = lieid.diagnose(MODEL, train)
    assert [s.label for s in diagnosis.steps] == ["load_friction:1"]
    assert diagnosis.baseline["rms_test"] is None
    assert diagnosis.steps[0].confirmed is None
    measured, errors = diagnosis.shown
    assert measured == "held-out training data, joints in motion"
    np.testing.assert_array_equal(errors[-1], diagnosis.fit.rms_cv)
    content = diagnosis.to_dict()
    assert content["baseline"]["rms_cv"][0] > 2.0 * content["steps"][0]["rms_cv"][0]


def test_a_training_recording_as_the_test_is_a_warning():
    train, _ = two_runs()
    diagnosis = lieid.diagnose(MODEL, train, train)
    assert any(isinstance(w, SameRecordingWarning) for w in diagnosis.warnings)


def test_the_same_seed_gives_the_same_result():
    hidden = ("stribeck", 0, 2.0)
    again = lieid.diagnose(MODEL, *two_runs(hidden), seed=0)
    assert again.to_dict() == diagnosis_of(hidden).to_dict()


@cache
def unchanged_fit():
    return lieid.identify(MODEL, [run(arm_with(), 1), run(arm_with(), 2)])


@pytest.mark.parametrize(
    ("name", "joint", "strength", "label"),
    [
        ("payload", 0, 2.0, "payload"),
        ("torque_gain", 1, 2.0, "torque_gain:2"),
        ("stribeck", 0, 2.0, "stribeck:1"),
        ("time_shift", 0, 0.7, "time_shift"),  # 14 ms, between values that are tried first
        ("time_shift", 0, 1.5, "time_shift"),  # paths have a filter and an opposite delay as well
    ],
)
def test_a_change_is_named(name, joint, strength, label):
    diagnosis = lieid.diagnose(unchanged_fit(), run(arm_with((name, joint, strength)), 3))
    assert [s.label for s in diagnosis.steps] == [label]
    assert diagnosis.mode == "changed"
    assert diagnosis.steps[0].errors["rms_train"] is None
    assert "nan" not in diagnosis.sentence  # a shape that is the best of a grid has no deviation


@pytest.mark.parametrize(
    ("name", "joint", "strength", "shape", "true"),
    [("stribeck", 0, 3.0, "v_s", 0.27), ("torque_ripple", 1, 1.0, "k", 3.0)],
)
def test_the_shape_of_a_change_is_as_certain_as_stated(name, joint, strength, shape, true):
    """It is the best of a grid, whose steps add to what noise does."""
    arm, errors = arm_with((name, joint, strength)), []
    for seed in (3, 4, 5, 6):
        (step,) = lieid.diagnose(unchanged_fit(), run(arm, seed)).steps
        assert step.std[shape] < 0.02 * true
        errors.append((step.parameters[shape] - true) / step.std[shape])
    assert 0.3 < np.sqrt(np.mean(np.square(errors))) < 2.0


@pytest.mark.parametrize("size", [2.0, 12.0])  # the larger one resembles functions that harm
def test_a_change_of_no_known_form_is_one_function_with_what_is_linear_in_its_signals(size):
    """The kept model does not describe its linear part; others are judged without harmful ones."""

    def peak(s):
        v = s.dq[..., 0]
        return size * np.sign(v) * np.exp(-(((np.abs(v) / 0.6 - 1.0) / 0.25) ** 2))

    arm = arm_with().with_effects(plant.ForeignTorque(0, peak))
    (step,) = lieid.diagnose(lieid.identify(MODEL, run(arm_with(), 5)), run(arm, 3)).steps
    assert (step.label, step.status) == ("smooth/dq:1", "shape")
    assert step.after < 0.35 * step.before


@pytest.mark.parametrize("part", [0.8, 0.9])
def test_an_end_stop_that_is_far_above_the_noise_is_one_function_of_the_angle(part):
    """Its kink is no spline: a path goes on through what the function leaves of it."""
    angle = run(arm_with(), 6).q[:, 1]
    start = float(angle.min() + part * np.ptp(angle))
    stop = plant.ForeignTorque(1, lambda s: 20.0 * np.maximum(s.q[..., 1] - start, 0.0))
    (step,) = lieid.diagnose(unchanged_fit(), run(arm_with().with_effects(stop), 6)).steps
    assert (step.label, step.status) == ("smooth/q:2", "shape")
    assert step.after < 0.1 * step.before


def test_a_part_to_which_the_others_do_not_extend_is_no_reason_against_a_function():
    """Springs, payload and wrench imitate it, whose error in that part alone is lower."""
    angle = run(arm_with(), 3).q[:, 0]
    slack = float(angle.min() + 0.6 * np.ptp(angle))
    hose = plant.ForeignTorque(1, lambda s: 2.0 * np.maximum(s.q[..., 0] - slack, 0.0) ** 2)
    (step,) = lieid.diagnose(unchanged_fit(), run(arm_with().with_effects(hose), 3)).steps
    assert (step.label, step.status) == ("smooth/q1:2", "shape")
    assert step.after < 0.05 * step.before


def test_a_joint_without_any_torque_has_no_share_of_it():
    recording = run(arm_with(), 3)
    recording = replace(recording, tau=recording.tau * [1.0, 0.0])
    steps = lieid.diagnose(unchanged_fit(), recording).to_dict()["steps"]
    assert {step["share"] for step in steps if step["joints"] == [2]} == {None}


def test_sizes_of_changes_are_those_beside_each_other():
    """Dry friction of 0.8 N·m and viscous friction of 0.5 N·m·s/rad on joint 1."""
    later = run(arm_with(), 3)
    speed, tau = later.dq[:, 0], later.tau.copy()
    tau[:, 0] += 0.8 * np.tanh(speed / 0.003) + 0.5 * speed
    found = lieid.diagnose(unchanged_fit(), replace(later, tau=tau))
    assert [row[0] for row in found.error_table().rows][-1] == "expected"
    sizes = {s.label: next(iter(s.parameters.values())) for s in found.steps}
    assert sizes == pytest.approx({"coulomb:1": 0.8, "viscous:1": 0.5}, rel=0.03)


def test_errors_beside_a_change_are_those_of_the_others_fitted_again():
    """More dry and less viscous friction nearly cancel: each alone is much smaller."""
    later = run(arm_with(), 3)
    speed, tau = later.dq[:, 0], later.tau.copy()
    tau[:, 0] += 1.5 * np.tanh(speed / 0.003) - 1.2 * speed
    found = lieid.diagnose(unchanged_fit(), replace(later, tau=tau))
    assert {step.label for step in found.steps} == {"coulomb:1", "viscous:1"}
    rows = [found.baseline, *(step.errors for step in found.steps)]
    errors = [row["rms_test_moving"][0] for row in rows]
    assert errors == sorted(errors, reverse=True)
    # without the later one is the model with the earlier one
    assert found.steps[1].before == pytest.approx(errors[1], rel=1e-6)
    assert all(0.0 < step.fall.test < errors[0] for step in found.steps)


def test_an_unchanged_arm_is_sufficient():
    arm, fit = arm_with(), unchanged_fit()
    diagnosis = lieid.diagnose(fit, run(arm, 3))
    assert (diagnosis.steps, diagnosis.verdict) == ((), "sufficient")
    assert diagnosis.sentence == "Nothing has changed since the fit."
    assert "<td>expected</td>" in diagnosis._repr_html_()
    with pytest.raises(IdentificationError, match="no test"):
        lieid.diagnose(fit, run(arm, 3), run(arm, 4))


def test_an_error_within_the_uncertainty_of_the_fit_is_no_change():
    """A fit of small motions does not determine the torques of large ones."""
    fit = lieid.identify(MODEL, run(arm_with(), 1, scale=0.05))
    found = lieid.diagnose(fit, run(arm_with(), 3))
    error = found.baseline["rms_test_moving"][0]
    assert error > 3.0 * fit.rms_cv[0]
    assert error < 1.5 * found.expected[0]
    assert (found.steps, found.verdict) == ((), "sufficient")
    large = next(each for each in found.uncertain if each.joint == 0)
    assert large.ratio > 3.0
    assert found.sentences[0] == "No change since the fit is certain."
    assert f"{large.ratio:.2g} times what noise explains, which uncertain" in found.sentence


@pytest.mark.parametrize(("trained", "within"), [(1.0, True), (2.0, False)])
def test_uncertain_parameters_explain_errors_of_the_test_alone(trained, within, monkeypatch):
    """With little noise the noise floor may be too low; errors of the training are not theirs."""
    train, test = (run(arm_with(), seed) for seed in (1, 3))
    ratios = {train.source_hash: trained, test.source_hash: 2.0}
    over = lambda compared: np.full(ROBOT.n, ratios[compared.recordings[0].sha256])  # noqa: E731
    monkeypatch.setattr(missing, "over_floor", over)
    found = lieid.diagnose(MODEL, train, test)
    assert found.verdict == "unexplained"
    assert [part.within for part in found.unexplained] == [within] * ROBOT.n
    text = "uncertain parameters explain: fit longer or larger motion"
    assert (text in found.sentence) == within


def test_the_expected_error_is_that_of_new_motion():
    """With little noise reversals cause most of it, up to 2.5 times the held-out error."""
    quiet = plant.Sensors(rate=100.0, torque_noise=0.01)
    fit = lieid.identify(MODEL, run(arm_with(), 1, sensors=quiet))
    for seed in (2, 3, 4):
        found = lieid.diagnose(fit, run(arm_with(), seed, scale=0.3, sensors=quiet))
        assert (found.verdict, found.uncertain) == ("sufficient", ())
        ratio = found.baseline["rms_test_moving"] / found.expected
        assert ratio.min() > 0.5
        assert ratio.max() < 1.2


def test_extend_shows_the_fall():
    train, test = two_runs(LOAD_FRICTION)
    fit = lieid.identify(MODEL, train)
    extension = lieid.extend(fit, "load_friction:1", train, test)
    assert extension.rms_test[1, 0] < 0.8 * extension.rms_test[0, 0]
    assert [row["name"] for row in extension.parameters] == ["load_friction.f_tau"]
    with pytest.raises(EffectError, match="already"):
        lieid.extend(fit, "coulomb:1", train)
    with pytest.raises(EffectError, match="no effects to add"):
        lieid.extend(fit, "", train)


def test_extend_warns_of_a_shape_that_the_motion_does_not_resolve():
    train, _ = two_runs()
    speed = train.dq[:, 0]
    tau = train.tau.copy()
    tau[:, 0] += 5.0 * np.sign(speed) * np.exp(-((speed / 0.003) ** 2))  # near every reversal
    train = replace(train, tau=tau)
    extension = lieid.extend(lieid.identify(MODEL, train), "stribeck:1", train)
    texts = [str(w) for w in extension.after.warnings]
    assert any("stribeck:1" in text and "can resolve" in text for text in texts)


def test_commands(tmp_path, capsys):
    train, test = two_runs(LOAD_FRICTION)
    paths = [str(tmp_path / f"{name}.csv.gz") for name in ("train", "test")]
    for recording, path in zip((train, test), paths, strict=True):
        recording.save(path)
    fit, out = str(tmp_path / "fit.json"), str(tmp_path / "out.json")
    command = ["diagnose", "two_link", "--train", paths[0], "--test", paths[1]]
    assert main([*command, "-o", fit, "--json", out]) == 0
    content = json.loads((tmp_path / "out.json").read_text())
    assert content["steps"][0]["label"] == "load_friction:1"
    capsys.readouterr()
    unused = ["--method", "ols", "--cutoff", "9", "--effects", "coulomb"]
    assert main(["diagnose", fit, paths[1], *unused]) == 2
    assert "--method, --effects, --cutoff: without --train" in capsys.readouterr().err
    assert main(["diagnose", fit, paths[1], "--method", "wls", "--json", out]) == 0
    assert json.loads((tmp_path / "out.json").read_text())["mode"] == "changed"
    add = ["extend", fit, "--add", "armature:2", "--train", paths[0], "--json", out]
    assert main(add) == 0
    assert main(["diagnose", "two_link", paths[0]]) == 2
    assert main(["diagnose", fit]) == 2


def test_effects_that_the_model_absorbs_are_listed():
    content = diagnosis_of(seed=10)
    assert "armature:1" in content.absorbed  # Izz of the first link is the same column
    assert not {label for label, _ in content.weak} & set(content.absorbed)
    assert "armature:1" in alias_sentence(content)
    assert content.to_dict()["absorbed"] == list(content.absorbed)


def test_an_effect_that_the_last_search_was_beside_is_no_candidate_that_the_model_absorbs(
    monkeypatch,
):
    def absorbed(found, beside):
        assert beside == found.rows.fit.model.placements
        before, _ = absorbed_and_weak(found, beside)
        after, _ = absorbed_and_weak(found, (*beside, *place("armature:1", ROBOT.n)))
        assert set(before) - set(after) == {"armature:1"}
        return after, ()

    monkeypatch.setattr(missing, "absorbed_and_weak", absorbed)
    diagnosis = lieid.diagnose(MODEL, *two_runs(seed=10))
    assert "armature:1" not in diagnosis.absorbed


def test_a_joint_that_is_held_in_training_may_be_unexplained_in_the_test():
    t = np.arange(0.0, 15.0, 0.001)
    motion = plant.FourierTrajectory(ROBOT, base_frequency=1 / 15, seed=3).at(t)
    q, dq, ddq = (x * [1.0, 0.0] for x in motion)
    arm = arm_with(("load_friction", 1, 5.0))
    train = plant.measure_along(arm, t, q, dq, ddq, sensors=plant.demo_sensors(ROBOT), seed=3)
    diagnosis = lieid.diagnose(MODEL, train, run(arm, 2))
    assert (1, ()) in [(part.joint, part.depends_on) for part in diagnosis.unexplained]


def candidates_of(*labels):
    placements = [place(label, ROBOT.n)[0] for label in labels]
    return {p.label: Candidate(p, np.zeros((1, len(p.effect.shapes)))) for p in placements}


def accepted_as(label, *rivals):
    (candidate,) = candidates_of(label).values()
    evidence = Evidence((), (), 0.0, 0.0, 1.0, 1.0, 10)
    return Accepted(candidate, 1, evidence, rivals, "", (2.0, 1.0))


FORMS = candidates_of(
    "stribeck/exponent:2",
    "stribeck/exponent:1",
    "torque_lowpass/second_order:2",
    "torque_lowpass:2",
    "presliding:2",
    "time_shift",
)


def test_a_reason_states_a_ratio_without_a_unit_and_others_with_theirs():
    for label, value, text in (
        ("load_friction:2", 1.5, "f_tau = 1.5 is larger than on a real arm (limit 1)"),
        ("presliding:2", -0.5, "f_c = -0.5 N·m is physically implausible"),
    ):
        (candidate,) = candidates_of(label).values()
        assert implausible_value(candidate, np.zeros(0), np.array([value]), []) == text
    assert [in_unit("2", unit) for unit in ("1", "", "1/(N·m)")] == ["2", "2", "2 1/(N·m)"]


def test_a_filter_of_torque_is_no_form_of_friction_over_speed():
    def forms(label):
        found = other_forms([accepted_as(label)], 1, FORMS)
        return [each.placement.label for each, _ in found]

    assert forms("stribeck:2") == ["stribeck/exponent:2"]
    assert "torque_lowpass/second_order:2" in forms("torque_lowpass:2")
    assert not forms("torque_gain:2")
    beside = ["torque_lowpass:2", "viscous_polynomial:2", "torque_gain:2", "encoder_offset:2"]
    found = other_forms([accepted_as(label) for label in beside], 1, FORMS)
    of = {form.placement.label: [each.placement.label for each in own] for form, own in found}
    assert of["torque_lowpass/second_order:2"] == ["torque_lowpass:2"]
    assert of["stribeck/exponent:2"] == ["viscous_polynomial:2"]


def test_a_rival_may_take_the_place_of_all_delays_and_leaves_one_as_a_rival():
    hysteresis = Rival("presliding:2", "presliding", (1,), "data")
    shift = Rival("time_shift", "time_shift", (), "data")
    found = [
        accepted_as("torque_delay:2", hysteresis, shift),
        accepted_as("torque_lowpass/common", shift),
        accepted_as("torque_lowpass/common_second_order", shift),
        accepted_as("time_shift"),
        accepted_as("load_friction:2", hysteresis),
    ]
    forms = {
        (form.placement.label, form.placement.joint): (form, [each.placement.label for each in of])
        for form, of in other_forms(found, 1, FORMS)
    }
    form, replaced = forms["presliding:2", 1]
    assert replaced == ["torque_delay:2"]
    assert [rival.label for rival in form.rivals] == ["torque_delay:2", "time_shift"]
    of_arm = ["torque_lowpass/common", "torque_lowpass/common_second_order", "time_shift"]
    assert forms["time_shift", 0][1] == of_arm  # not twice
    every = other_forms([*found, accepted_as("presliding:2")], 1, FORMS)
    assert "presliding:2" not in [form.placement.label for form, _ in every]  # it is there already
