"""Physically consistent parameters, checked by independent means."""

from dataclasses import replace

import numpy as np
import pytest
from plant.recordings import recorded
from robot.random_arms import random_arm, random_link, random_states, to_pinocchio

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.errors import BoundWarning, IdentificationError, NominalInertiaWarning, NoSolution
from lieid_casadi.identification.feasible.dissipation import dissipation_rows
from lieid_casadi.identification.feasible.problem import ConvexSolver, FeasibleProblem
from lieid_casadi.identification.regression.least_squares import Factor, triangular
from lieid_casadi.recording import Processing
from lieid_casadi.robot.inertia import pseudo_inertia

ROBOT = lieid.robots.panda()
EFFECTS = "coulomb,viscous,offset,armature"
CUTOFF = Processing(cutoff=8.0)
FRICTION = plant.JointFriction(np.linspace(1.2, 0.3, 7), np.linspace(0.8, 0.2, 7), np.zeros(7))


def measured(robot=ROBOT, *effects, friction=FRICTION, duration=15.0, noise=0.05, seed=1):
    arm = plant.Arm(robot, plant.perturbed_inertias(robot, seed=3), friction, tuple(effects))
    sensors = plant.Sensors(rate=200.0, torque_noise=noise)
    return arm, recorded(arm, seed, seconds=duration, step=0.005, sensors=sensors)


@pytest.fixture(scope="module")
def panda_run():
    return measured()


def consistent(recording, robot=ROBOT, effects=EFFECTS, **options):
    model, options = lieid.Model(robot, effects), {"processing": CUTOFF} | options
    return lieid.identify(model, recording, method="feasible", **options)


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
    sensors = plant.Sensors(rate=None, torque_noise=0.2)
    recording = recorded(arm, seed, step=0.01, sensors=sensors)
    fit = consistent(recording, robot)
    assert fit.certificate.holds
    assert np.all(fit.certificate.cost < 0.05)


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


def rows_of(model, rng, samples=400, noise=0.3):
    """Factor of random states of an arm whose true inertias differ from the references."""
    compiled = lieid.compile(model)
    q, dq, ddq = (rng.normal(0.0, s, (samples, model.n)) for s in (1.0, 1.0, 3.0))
    truth = np.concatenate([random_link(rng) for _ in range(model.n)])
    coefficients = rng.uniform(0.1, 1.0, len(model.columns))
    matrix = compiled.base_regressor(q, dq, ddq).reshape(-1, model.base.count)
    torque = matrix @ model.base.combination @ np.concatenate([truth, coefficients])
    torque = torque + rng.normal(0.0, noise, len(torque))
    return Factor(triangular(np.column_stack([matrix, torque]) / noise), len(torque))


def friction_rows(model, *, velocity, load):
    given = {
        "velocity": velocity,
        "load": load,
        "temperature": 0.0,
        "lower": -np.pi,
        "upper": np.pi,
    }
    signals = {name: np.full(model.n, value) for name, value in given.items()}
    return dissipation_rows(lieid.compile(model), model.initial_shapes, **signals)


def problem_of(model, factor, rng):
    references = np.array([pseudo_inertia(random_link(rng)) for _ in range(model.n)])
    friction = friction_rows(model, velocity=2.0, load=20.0)
    return FeasibleProblem.of(model, references, friction, factor)


def test_friction_dissipates_between_the_points_of_the_grid():
    """Data of friction that drives the joint at speed: f_v2 below −f_v/v."""
    rng = np.random.default_rng(9)
    model = lieid.Model(lieid.robots.two_link(), "coulomb,viscous,viscous_polynomial,offset")
    compiled = lieid.compile(model)
    q, dq, ddq = (rng.normal(0.0, s, (600, 2)) for s in (1.0, 0.8, 3.0))
    columns = compiled.base_regressor(q, dq, ddq).reshape(-1, model.base.count)
    names = [c.name for c in model.columns]
    wanted = {"coulomb.f_c": 0.2, "viscous.f_v": 1.0, "offset.f_b": -3.0}
    wanted |= {"viscous_polynomial.f_v2": -1.5, "viscous_polynomial.f_v3": 0.1}
    friction = np.array([wanted[name] for name in names])
    # joint 2 is dissipative without constraints
    friction[names.index("viscous_polynomial.f_v2") + 2] = -0.3
    truth = np.concatenate([model.robot.link_parameters, friction])
    torque = columns @ model.base.combination @ truth + rng.normal(0, 0.01, len(columns))
    factor = Factor(triangular(np.column_stack([columns, torque]) / 0.01), len(torque))
    problem = problem_of(model, factor, rng)
    solution = ConvexSolver(problem).solve(factor, 1e-3)
    coefficients = dict(zip([c.label for c in model.columns], solution[20:], strict=True))
    v = np.linspace(1e-4, 2.0, 2000)
    driving = 0.2 + v - 1.5 * v**2 + 0.1 * v**3
    assert driving.min() < -0.5
    for j in ("1", "2"):
        found = [coefficients[f"{name}:{j}"] for name in wanted if name != "offset.f_b"]
        assert np.polynomial.polynomial.polyval(v, found).min() > -0.01
        assert coefficients[f"offset.f_b:{j}"] < -1.0  # the offset is not constrained
    # a negative coefficient alone is not constrained
    assert coefficients["viscous_polynomial.f_v2:2"] == pytest.approx(-0.3, abs=0.05)


def test_coupled_joints_dissipate_together():
    """f_v·q̇₁ on joint 2: alone it can drive, with enough friction on both joints it cannot."""
    model = lieid.Model(lieid.robots.two_link(), "viscous,transmission_coupling:2<1")
    rows = friction_rows(model, velocity=1.0, load=0.0)
    own = ["viscous.f_v:1", "viscous.f_v:2"]
    coupling = ["transmission_coupling.f_v:2<1", "transmission_coupling.f_c:2<1"]
    assert [c.label for c in model.columns] == [*own, *coupling]
    # [1, c/2; c/2, 1] is positive semidefinite iff |c| ≤ 2
    assert (rows @ [1.0, 1.0, 1.9, 0.0]).min() >= 0.0
    assert (rows @ [1.0, 1.0, 2.1, 0.0]).min() < 0.0
    # dry friction of the coupling alone drives at some speeds
    assert (rows @ [1.0, 1.0, 0.0, 0.5]).min() < 0.0


def test_coupled_joints_of_a_whole_arm_are_examined_on_a_part_of_their_motions():
    robot = lieid.robots.panda()
    couplings = [f"transmission_coupling:{j + 2}<{j + 1}" for j in range(robot.n - 1)]
    model = lieid.Model(robot, ["viscous", "load_friction", "torque_ripple:4", *couplings])
    rows = friction_rows(model, velocity=1.0, load=1.0)
    values = np.array([float(c.label.startswith("viscous")) for c in model.columns])
    assert (rows @ values).min() > 0.0
    for j in range(robot.n):  # friction that drives one joint alone, and no other
        (column,) = (k for k, c in enumerate(model.columns) if c.label == f"viscous.f_v:{j + 1}")
        driving = values.copy()
        driving[column] = -1e-3
        assert (rows @ driving).min() < 0.0


def test_friction_with_load_and_states_reaches_full_sliding():
    model = lieid.Model(lieid.robots.two_link(), "presliding/load:1,viscous:1")
    rows = friction_rows(model, velocity=2.0, load=10.0)
    # columns z/w → 1, |load|, q̇: f_c + f_τ·|τ| + f_v·v over |τ| in 0, 5, 10 and v up to 2
    assert (rows @ [1.0, -0.09, 0.0]).min() == pytest.approx(0.1, abs=1e-6)
    assert (rows @ [1.0, 0.0, -0.4]).min() == pytest.approx(0.2, abs=1e-6)
