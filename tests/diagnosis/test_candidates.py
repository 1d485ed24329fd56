"""Candidates follow what effects declare about themselves, and the options of the diagnosis."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.diagnosis import DiagnosisOptions
from lieid_casadi.diagnosis.screening.candidates import list_candidates, shape_grid, shape_limits
from lieid_casadi.diagnosis.screening.incremental_effect import incremental
from lieid_casadi.diagnosis.search.parameter_checks import below_sample_time, implausible_size
from lieid_casadi.effects import Shape, make
from lieid_casadi.recording import Processing, process

ROBOT = lieid.robots.two_link()
OPTIONS = DiagnosisOptions()
MODEL = lieid.Model(ROBOT, "coulomb,viscous,offset")


@cache
def measured(hidden=True, seed=1):
    arm = plant.demo_arm(ROBOT, hidden=None)
    if hidden:
        arm = arm.with_effects(plant.hidden_effect(arm, "load_friction", 0, strength=2.0))
    motion = plant.FourierTrajectory(ROBOT, base_frequency=0.1, seed=seed)
    t = np.arange(0.0, 10.0, 0.001)
    sensors = plant.demo_sensors(ROBOT)
    return plant.measure_along(arm, t, *motion.at(t), sensors=sensors, seed=seed)


@cache
def segments():
    return tuple(process(measured(), Processing(cutoff=8.0)))


@pytest.mark.parametrize("unit", ["rad/s", "s", "1"])
def test_the_motion_limits_a_shape_parameter_by_what_it_declares(unit):
    (segment,) = segments()
    plain = Shape("x", unit, 0.1, 1e-3, 20.0)
    assert shape_limits(plain, [segment], 0, OPTIONS) == (1e-3, 20.0)
    speed = Shape("x", unit, 0.1, 1e-3, 20.0, resolved_by="speed")
    low, high = shape_limits(speed, [segment], 0, OPTIONS)
    assert low == pytest.approx(OPTIONS.least_velocity_scale * segment.dead_zone[0])
    assert low < high < np.abs(segment.dq[:, 0]).max()
    duration = Shape("x", unit, 0.1, 1e-3, 20.0, resolved_by="duration")
    low, high = shape_limits(duration, [segment], 0, OPTIONS)
    assert (low, high) == pytest.approx((0.5, 20.0), rel=1e-3)


def test_effects_that_are_no_candidates_are_not_listed():
    listed = list_candidates(
        MODEL, segments(), lambda effect, joint: np.ones((1, 1)), options=OPTIONS
    )
    names = {candidate.name for candidate in listed}
    assert "sigmoid_friction" not in names
    assert not make("sigmoid_friction").candidate
    assert {"stribeck", "load_friction", "payload"} <= names
    assert not {"coulomb", "viscous", "offset", "temperature_friction"} & names


@pytest.mark.parametrize(
    ("name", "columns"), [("presliding", 1), ("position_spring", 2), ("stribeck", 1)]
)
def test_a_change_contains_replaced_and_accompanying_effects(name, columns):
    change = incremental(make(name), ["coulomb", "viscous", "offset"])
    assert len(change.coefficients) == columns
    assert (change.name, change.label) == (name, name)
    signals = {"presliding": {"sign"}, "position_spring": {"q"}, "stribeck": {"dq", "sign"}}
    assert signals[name] <= set(change.signals)


def test_a_replaced_effect_that_the_model_lacks_is_not_subtracted():
    effect = make("presliding")
    assert incremental(effect, ["viscous"]) is effect


def test_the_size_of_the_grid_is_an_option():
    small = DiagnosisOptions(shape_grid_size=5)
    assert len(shape_grid(make("stribeck"), segments(), 0, small)) == 5
    assert len(shape_grid(make("stribeck"), segments(), 0, OPTIONS)) == 25


def test_thresholds_are_options():
    found = lieid.diagnose(MODEL, measured())
    assert [step.label for step in found.steps] == ["load_friction:1"]
    assert found.limits_reached == ()
    strict = lieid.diagnose(MODEL, measured(), options=DiagnosisOptions(worth=0.999))
    assert strict.steps == ()
    assert any("held-out error falls by only" in reason for _, reason in strict.rejected)


def test_a_limit_that_ends_the_search_is_reported():
    found = lieid.diagnose(MODEL, measured(), options=DiagnosisOptions(most_steps=1))
    assert found.limits_reached == ("most_steps",)
    assert found.to_dict()["limits_reached"] == ["most_steps"]
    assert "The search ended at its limit (most_steps)" in found.sentence


def delayed(strength):
    arm = plant.demo_arm(ROBOT, hidden=None)
    arm = arm.with_effects(plant.hidden_effect(arm, "torque_delay", 1, strength=strength))
    motion = plant.FourierTrajectory(ROBOT, base_frequency=0.1, seed=1)
    t = np.arange(0.0, 10.0, 0.001)
    return plant.measure_along(arm, t, *motion.at(t), sensors=plant.demo_sensors(ROBOT), seed=1)


def test_a_lag_below_one_sample_is_named():
    recording = delayed(0.2)
    (step,) = lieid.diagnose(MODEL, recording).steps
    names = {step.effect, *(rival["effect"] for rival in step.to_dict()["indistinguishable"])}
    assert step.joints == (1,)
    assert names >= {"torque_delay", "torque_lowpass"}  # to first order the same
    (lag,) = step.parameters.values()
    assert 0.5 < lag * recording.rate < 1.0


@pytest.mark.parametrize(
    ("name", "value", "cause"),
    [
        ("torque_delay", 0.004, ""),
        ("torque_delay", -0.004, "a velocity computed by differences is late by as much"),
        ("torque_delay", -0.03, ""),
        ("time_shift", -0.004, "a velocity computed by differences is late by as much"),
        ("command_delay", 0.004, "commands are held for as long"),
        ("command_delay", 0.03, ""),
    ],
)
def test_a_lead_and_a_command_delay_below_one_sample_are_rejected(name, value, cause):
    found = segments()
    step = 1.0 / found[0].recording.rate
    reason = below_sample_time(
        make(name), {"delta": value / 0.01 * step}, found, DiagnosisOptions()
    )
    assert reason.endswith(cause)
    assert ("less than one sample" in reason) == bool(cause)


@pytest.mark.parametrize(
    ("rise", "effect"), [(5.0, "temperature_friction"), (0.1, "warm_up"), (None, "warm_up")]
)
def test_a_measured_temperature_that_varies_is_tried_in_place_of_time(rise, effect):
    (segment,) = segments()
    size = segment.q.shape
    if rise is None:
        found = replace(segment, temperature=None)
    else:
        found = replace(segment, temperature=np.linspace(0.0, rise, size[0])[:, None] * np.ones(2))
    scan = lambda effect, joint: np.ones((1, 1))  # noqa: E731
    listed = list_candidates(MODEL, [found], scan, options=OPTIONS, model_fixed=True)
    names = {candidate.name for candidate in listed}
    assert effect in names
    assert ("warm_up" in names) == (effect == "warm_up")


def test_joints_that_hardly_move_have_no_candidates():
    (segment,) = segments()
    held = replace(segment, q=segment.q * [1.0, 1e-3])
    scan = lambda effect, joint: np.ones((1, 1))  # noqa: E731
    listed = list_candidates(MODEL, [held], scan, options=OPTIONS)
    assert {joint for candidate in listed for joint in candidate.joints} == {0}


@pytest.mark.parametrize(
    ("label", "value"),
    [("torque_gain", 2.35), ("torque_delay", 0.18), ("position_spring", -80_910.0)],
)
def test_values_that_no_real_arm_has_are_implausible(label, value):
    effect = make(label)
    (coefficient,) = effect.coefficients
    reason = implausible_size(effect, {coefficient.name: value})
    assert reason.startswith(f"{label}.{coefficient.name} = {value:.3g}")
    assert "physically implausible (limit" in reason
    assert implausible_size(effect, {coefficient.name: 0.05}) == ""
