"""Friction curves of the plant, models fitted to them, and ``lieid friction``."""

import dataclasses
import json
from dataclasses import replace

import numpy as np
import pytest
from exporters.c_arms import made_fit
from friction_curves.friction_plant import (
    COULOMB,
    CUTOFF,
    EXTRA,
    LOAD,
    ROBOT,
    SPEEDS,
    VISCOUS,
    WIDTH,
    arm,
    at_stated_speed,
    friction,
    measured,
    sweep,
)

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.cli.main import main
from lieid_casadi.errors import (
    EffectError,
    NotDissipativeWarning,
    RecordingError,
    UnidentifiableWarning,
)
from lieid_casadi.friction_curves import fit_friction, friction_curve
from lieid_casadi.friction_curves.friction_fit import steady_columns


def test_constant_speeds_give_the_friction_of_the_plant():
    curve = friction_curve(ROBOT, sweep(), 0, processing=CUTOFF)
    error, steady = curve.friction - friction(curve.speed, curve.load), at_stated_speed(curve)
    assert np.median(np.abs(error)) < 1e-3
    assert steady.sum() > 30
    assert np.abs(error / curve.std)[steady].max() < 4.0
    assert np.mean(np.abs(error) < 2 * curve.std) > 0.9


def test_offset_and_asymmetric_friction_are_not_in_the_curve():
    even = arm(plant.ViscousAsymmetric(0, 0.5), offset=-2.0)
    fit = replace(made_fit(ROBOT, ""), parameters=arm().parameters)
    other = friction_curve(fit, sweep(even), 0, processing=CUTOFF)
    same = friction_curve(fit, sweep(), 0, processing=CUTOFF)
    assert (same.load_source, other.load_source) == ("model", "model")
    steady = at_stated_speed(same)
    np.testing.assert_allclose(other.friction[steady], same.friction[steady], atol=0.02)


def lopsided(t):
    """Forward and backward motion with different accelerations at equal positions."""
    phase = 2 * np.pi * 0.15 * t
    q, dq, ddq = (np.zeros((len(t), 2)) for _ in range(3))
    w = 2 * np.pi * 0.15
    q[:, 0] = 0.8 * np.sin(phase) + 0.15 * np.sin(2 * phase)
    dq[:, 0] = w * (0.8 * np.cos(phase) + 0.3 * np.cos(2 * phase))
    ddq[:, 0] = w**2 * (-0.8 * np.sin(phase) - 0.6 * np.sin(2 * phase))
    return q, dq, ddq


def test_any_motion_in_both_directions_with_different_accelerations():
    """The difference of the rigid torque is subtracted if there is a model."""
    t = np.arange(0.0, 60.0, 0.004)
    recording = measured(t, lopsided(t), hidden=arm(nominal=True))
    known = friction_curve(ROBOT, recording, 0, processing=CUTOFF)
    bare = replace(ROBOT, joints=tuple(replace(j, link=None) for j in ROBOT.joints))
    unknown = friction_curve(bare, recording, 0, processing=CUTOFF)
    # the two speeds of a pair differ by up to 30 %, and their mean is used
    error = np.abs(known.friction - friction(known.speed, known.load))
    without = np.abs(unknown.friction - friction(unknown.speed, unknown.load))
    assert np.median(error) < 0.03
    assert np.median(without) > 3 * np.median(error)


@pytest.mark.slow
def test_standard_errors_cover():
    """The scatter of the points over twenty runs matches their standard errors.

    Each pass is matched with more than one pass in the other direction, so samples are used twice.
    """
    noisy = {"speeds": (0.2, 0.2, 0.2, 0.2), "rate": 125.0, "torque_noise": 0.3}
    runs = [friction_curve(ROBOT, sweep(seed=k, **noisy), 0, processing=CUTOFF) for k in range(20)]
    errors = np.concatenate([(r.friction - friction(r.speed, r.load)) / r.std for r in runs])
    assert 0.7 < np.std(errors) < 1.3
    assert 0.9 < np.mean(np.abs(errors) < 2.0) < 0.99


def ramp(t, direction, joint=0):
    q, dq, ddq = (np.zeros((len(t), 2)) for _ in range(3))
    q[:, joint], dq[:, joint] = direction * 0.2 * t, direction * 0.2
    return q, dq, ddq


@pytest.mark.parametrize(
    ("runs", "joint", "message"),
    [
        ([(1.0, 0.0)], 0, "run: joint 1 moves forward only.*record it"),
        ([(-1.0, 0.0)], 0, "run: joint 1 moves backward only.*record it"),
        ([(1.0, 0.0), (-1.0, -0.5)], 0, "passes no position in both directions.*forward and back"),
        ([(1.0, 0.0), (-0.25, 0.8)], 0, "only at different speeds"),
        ([(1.0, 0.0)], 1, "joint 2 never moves"),
    ],
)
def test_motion_without_pairs_is_refused(runs, joint, message):
    """Ramps of joint 1 by their direction and start."""
    t = np.arange(0.0, 8.0, 0.004)
    recordings = []
    for direction, start in runs:
        q, dq, ddq = ramp(t, direction)
        q[:, 0] += start
        recordings.append(measured(t, (q, dq, ddq)))
    with pytest.raises(RecordingError, match=message):
        friction_curve(ROBOT, recordings, joint, processing=CUTOFF)


def test_other_joints_elsewhere():
    """The second joint is at another position in the backward motion."""
    t = np.arange(0.0, 30.0, 0.004)
    q, dq, ddq = lopsided(t)
    q[:, 1] = 0.4 * np.tanh(3 * dq[:, 0])
    dq[:, 1] = np.gradient(q[:, 1], t)
    ddq[:, 1] = np.gradient(dq[:, 1], t)
    with pytest.raises(RecordingError, match="the other joints have moved"):
        friction_curve(ROBOT, measured(t, (q, dq, ddq)), 0, processing=CUTOFF)


TRUTH = "coulomb,viscous,stribeck,load_friction"


@pytest.fixture(scope="module")
def full_curve():
    return friction_curve(ROBOT, sweep(), 0, processing=CUTOFF)


@pytest.fixture(scope="module")
def fit(full_curve):
    return fit_friction(full_curve, TRUTH)


def test_parameters_of_the_plant_are_found(fit):
    truth = np.array([COULOMB, VISCOUS, EXTRA, LOAD, WIDTH])
    found = np.concatenate([fit.coefficients, fit.shapes])
    assert np.abs((found - truth) / fit.std).max() < 4.0
    assert np.all(fit.std < 0.1 * truth)
    np.testing.assert_allclose(found, truth, rtol=0.03)
    assert fit.rms < 0.01
    assert fit.correlation > 0.999


def test_the_papers_model_fits_equally_with_more_parameters(full_curve, fit):
    paper = fit_friction(
        full_curve, "viscous,viscous_polynomial,stribeck/two_width,load_friction/paper"
    )
    assert len(paper.parameters) == 10
    assert paper.rms < 1.05 * fit.rms


def test_an_effect_with_memory_is_in_steady_state_on_a_curve(full_curve):
    dahl, coulomb = (
        fit_friction(full_curve, f"viscous,{name}") for name in ("presliding", "coulomb")
    )
    np.testing.assert_allclose(dahl.predicted, coulomb.predicted, rtol=1e-6)


def test_the_default_model_has_load_friction_where_the_load_varies(full_curve):
    assert fit_friction(full_curve).effects == tuple(TRUTH.split(","))
    constant = dataclasses.replace(full_curve, load=np.ones(len(full_curve)))
    assert fit_friction(constant).effects == ("coulomb", "viscous", "stribeck")


def test_parameters_that_a_curve_does_not_determine_are_reported(full_curve):
    fit = fit_friction(full_curve, "coulomb,viscous,offset,viscous_asymmetric")
    reported = " ".join(str(w) for w in fit.warnings if isinstance(w, UnidentifiableWarning))
    assert "offset.f_b:1" in reported
    assert "viscous_asymmetric.f:1" in reported
    rows = {row["name"]: row for row in fit.parameter_table()}
    assert rows["offset.f_b"]["std"] is None
    assert rows["offset.f_b"]["value"] == 0.0
    assert rows["coulomb.f_c"]["std"] is not None


def test_negative_friction_is_reported(full_curve, fit):
    lower = dataclasses.replace(full_curve, friction=full_curve.friction - 2.5)
    found = fit_friction(lower, "coulomb,viscous").warnings
    assert any(isinstance(w, NotDissipativeWarning) for w in found)
    assert not any(isinstance(w, NotDissipativeWarning) for w in fit.warnings)


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ("coulomb:2", "coulomb:2 does not act on joint 1"),
        ("coulom", "unknown effect"),
        ("warm_up", "is not friction of speed and load"),
        ("torque_gain", "is not friction of speed and load"),
        ("transmission_coupling", "couples two joints"),
        ("", "no effects given"),
    ],
)
def test_effects_must_be_of_the_joint(full_curve, effects, message):
    with pytest.raises(EffectError, match=message):
        fit_friction(full_curve, effects)


def test_the_model_is_printed_and_written(tmp_path, capsys):
    run, out, fit = (str(tmp_path / name) for name in ("run.csv", "f.json", "fit.json"))
    sweep(speeds=SPEEDS[3:]).save(run)
    words = ["friction", "two_link", run, "--joint", "1", "--json", out]
    assert main(words) == 0
    assert "coulomb, viscous, stribeck, load_friction: RMS" in capsys.readouterr().out
    content = json.loads((tmp_path / "f.json").read_text())
    assert content["joint"] == 1
    assert {"name", "joint", "value", "std", "unit"} == set(content["fit"]["parameters"][0])
    assert len(content["curve"]["points"]) == len(content["fit"]["predicted"])
    identified = replace(made_fit(ROBOT, ""), parameters=arm().parameters, processing=CUTOFF)
    identified.save(fit)
    assert main([*words, "--effects", "coulomb,viscous", "--fit", fit]) == 0
    content = json.loads((tmp_path / "f.json").read_text())
    assert content["fit"]["effects"] == ["coulomb", "viscous"]
    assert content["curve"]["load_source"] == "model"


@pytest.mark.parametrize("seed", [3, 7, 9])
def test_the_error_is_noise_where_shapes_hide_in_a_narrow_part_of_their_ranges(seed):
    """The paper's friction of joint 7: of local searches alone the best has four times the cost."""
    random = np.random.default_rng(seed)
    speed = np.deg2rad(np.repeat([0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 25.0], 13))
    load = random.uniform(0.006, 1.2, len(speed))
    std = np.where(random.uniform(size=len(speed)) < 0.5, 5e-4, 3.5e-3)
    robot = lieid.robots.two_link()
    effects = "viscous,viscous_polynomial,stribeck/two_width,load_friction/paper"
    true = {
        "f_v": 0.3, "f_v2": -0.001, "f_v3": -0.008, "f_c": 0.076, "f_s": 0.114, "v_c": 0.02,
        "v_s": 0.06, "f_tau": 0.0315, "f_tau1": -0.0228, "f_tau2": 0.083,
    }  # fmt: skip
    compiled = lieid.compile(lieid.Model(robot, [f"{name}:1" for name in effects.split(",")]))
    coefficients, shapes = (
        np.array([true[p.name.rpartition(".")[2]] for p in own])
        for own in (compiled.model.columns, compiled.model.shapes)
    )
    exact = steady_columns(compiled, 0, speed, shapes, load=load) @ coefficients
    curve = replace(
        friction_curve(ROBOT, sweep(), 0, processing=CUTOFF),
        speed=speed, load=load, friction=exact + std * random.normal(size=len(speed)), std=std,
    )  # fmt: skip
    fit = fit_friction(curve, effects)
    assert np.sum(((curve.friction - fit.predicted) / std) ** 2) < 1.5 * len(speed)
    np.testing.assert_allclose(fit.shapes, shapes, rtol=0.25)
