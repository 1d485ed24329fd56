"""A real UR10e: comparisons against reference results, payload, gains and friction."""

from dataclasses import replace

import numpy as np
import pytest
from real_arms import UR10E, needs, ur10e_fit, ur10e_run

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.comparison.comparison import verdict
from lieid_casadi.comparison.plots import binned_mean
from lieid_casadi.friction_curves import fit_friction, friction_curve
from lieid_casadi.plant.arm import rigid_torques
from lieid_casadi.recording import process
from lieid_casadi.robot.inertia import link_parameters

pytestmark = [pytest.mark.real, needs(UR10E / "ur10e.urdf")]

PLAIN = "coulomb,viscous,offset,armature"


def test_excitation_is_as_good_as_the_reference():
    plain = ur10e_fit(PLAIN)
    comparison = lieid.compare(plain, ur10e_run("excitation_14_harmonics"))
    reference = np.array([2.49, 3.74, 1.42, 0.34, 0.37, 0.31])
    reference_raw = np.array([3.40, 4.45, 1.82, 0.50, 0.58, 0.47])
    assert np.all(comparison.rms < 1.05 * reference)
    assert np.all(comparison.rms_raw < 1.05 * reference_raw)
    np.testing.assert_allclose(comparison.rms, reference, rtol=0.05)
    np.testing.assert_allclose(comparison.torque_rms, [34.2, 101.9, 35.6, 4.9, 4.4, 4.1], rtol=0.02)
    assert np.all(comparison.correlation > 0.99)
    assert np.all(comparison.noise_floor < comparison.rms)


def test_dwells_of_the_wrist_are_reported():
    plain = ur10e_fit(PLAIN)
    comparison = lieid.compare(plain, ur10e_run("point_to_point"))
    reference = np.array([2.58, 3.21, 1.38, 0.23, 1.09, 1.42])
    assert np.all(comparison.rms < 1.07 * reference)
    assert np.flatnonzero(comparison.rest_dominates).tolist() == [4, 5]
    assert "On joints 5, 6 the error at rest" in verdict(comparison)
    assert np.all(comparison.rms_moving[4:] < 0.4)
    assert np.all(comparison.rms_at_rest[4:] > 1.5)


def direction_difference(comparison, joint):
    """Difference of the mean errors of both directions at small and at large |load|, N·m."""
    (series,) = comparison.series
    sign, load = series.sign[:, joint], np.abs(series.load[:, joint])
    edges = np.percentile(load, [0.0, 25.0, 75.0, 100.0])
    forward, backward = (
        binned_mean(load[sign == s], series.error[sign == s, joint], edges)[1] for s in (1.0, -1.0)
    )
    apart = forward - backward
    return apart[0], apart[-1]


def test_error_depends_on_load_until_friction_grows_with_load():
    plain = ur10e_fit(PLAIN)
    better = ur10e_fit(f"{PLAIN},load_friction:2+3")
    test = ur10e_run("excitation_14_harmonics")
    before, after = lieid.compare(plain, test), lieid.compare(better, test)
    for joint in (1, 2):
        small, large = direction_difference(before, joint)
        assert small < 0.0 < large
        assert large - small > 1.5 * before.rms[joint]
        closed_small, closed_large = direction_difference(after, joint)
        assert abs(closed_large - closed_small) < 0.3 * (large - small)
        assert after.rms[joint] < 0.75 * before.rms[joint]


TRAIN, RUN = ("excitation_30s", "excitation_50s"), "excitation_14_harmonics"
CUTOFF = lieid.Processing(cutoff=7.0)
EFFECTS = "coulomb,viscous,offset"
MASS, COM = 5.0, np.array([0.02, 0.05, 0.1])
GAINS = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)  # as the source states them


def with_body(robot, run):
    """Return the recording with the torque of a body at the tool added."""
    body = link_parameters(MASS, COM, np.diag([0.03, 0.03, 0.02]))
    links = robot.link_parameters
    models = [
        plant.build_pinocchio(robot, x) for x in (links, plant.with_payload(robot, links, body))
    ]
    (segment,) = process(run, CUTOFF)
    bare, loaded = (rigid_torques(m, segment.q, segment.dq, segment.ddq) for m in models)
    extra = [np.interp(run.t, segment.t, column) for column in (loaded - bare).T]
    return replace(run, tau=run.tau + np.column_stack(extra), source_hash="with a body")


def test_an_unloaded_run_has_no_significant_payload():
    fit = ur10e_fit(EFFECTS)
    found = lieid.identify_payload(fit, ur10e_run(RUN))
    assert abs(found.mass) < 3.0 * found.mass_std
    assert found.mass_std < 0.1
    assert found.explained
    whitened = np.linalg.solve(np.linalg.cholesky(found.covariance), found.parameters)
    assert whitened @ whitened < 29.6  # chi-square of ten numbers, p = 0.001


def test_a_body_added_to_measured_torque():
    fit = ur10e_fit(EFFECTS)
    found = lieid.identify_payload(fit, with_body(fit.model.robot, ur10e_run(RUN)))
    assert abs(found.mass - MASS) < 3.0 * found.mass_std
    assert np.all(np.abs(found.com - COM) < 3.5 * found.com_std)
    assert np.all(found.com_std < 5e-3)


def test_gains_from_measured_currents_and_a_body():
    """Close to the gains stated with the recordings, which are themselves uncertain."""
    robot = ur10e_fit(EFFECTS).model.robot

    def amperes(run):
        return replace(run, tau=None, current=run.tau / np.array(GAINS))

    found = lieid.drive_gains(
        robot,
        [amperes(ur10e_run(name)) for name in TRAIN],
        amperes(with_body(robot, ur10e_run(RUN))),
        mass=MASS,
        processing=CUTOFF,
    )
    assert np.all(np.abs(found.gains - np.array(GAINS)) < 3.5 * found.std)
    assert np.all(found.std[1:] < 0.05 * np.array(GAINS[1:]))


FRICTION = "coulomb,viscous,load_friction"


def numbers(rows, joint=2):
    return {r["name"]: r["value"] for r in rows if r["joint"] == joint}


def test_curve_and_load_dependence_agree_with_the_excitation_runs():
    alone = lieid.Recording.load(UR10E / "joint_2_alone_currents.csv.gz", torque_constants=GAINS)
    whole = ur10e_fit("armature,coulomb,viscous,offset,load_friction:2+3")
    curve = friction_curve(whole.model.robot, alone, 1, processing=whole.processing)
    fit = fit_friction(curve, FRICTION)
    own, others = numbers(fit.parameter_table()), numbers(whole.parameter_table())
    assert own["load_friction.f_tau"] == pytest.approx(others["load_friction.f_tau"], rel=0.1)
    assert own["coulomb.f_c"] == pytest.approx(others["coulomb.f_c"], rel=0.1)
    assert own["viscous.f_v"] == pytest.approx(others["viscous.f_v"], rel=0.1)
    assert fit.correlation > 0.98
    assert fit.rms < 0.05 * curve.friction.mean()
