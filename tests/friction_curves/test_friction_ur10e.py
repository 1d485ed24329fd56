"""Friction of joint 2 of a real UR10e from friction runs and from excitation."""

import pytest
from real_arms import UR10E, needs, ur10e_fit

import lieid_casadi as lieid
from lieid_casadi.friction_curves import fit_friction, friction_curve

pytestmark = needs(UR10E / "joint_2_alone_currents.csv.gz")
GAINS = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)
EFFECTS = "coulomb,viscous,load_friction"


def numbers(rows, joint=2):
    return {r["name"]: r["value"] for r in rows if r["joint"] == joint}


def test_curve_and_load_dependence_agree_with_the_excitation_runs():
    alone = lieid.Recording.load(UR10E / "joint_2_alone_currents.csv.gz", torque_constants=GAINS)
    whole = ur10e_fit("armature,coulomb,viscous,offset,load_friction:2+3")
    curve = friction_curve(whole.model.robot, alone, 1, processing=whole.processing)
    fit = fit_friction(curve, EFFECTS)
    own, others = numbers(fit.parameter_table()), numbers(whole.parameter_table())
    assert own["load_friction.f_tau"] == pytest.approx(others["load_friction.f_tau"], rel=0.1)
    assert own["coulomb.f_c"] == pytest.approx(others["coulomb.f_c"], rel=0.1)
    assert own["viscous.f_v"] == pytest.approx(others["viscous.f_v"], rel=0.1)
    assert fit.correlation > 0.98
    assert fit.rms < 0.05 * curve.friction.mean()
