"""Friction models fitted to curves, and stages."""

import dataclasses
import json

import numpy as np
import pytest
from friction_curves.friction_plant import (
    COULOMB,
    CUTOFF,
    EXTRA,
    LOAD,
    ROBOT,
    SPEEDS,
    VISCOUS,
    WIDTH,
    excitation,
    friction,
    measured,
)

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.errors import (
    BoundWarning,
    EffectError,
    ExtrapolationWarning,
    ModelError,
    NotDissipativeWarning,
    UnidentifiableWarning,
)
from lieid_casadi.friction_curves import (
    combine_stages,
    fit_friction,
    friction_curve,
)
from lieid_casadi.friction_curves.friction_fit import rank_friction_models, steady_columns

TRUTH = "coulomb,viscous,stribeck,load_friction"


@pytest.fixture(scope="module")
def curve():
    motion = plant.sweep(ROBOT, 0, speeds=SPEEDS, pose=[0.0, 0.4])
    t = np.arange(0.0, motion.duration, 0.004)
    return friction_curve(ROBOT, measured(t, motion.at(t)), 0, processing=CUTOFF)


@pytest.fixture(scope="module")
def fit(curve):
    return fit_friction(curve, TRUTH)


def test_parameters_of_the_plant_are_found(fit):
    values = {row["name"]: row["value"] for row in fit.parameter_table()}
    assert values["coulomb.f_c"] == pytest.approx(COULOMB, abs=0.05)
    assert values["viscous.f_v"] == pytest.approx(VISCOUS, rel=0.03)
    assert values["stribeck.f_s-f_c"] == pytest.approx(EXTRA, rel=0.05)
    assert values["stribeck.v_s"] == pytest.approx(WIDTH, rel=0.05)
    assert values["load_friction.f_tau"] == pytest.approx(LOAD, rel=0.05)
    assert fit.rms < 0.01
    assert fit.correlation > 0.999


def test_standard_deviations_cover_the_true_parameters(fit):
    truth = np.array([COULOMB, VISCOUS, EXTRA, LOAD, WIDTH])
    values = np.concatenate([fit.coefficients, fit.shapes])
    assert np.abs((values - truth) / fit.std).max() < 4.0
    assert np.all(fit.std < 0.1 * truth)


def test_friction_at_any_speed_and_load(fit):
    speed, load = np.array([0.04, 0.2, 0.9]), np.array([0.0, 8.0, -15.0])
    np.testing.assert_allclose(fit.friction(speed, load=load), friction(speed, load), rtol=0.02)


def test_linear_models_are_weighted_least_squares(curve):
    """Against columns written by hand at the points, which the filter hardly changes."""
    fit = fit_friction(curve, "coulomb,viscous,load_friction")
    columns = np.column_stack([np.ones(len(curve)), curve.speed, curve.load])
    weight = 1.0 / curve.std
    by_hand = np.linalg.lstsq(columns * weight[:, None], curve.friction * weight, rcond=None)[0]
    np.testing.assert_allclose(fit.coefficients, by_hand, rtol=0.01)
    residual = curve.friction - columns @ by_hand
    assert fit.rms == pytest.approx(np.sqrt(np.mean(residual**2)), rel=0.02)
    expected = np.corrcoef(curve.friction, columns @ by_hand)[0, 1]
    assert fit.correlation == pytest.approx(expected, abs=1e-3)


@pytest.fixture(scope="module")
def paper(curve):
    return fit_friction(curve, "paper")


def test_result_does_not_depend_on_the_seed(curve, fit):
    for seed in (1, 2):
        other = fit_friction(curve, TRUTH, seed=seed)
        np.testing.assert_allclose(other.shapes, fit.shapes, rtol=1e-3)


def test_the_papers_model_fits_equally_with_more_parameters(fit, paper):
    assert len(paper.parameters) == 10
    assert paper.rms < 1.05 * fit.rms
    assert paper.bic > fit.bic


def test_models_of_the_literature_are_ranked(curve):
    ranked = rank_friction_models(
        curve, ["load_constant", "gao2017", "gao2017_constant_temperature", "load_absolute"]
    )
    assert ranked[0].model.name == "gao2017_constant_temperature"
    assert {c.model.name for c in ranked} == {
        "load_constant", "gao2017_constant_temperature", "load_absolute",
    }  # fmt: skip


def test_parameters_that_a_curve_does_not_determine_are_reported(curve):
    fit = fit_friction(curve, "coulomb,viscous,offset,viscous_asymmetric")
    reported = " ".join(str(w) for w in fit.warnings if isinstance(w, UnidentifiableWarning))
    assert "offset.f_b:1" in reported
    assert "viscous_asymmetric.f:1" in reported
    rows = {row["name"]: row for row in fit.parameter_table()}
    assert rows["offset.f_b"]["std"] is None
    assert rows["offset.f_b"]["value"] == 0.0
    assert rows["coulomb.f_c"]["std"] is not None


def test_bounds_hold_and_are_reported(curve):
    from lieid_casadi.effects import Coefficient
    from lieid_casadi.effects.viscous import Viscous

    class Thick(Viscous):
        name = "thick"
        coefficients = (Coefficient("f", "N·m·s/rad", lower=2.0),)

    fit = fit_friction(curve, ["coulomb", Thick()])
    assert fit.coefficients[1] == pytest.approx(2.0, abs=1e-9)
    assert any(isinstance(w, BoundWarning) and "thick.f:1" in str(w) for w in fit.warnings)


def test_negative_friction_is_reported(curve, fit):
    lower = dataclasses.replace(curve, friction=curve.friction - 2.5)
    found = fit_friction(lower, "coulomb,viscous").warnings
    assert any(isinstance(w, NotDissipativeWarning) for w in found)
    assert not any(
        isinstance(w, NotDissipativeWarning | ExtrapolationWarning) for w in fit.warnings
    )


def test_extreme_friction_below_the_slowest_run_is_reported(curve):
    steep = dataclasses.replace(curve, friction=1.0 + 3.0 * np.exp(-((curve.speed / 0.04) ** 2)))
    fit = fit_friction(steep, "coulomb,stribeck")
    assert fit.friction(1e-3)[0] == pytest.approx(4.0, rel=0.02)
    (found,) = [w for w in fit.warnings if isinstance(w, ExtrapolationWarning)]
    assert "below the slowest measured speed of 0.0349 rad/s" in str(found)


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ("coulomb:2", "coulomb:2 does not act on joint 1"),
        ("coulom", "unknown effect"),
        ("gao2017", "needs temperature"),
        ("transmission_coupling", "couples two joints"),
        ("", "no effects given"),
    ],
)
def test_effects_must_be_of_the_joint(curve, effects, message):
    with pytest.raises(EffectError, match=message):
        fit_friction(curve, effects)


def test_fits_are_written_and_drawn(fit):
    content = json.loads(json.dumps(fit.to_dict(), allow_nan=False))
    assert content["effects"] == TRUTH.split(",")
    assert len(fit.plot().axes[0].get_lines()) >= 3
    assert "RMS" in fit._repr_html_()


@pytest.fixture(scope="module")
def whole():
    model = lieid.Model(ROBOT, "coulomb,viscous,offset,stribeck:1,load_friction:1")
    return lieid.identify(model, [excitation(0), excitation(1)], processing=CUTOFF)


def friction_of(fit, curve):
    """Friction of joint 1 by a fit of the whole arm at the points of a curve."""
    columns = steady_columns(fit.compiled, 0, curve.speed, fit.shapes, load=curve.load)
    return columns @ fit.effect_coefficients


def test_a_curve_and_a_fit_of_the_whole_arm_agree(curve, fit, whole):
    of_arm = friction_of(whole, curve)
    for own in (curve.friction, fit.predicted):
        assert np.linalg.norm(own - of_arm) < 0.03 * np.linalg.norm(of_arm)


@pytest.fixture(scope="module")
def simple_model():
    """The paper's model of the first stage (Eq. 11)."""
    return lieid.Model(ROBOT, "coulomb,viscous,viscous_polynomial,offset")


@pytest.fixture(scope="module")
def staged(simple_model):
    motion = plant.sweep(ROBOT, 0, speeds=SPEEDS, pose=[0.0, 0.4])
    t = np.arange(0.0, motion.duration, 0.004)
    return lieid.identify_in_stages(
        simple_model, [excitation(0), excitation(1)], {0: measured(t, motion.at(t))}, TRUTH,
        processing=CUTOFF, friction_processing=CUTOFF,
    )  # fmt: skip


@pytest.mark.slow
def test_stages_and_one_fit_agree(staged, whole):
    curve = staged.friction[0].curve
    of_arm = friction_of(whole, curve)
    difference = staged.friction[0].predicted - of_arm
    assert np.linalg.norm(difference) < 0.05 * np.linalg.norm(of_arm)
    kept = [p.label for p in staged.fit.model.placements]
    assert {"offset:1", "coulomb:2", "stribeck:1", "viscous_polynomial:2"} <= set(kept)
    assert "viscous_polynomial:1" not in kept
    json.dumps(staged.to_dict(), allow_nan=False)


def test_friction_of_stages_predicts_a_new_run(staged, tmp_path):
    new = excitation(7)
    error = [lieid.compare(f, new).rms_moving[0] for f in (staged.first_stage, staged.fit)]
    assert error[1] < 0.5 * error[0]
    assert staged.fit.rms_train[0] < staged.first_stage.rms_train[0]
    staged.fit.save(tmp_path / "stages.json")
    again = lieid.Fit.load(tmp_path / "stages.json")
    np.testing.assert_allclose(again.predict(new), staged.fit.predict(new), atol=1e-12)
    assert np.all(np.isfinite(staged.fit.std))
    assert [source.name for source in staged.fit.provenance.recordings] == ["run"] * 3


@pytest.mark.slow
def test_third_stage_corrects_friction_that_grows_with_speed(staged, whole):
    """A cubic fitted to runs up to 0.6 rad/s is wrong at the speeds of the excitation."""
    runs = [excitation(0), excitation(1)]
    slow = plant.sweep(ROBOT, 0, speeds=SPEEDS[:7], pose=[0.0, 0.4])
    t = np.arange(0.0, slow.duration, 0.004)
    curve = friction_curve(
        staged.first_stage, measured(t, slow.at(t)), 0, processing=CUTOFF, load="model"
    )
    friction = {0: fit_friction(curve, f"{TRUTH},viscous_polynomial")}
    two, three = (
        combine_stages(staged.first_stage, friction, runs, refit=refit) for refit in (False, True)
    )
    new = excitation(7)
    error = [lieid.compare(f, new).rms_moving[0] for f in (two, three, whole)]
    assert error[1] < 0.5 * error[0]
    assert error[1] < 1.2 * error[2]
    # dry friction is that of the curve, friction that grows with speed that of the excitation
    numbers = [{r["name"]: r for r in f.parameter_table() if r["joint"] == 1} for f in (two, three)]
    for name in ("coulomb.f_c", "stribeck.f_s-f_c", "load_friction.f_tau", "stribeck.v_s"):
        assert numbers[1][name]["value"] == numbers[0][name]["value"]
        assert numbers[1][name]["std"] == pytest.approx(numbers[0][name]["std"])
    assert numbers[1]["viscous.f_v"]["std"] < numbers[0]["viscous.f_v"]["std"]


def test_stages_need_friction_runs(simple_model):
    with pytest.raises(ModelError, match="no friction runs given"):
        lieid.identify_in_stages(simple_model, excitation(0), {})


def test_effects_that_a_curve_does_not_determine_keep_their_first_stage(staged, curve, tmp_path):
    """Offset and asymmetric friction cancel in the curve; the first stage has the offset."""
    friction = {0: fit_friction(curve, f"{TRUTH},offset,viscous_asymmetric")}
    combined = combine_stages(staged.first_stage, friction, [excitation(0)], refit=False)
    labels = [p.label for p in combined.model.placements]
    assert labels.count("offset:1") == 1
    assert "viscous_asymmetric:1" not in labels
    offsets = [
        [row["value"] for row in f.parameter_table() if row["name"] == "offset.f_b"]
        for f in (staged.first_stage, combined)
    ]
    assert offsets[0] == offsets[1]
    combined.save(tmp_path / "fit.json")
    assert lieid.Fit.load(tmp_path / "fit.json").model.effects == combined.model.effects
