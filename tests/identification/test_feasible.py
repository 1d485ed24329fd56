"""Physically consistent parameters, checked by independent means."""

from dataclasses import replace

import numpy as np
import pytest
from robot.random_arms import random_arm, random_states, to_pinocchio

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.errors import BoundWarning, IdentificationError, NominalInertiaWarning, NoSolution
from lieid_casadi.recording import Processing

ROBOT = lieid.robots.panda()
EFFECTS = "coulomb,viscous,offset,armature"
CUTOFF = Processing(cutoff=8.0)
FRICTION = plant.JointFriction(np.linspace(1.2, 0.3, 7), np.linspace(0.8, 0.2, 7), np.zeros(7))


def measured(robot=ROBOT, *effects, friction=FRICTION, duration=15.0, noise=0.05, seed=1):
    arm = plant.Arm(robot, plant.perturbed_inertias(robot, seed=3), friction, tuple(effects))
    motion = plant.FourierTrajectory(robot, base_frequency=1 / duration, seed=seed)
    t = np.arange(0.0, duration, 0.005)
    sensors = plant.Sensors(rate=200.0, torque_noise=noise)
    return arm, plant.measure_along(arm, t, *motion.at(t), sensors=sensors, seed=seed)


@pytest.fixture(scope="module")
def panda_run():
    return measured()


def consistent(recording, robot=ROBOT, effects=EFFECTS, **options):
    return lieid.identify(
        lieid.Model(robot, effects),
        recording,
        method="feasible",
        processing=CUTOFF,
        **options,
    )


@pytest.fixture(scope="module")
def panda_fit(panda_run):
    return consistent(panda_run[1])


def with_links(robot, links):
    joints = [replace(j, link=link) for j, link in zip(robot.joints, links, strict=True)]
    return replace(robot, joints=tuple(joints), source=None)


def test_bodies_are_possible_by_pinocchio(panda_fit):
    """Density of a body from its principal moments and mass; M(q) by Pinocchio's CRBA."""
    import pinocchio as pin

    links = panda_fit.link_parameters.reshape(-1, 10)
    for m, *rest in links:
        inertia = pin.Inertia.FromDynamicParameters(np.array([m, *rest]))
        moments = np.linalg.eigvalsh(inertia.inertia)
        assert m > 0.0
        assert moments[0] > 0.0
        assert moments[0] + moments[1] > moments[2]  # triangle inequality, principal moments
    model = to_pinocchio(with_links(ROBOT, links))
    data = model.createData()
    q, _, _ = random_states(np.random.default_rng(5), ROBOT, 300)
    least = min(np.linalg.eigvalsh(pin.crba(model, data, pose)).min() for pose in q)
    certificate = panda_fit.certificate
    assert certificate.holds
    assert 0.0 < certificate.mass_matrix_eigenvalue < 1.1 * least
    assert certificate.poses == 10_000
    assert panda_fit.physically_consistent


def test_prediction_is_as_good_as_that_of_least_squares(panda_run, panda_fit):
    """On a new motion of an arm whose true parameters are feasible, it must not be worse."""
    least = lieid.identify(panda_fit.model, panda_run[1], processing=CUTOFF)
    _, fresh = measured(noise=0.0, seed=2)
    errors = []
    for fit in (least, panda_fit):
        (segment,) = lieid.recording.process(fresh, fit.processing)
        errors.append(segment.filter(segment.tau) - fit.predict_processed(segment))
    wls, feasible = (np.sqrt(np.mean(error**2)) for error in errors)
    assert feasible < 1.05 * wls
    assert np.all(panda_fit.certificate.cost < 0.05)
    np.testing.assert_allclose(panda_fit.certificate.rms_wls, least.rms_train, rtol=1e-9)


def test_impossible_least_squares_values_are_corrected():
    """A torque sensor of the wrong sign on the elbow gives impossible inertias."""
    robot = lieid.robots.two_link()
    friction = plant.JointFriction.none(2)
    _, recording = measured(robot, plant.TorqueGain(1, -1.6), friction=friction, duration=20.0)
    model = lieid.Model(robot, "viscous,armature:2")
    least = lieid.identify(model, recording, processing=CUTOFF)
    fit = consistent(recording, robot, "viscous,armature:2")
    values = dict(zip([p.label for p in model.base_columns], least.values, strict=True))
    assert values["Izz2"] < 0.0
    assert fit.certificate.holds
    assert np.all(fit.effect_coefficients >= 0.0)
    assert fit.rms_train[1] > 2.0 * least.rms_train[1]


def test_coefficients_at_a_bound_are_reported():
    robot = lieid.robots.two_link()
    _, recording = measured(
        robot, plant.Armature(1, -0.2), friction=plant.JointFriction.none(2), duration=20.0
    )
    fit = consistent(recording, robot, "viscous,armature")
    assert np.all(fit.effect_coefficients[2:] >= 0.0)
    (warning,) = [w for w in fit.warnings if isinstance(w, BoundWarning)]
    assert "armature.I_a:2" in str(warning)
    assert "least squares gives -0.1" in str(warning)


@pytest.mark.parametrize("seed", [0, 1])
def test_random_arms_are_always_feasible(seed):
    """Arbitrary axes, prismatic joints, gravity of any direction; nominal bodies 40 % off."""
    rng = np.random.default_rng(seed)
    robot = random_arm(rng, int(rng.integers(2, 6)))
    n = robot.n
    friction = plant.JointFriction(rng.uniform(0.1, 1, n), rng.uniform(0.1, 1, n), np.zeros(n))
    arm = plant.Arm(robot, plant.perturbed_inertias(robot, spread=0.4, seed=seed), friction)
    q, dq, ddq = _wander(rng, n)
    recording = plant.measure_along(
        arm,
        np.arange(len(q)) * 0.01,
        q,
        dq,
        ddq,
        sensors=plant.Sensors(rate=None, torque_noise=0.2),
    )
    fit = consistent(recording, robot)
    assert fit.certificate.holds
    assert np.all(fit.certificate.cost < 0.05)


def _wander(rng, n, samples=1000):
    t = np.arange(samples)[:, None] * 0.01
    q = dq = ddq = np.zeros((samples, n))
    for k in range(1, 6):
        w, a, phase = 2 * np.pi * 0.1 * k, rng.uniform(-0.3, 0.3, n), rng.uniform(0, 6, n)
        q = q + a * np.sin(w * t + phase)
        dq = dq + a * w * np.cos(w * t + phase)
        ddq = ddq - a * w**2 * np.sin(w * t + phase)
    return q, dq, ddq


def test_a_solver_that_does_not_converge_raises(panda_run, monkeypatch):
    monkeypatch.setattr("lieid_casadi.identification.feasible.problem.MAX_ITERATIONS", 3)
    with pytest.raises(NoSolution, match=r"its limit of 200 iterations; give a larger"):
        consistent(panda_run[1], regularization=1e-3)


def test_negative_masses_are_refused(panda_run):
    links = ROBOT.link_parameters.reshape(-1, 10).copy()
    links[2, 0] *= -1.0
    with pytest.raises(IdentificationError, match=r"link 'panda_joint3' has a mass of -\d"):
        consistent(panda_run[1], with_links(ROBOT, links))


def test_links_without_inertia_get_spheres_as_reference(panda_run):
    """Without nominal inertias the error must not increase either."""
    fit = consistent(panda_run[1], with_links(ROBOT, [None] * 7))
    assert fit.certificate.holds
    assert np.all(fit.certificate.cost < 0.05)


def test_an_impossible_nominal_inertia_is_corrected_and_reported(panda_run):
    links = ROBOT.link_parameters.reshape(-1, 10).copy()
    links[6, 4:] = 0.0  # all mass in one point away from the origin, and less than that
    fit = consistent(panda_run[1], with_links(ROBOT, links), regularization=1e-3)
    assert fit.certificate.holds
    (warning,) = [w for w in fit.warnings if isinstance(w, NominalInertiaWarning)]
    assert "panda_joint7" in str(warning)


def test_options_are_checked(panda_run):
    model, recording = lieid.Model(ROBOT, EFFECTS), panda_run[1]
    with pytest.raises(IdentificationError, match="expected one of ols, wls, robust, feasible"):
        lieid.identify(model, recording, method="best")
    for options in ({"method": "wls", "regularization": 1.0}, {"regularization": -1.0}):
        with pytest.raises(IdentificationError, match="above 0 with method='feasible'"):
            lieid.identify(model, recording, **{"method": "feasible"} | options)
