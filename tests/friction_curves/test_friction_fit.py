"""Friction models fitted to curves."""

import dataclasses

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
    measured,
)
from plant.motions import constant_speeds

from lieid_casadi.errors import (
    EffectError,
    NotDissipativeWarning,
    UnidentifiableWarning,
)
from lieid_casadi.friction_curves import fit_friction, friction_curve

TRUTH = "coulomb,viscous,stribeck,load_friction"


@pytest.fixture(scope="module")
def curve():
    motion = constant_speeds(ROBOT, 0, speeds=SPEEDS, pose=[0.0, 0.4])
    t = np.arange(0.0, motion.duration, 0.004)
    return friction_curve(ROBOT, measured(t, motion.at(t)), 0, processing=CUTOFF)


@pytest.fixture(scope="module")
def fit(curve):
    return fit_friction(curve, TRUTH)


def test_parameters_of_the_plant_are_found(fit):
    truth = np.array([COULOMB, VISCOUS, EXTRA, LOAD, WIDTH])
    found = np.concatenate([fit.coefficients, fit.shapes])
    assert np.abs((found - truth) / fit.std).max() < 4.0
    assert np.all(fit.std < 0.1 * truth)
    values = {row["name"]: row["value"] for row in fit.parameter_table()}
    assert values["coulomb.f_c"] == pytest.approx(COULOMB, abs=0.05)
    assert values["viscous.f_v"] == pytest.approx(VISCOUS, rel=0.03)
    assert values["stribeck.f_s-f_c"] == pytest.approx(EXTRA, rel=0.05)
    assert values["stribeck.v_s"] == pytest.approx(WIDTH, rel=0.05)
    assert values["load_friction.f_tau"] == pytest.approx(LOAD, rel=0.05)
    assert fit.rms < 0.01
    assert fit.correlation > 0.999


def test_the_papers_model_fits_equally_with_more_parameters(curve, fit):
    paper = fit_friction(curve, "viscous,viscous_polynomial,stribeck/two_width,load_friction/paper")
    assert len(paper.parameters) == 10
    assert paper.rms < 1.05 * fit.rms


def test_an_effect_with_memory_is_in_steady_state_on_a_curve(curve):
    dahl, coulomb = (fit_friction(curve, f"viscous,{name}") for name in ("presliding", "coulomb"))
    np.testing.assert_allclose(dahl.predicted, coulomb.predicted, rtol=1e-6)


def test_the_default_model_has_load_friction_where_the_load_varies(curve):
    assert fit_friction(curve).effects == tuple(TRUTH.split(","))
    constant = dataclasses.replace(curve, load=np.ones(len(curve)))
    assert fit_friction(constant).effects == ("coulomb", "viscous", "stribeck")


def test_parameters_that_a_curve_does_not_determine_are_reported(curve):
    fit = fit_friction(curve, "coulomb,viscous,offset,viscous_asymmetric")
    reported = " ".join(str(w) for w in fit.warnings if isinstance(w, UnidentifiableWarning))
    assert "offset.f_b:1" in reported
    assert "viscous_asymmetric.f:1" in reported
    rows = {row["name"]: row for row in fit.parameter_table()}
    assert rows["offset.f_b"]["std"] is None
    assert rows["offset.f_b"]["value"] == 0.0
    assert rows["coulomb.f_c"]["std"] is not None


def test_negative_friction_is_reported(curve, fit):
    lower = dataclasses.replace(curve, friction=curve.friction - 2.5)
    found = fit_friction(lower, "coulomb,viscous").warnings
    assert any(isinstance(w, NotDissipativeWarning) for w in found)
    assert not any(isinstance(w, NotDissipativeWarning) for w in fit.warnings)


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ("coulomb:2", "coulomb:2 does not act on joint 1"),
        ("coulom", "unknown effect"),
        ("warm_up", "is not friction of speed and load"),
        ("transmission_coupling", "couples two joints"),
        ("", "no effects given"),
    ],
)
def test_effects_must_be_of_the_joint(curve, effects, message):
    with pytest.raises(EffectError, match=message):
        fit_friction(curve, effects)
