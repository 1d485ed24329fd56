"""Held-out parts of the training recordings, and effects that do not hold on all of them."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.special import gammaln

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.diagnosis import DiagnosisOptions
from lieid_casadi.diagnosis.screening.held_out import HeldOutRows, redundancy_of
from lieid_casadi.diagnosis.screening.held_out_parts import (
    Parts,
    block_parts,
    recording_parts,
)
from lieid_casadi.diagnosis.screening.model_factor import ModelFactor
from lieid_casadi.identification.uncertainty.noise_model import Noise, Runs
from lieid_casadi.recording import Processing, process

ROBOT = lieid.robots.two_link()
MODEL = lieid.Model(ROBOT, "coulomb,viscous,offset")
OPTIONS = DiagnosisOptions()
ROWS = 400


@cache
def run(*hidden, seed=1, duration=15.0):
    arm = plant.demo_arm(ROBOT, seed=0, hidden=None)
    arm = arm.with_effects(*(plant.hidden_effect(arm, n, j, strength=s) for n, j, s in hidden))
    trajectory = plant.FourierTrajectory(ROBOT, base_frequency=1 / 15, seed=seed)
    t = np.arange(0.0, duration, 0.002)
    sensors = plant.demo_sensors(ROBOT)
    return plant.measure_along(
        arm, t, *trajectory.at(t), sensors=sensors, seed=seed, name=f"run{seed}"
    )


def every_instant(segments):
    count = sum(len(s.filtered_time) for s in segments)
    return [Noise.white(1.0)], [Runs((np.arange(count),), np.zeros(count))]


def test_blocks_are_contiguous_and_apart_from_the_rest():
    segments = process([run()], Processing(cutoff=8.0))
    time = segments[0].filtered_time
    parts = block_parts(segments, *every_instant(segments), gap=0.3, options=OPTIONS)
    assert set(parts.held) == set(range(OPTIONS.held_out_parts))
    assert np.count_nonzero(np.diff(parts.held)) == OPTIONS.held_out_parts - 1  # one block each
    for k in range(OPTIONS.held_out_parts):
        used = time[(parts.held != k) & ~parts.near[k]]
        held = time[parts.held == k]
        assert np.abs(used[:, None] - held).min() >= 0.3
        assert not (parts.near[k] & (parts.held == k)).any()


def test_the_same_part_of_every_period_is_held_out_together():
    t = np.arange(0.0, 45.0, 0.01)
    angle = 2.0 * np.pi / 15.0 * np.outer(t, [1.0, 2.0])
    recording = lieid.Recording.from_arrays(t, np.sin(angle), None, np.cos(angle))
    segments = process([recording], Processing(cutoff=8.0))
    time = segments[0].filtered_time
    parts = block_parts(segments, *every_instant(segments), gap=0.3, options=OPTIONS)
    one_later = np.searchsorted(time, time + 15.0 - 1e-6)
    inside = one_later < len(time)
    same = parts.held[inside] == parts.held[one_later[inside]]
    assert np.mean(same) > 0.99  # except for the instants at the edges of blocks


def test_recordings_are_parts_where_there_are_several():
    segments = process([run(), run(seed=2)], Processing(cutoff=8.0))
    parts = recording_parts(segments, *every_instant(segments))
    assert parts.names == ("run1", "run2")
    assert np.all(np.diff(parts.held) >= 0)
    assert recording_parts(segments[:1], *every_instant(segments[:1])) is None


def two_recordings(first, second, seed=0):
    """Return rows of two recordings in which a column has two coefficients, and the column."""
    random = np.random.default_rng(seed)
    model, column = random.normal(size=(ROWS, 3)), random.normal(size=(ROWS, 1))
    half = np.arange(ROWS) < ROWS // 2
    torque = random.normal(size=ROWS) + column[:, 0] * np.where(half, first, second)
    parts = Parts(("a", "b"), (~half).astype(np.intp), np.zeros((2, ROWS), dtype=bool), True)
    rows = HeldOutRows((parts,), np.ones(ROWS), np.ones(1), OPTIONS.held_out_deviations)
    return rows, column, ModelFactor.of([model], [torque]).baseline()


@pytest.mark.parametrize(
    ("first", "second", "holds"), [(1.0, 1.0, True), (1.0, 0.0, False), (1.0, -1.0, False)]
)
def test_an_effect_must_hold_on_every_recording(first, second, holds):
    rows, column, baseline = two_recordings(first, second)
    found = rows.errors(column, baseline)
    assert found.holds == holds
    assert bool(found.reason) != holds
    if holds:
        assert found.fall[0] == pytest.approx(1.0 - 1.0 / np.sqrt(2.0), abs=0.05)


def test_columns_that_no_part_can_judge_are_not_confirmed():
    for size, judged in ((1.0, True), (0.1, False)):
        rows, column, baseline = two_recordings(size, size, seed=3)
        found = rows.errors(column, baseline)
        assert found.holds
        assert found.judged.any() == found.is_confirmed == judged


def test_held_out_errors_are_those_of_fits_without_the_part():
    rows, column, _ = two_recordings(0.7, 0.7)
    random = np.random.default_rng(1)
    model, torque = random.normal(size=(ROWS, 3)), random.normal(size=ROWS) + column[:, 0]
    factors = [ModelFactor.of([matrix], [torque]) for matrix in (model, model[:, ::-1] + 1.0)]
    further = random.normal(size=(ROWS, 2))
    part = rows.parts[0]
    for factor in (*factors, factors[0]):  # in turn, as the products of the last one are kept
        matrix = factor.basis @ factor.triangle
        for baseline, own in (
            (factor.baseline(), matrix),
            (factor.baseline(without=[1]), matrix[:, [0, 2]]),
            (factor.baseline().with_columns(further), np.hstack([matrix, further])),
        ):
            found = rows.errors(column, baseline)
            for columns, error in ((own, found.before), (np.hstack([own, column]), found.after)):
                total = 0.0
                for k in range(2):
                    held = part.held == k
                    values = np.linalg.lstsq(columns[~held], torque[~held], rcond=None)[0]
                    total += np.sum((torque[held] - columns[held] @ values) ** 2)
                assert error[0] == pytest.approx(np.sqrt(total / ROWS), rel=1e-6)


def test_redundancy_is_the_number_of_rows_per_independent_sample():
    noise = Noise(np.array([1.0, -0.5]), np.sqrt(0.75), 1.0)  # e_k = 0.5 e_{k−1} + white
    assert redundancy_of(noise) == pytest.approx(3.0)  # (1 + 0.5)/(1 − 0.5)
    assert redundancy_of(Noise.white(2.0)) == 1.0


def choice(diagnosis):
    content = diagnosis.to_dict()
    for step in content["steps"]:
        for key in ("rms_test", "rms_test_moving", "confirmed"):
            del step[key]
        del step["evidence"]["test_confirms"]
    for part in content["unexplained"]:
        del part["confirmed"]
    return {k: content[k] for k in ("steps", "unexplained", "rejected", "tried", "verdict")}


def bump(state):
    return 6.0 * np.exp(-((state.q[..., 1] / 0.2) ** 2)) * np.tanh(state.dq[..., 1] / 0.05)


@pytest.mark.parametrize("foreign", [False, True])
def test_the_test_recording_chooses_nothing(foreign):
    """Steps, shapes, formulas and unexplained parts are the same with any test and without."""
    train = run(("load_friction", 0, 2.0), ("stribeck", 1, 2.0))
    test = run(("load_friction", 0, 2.0), ("stribeck", 1, 2.0), seed=2)
    if foreign:
        arm = plant.demo_arm(ROBOT, seed=0, hidden=None).with_effects(plant.ForeignTorque(1, bump))
        t = np.arange(0.0, 15.0, 0.002)
        motion = plant.FourierTrajectory(ROBOT, base_frequency=1 / 15, seed=1).at(t)
        train = plant.measure_along(
            arm, t, *motion, sensors=plant.demo_sensors(ROBOT), seed=1, name="bump"
        )
    contradicting = replace(test, tau=-test.tau)
    without = lieid.diagnose(MODEL, train)
    assert choice(lieid.diagnose(MODEL, train, contradicting)) == choice(without)
    assert without.steps or foreign
    assert all(step.evidence.confirmed is None for step in without.steps)


@cache
def several():
    hidden = (("stribeck", 0, 2.0), ("stribeck", 1, 2.0))
    return lieid.diagnose(MODEL, [run(*hidden), run(*hidden, seed=2)], run(*hidden, seed=3))


def test_one_effect_on_several_joints_is_one_finding():
    found = several()
    assert {step.label for step in found.steps} == {"stribeck:1", "stribeck:2"}
    assert found.groups == (1, 1)
    assert found.steps[0].fit is found.steps[1].fit  # added together
    assert len(found.shown[1]) == len(found.model_names) == 2
    assert found.model_names[1] == "+ stribeck:1+2"
    assert all(step.evidence.confirmed for step in found.steps)


def test_p_values_follow_from_the_evidence_in_the_json():
    content = json.loads(json.dumps(several().to_dict()))
    assert content["seed"] == 0
    for step in content["steps"]:
        e = step["evidence"]
        half, k = 0.5 * e["statistic"], 0.5 * e["degrees_of_freedom"]
        log_p = (k - 1.0) * np.log(half) - half - gammaln(k)  # the tail of χ², which underflows
        expected = (log_p + np.log(e["family_size"])) / np.log(10.0)
        assert e["log10_p"] == pytest.approx(expected, rel=1e-3)
        assert e["effective_rows"] > 100
        assert e["dispersion"] >= 1.0
        assert step["selected"] == 1.0


def test_a_limit_that_ends_the_search_is_reported():
    options = DiagnosisOptions(most_steps=1)
    found = lieid.diagnose(
        MODEL, run(("load_friction", 0, 2.0), ("stribeck", 1, 2.0)), options=options
    )
    assert found.limits_reached == ("most_steps",)
    assert several().limits_reached == ()


def test_a_change_between_the_recordings_is_not_an_effect_of_the_arm():
    hidden, changed = ("load_friction", 1, 1.0), ("viscous_asymmetric", 1, 3.0)
    found = lieid.diagnose(MODEL, [run(hidden), run(hidden, changed, seed=2)])
    assert [step.label for step in found.steps] == ["load_friction:2"]  # beside the change
    assert found.unexplained == ()
    assert found.differing
    assert found.verdict == "unexplained"
    (first,) = found.to_dict()["differs_between_recordings"]
    assert (first["effect"], first["joints"]) == ("viscous_asymmetric", [2])
    assert first["recordings"] == ["run2"]
    assert "viscous_asymmetric on joint 2 would explain run2 and not the others" in found.sentence


def test_a_test_recording_has_no_columns_of_what_differs_in_training():
    hidden, changed = ("stribeck", 0, 1.0), ("viscous_asymmetric", 1, 3.0)
    train = [run(hidden), run(hidden, changed, seed=2)]
    found = lieid.diagnose(MODEL, train, run(hidden, seed=3))
    assert [step.label for step in found.steps] == ["stribeck:1"]
    assert [part.joint for part in found.unexplained] == [1]
    assert found.unexplained[0].confirmed is not None


def test_progress_states_step_joint_and_error():
    stages = []
    lieid.diagnose(
        MODEL, run(("stribeck", 0, 2.0)), progress=lambda stage, fraction: stages.append(stage)
    )
    assert any("step 1: stribeck:1; error on joint 1 0.0" in stage for stage in stages)


def test_the_dispersion_is_that_of_the_joint_where_the_columns_act():
    random = np.random.default_rng(0)
    matrices = [random.normal(size=(ROWS, 3)) for _ in range(2)]
    column = np.concatenate([random.normal(size=(ROWS, 1)), np.zeros((ROWS, 1))])
    noise = [random.normal(size=ROWS), 5.0 * random.normal(size=ROWS)]  # joint 2 is noisy
    baseline = ModelFactor.of(matrices, [noise[0] + column[:ROWS, 0], noise[1]]).baseline()
    assert baseline.dispersion(column, 2) < 1.5
    assert baseline.dispersion(column[::-1], 2) > 15.0
