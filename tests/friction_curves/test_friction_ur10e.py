"""Friction of joint 2 of a real UR10e from friction runs and from excitation."""

import pytest
from real_arms import UR10E, needs

import lieid_casadi as lieid
from lieid_casadi.friction_curves import fit_friction, friction_curve
from lieid_casadi.recording import Processing

pytestmark = needs(UR10E / "joint_2_alone_currents.csv.gz")
GAINS = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)
CUTOFF = Processing(cutoff=7.0)
EFFECTS = "coulomb,viscous,load_friction"


@pytest.fixture(scope="module")
def robot():
    return lieid.Robot.from_urdf(UR10E / "ur10e.urdf")


@pytest.fixture(scope="module")
def alone():
    return lieid.Recording.load(UR10E / "joint_2_alone_currents.csv.gz", torque_constants=GAINS)


@pytest.fixture(scope="module")
def excitation():
    return [lieid.Recording.load(UR10E / f"excitation_{k}s.csv.gz") for k in (30, 50)]


@pytest.fixture(scope="module")
def whole(robot, excitation):
    model = lieid.Model(robot, "armature,coulomb,viscous,offset,load_friction:2+3")
    return lieid.identify(model, excitation, processing=CUTOFF)


def numbers(rows, joint=2):
    return {r["name"]: r["value"] for r in rows if r["joint"] == joint}


def test_curve_and_load_dependence_agree_with_the_excitation_runs(robot, alone, whole):
    curve = friction_curve(robot, alone, 1, processing=CUTOFF)
    fit = fit_friction(curve, EFFECTS)
    own, others = numbers(fit.parameter_table()), numbers(whole.parameter_table())
    assert own["load_friction.f_tau"] == pytest.approx(others["load_friction.f_tau"], rel=0.1)
    assert own["coulomb.f_c"] == pytest.approx(others["coulomb.f_c"], rel=0.1)
    assert own["viscous.f_v"] == pytest.approx(others["viscous.f_v"], rel=0.1)
    assert fit.correlation > 0.98
    assert fit.rms < 0.05 * curve.friction.mean()
