"""Criteria, the information matrix, the model that a design evaluates, and Eq. 19 as printed."""

import casadi as ca
import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi.errors import ExcitationError, NotCountedWarning
from lieid_casadi.excitation import CartesianSpeed, Obstacle, SelfCollision, Torque, Wall, excite
from lieid_casadi.excitation.criteria import (
    Condition,
    ExpressionCriterion,
    Hadamard,
    InformationMatrix,
    LogDet,
    design_model,
)
from lieid_casadi.excitation.design import ExcitationProblem
from lieid_casadi.excitation.search import Search
from lieid_casadi.excitation.trajectory import (
    Fourier,
    MotionSamples,
    Parametrization,
    Trajectory,
    null_space,
)

PANDA = lieid.robots.panda()
ROBOT = lieid.robots.two_link()
STEP = 1e-6


def gram(size, seed=0):
    rows = np.random.default_rng(seed).normal(size=(3 * size, size)) * np.logspace(0, -1, size)
    return rows.T @ rows


CRITERIA = [
    Hadamard(), LogDet(),
    Condition(np.eye(6), 1.0), Condition(np.tril(np.full((6, 6), 0.5)) + np.eye(6), 8.0),
]  # fmt: skip


@pytest.mark.parametrize("criterion", CRITERIA, ids=lambda c: f"{c.name}")
def test_derivative_of_a_criterion(criterion):
    g = gram(6)
    change = np.random.default_rng(1).normal(size=(6, 6))
    change = STEP * (change + change.T)
    value, slope = criterion.evaluate(g)
    difference = criterion.evaluate(g + change)[0] - criterion.evaluate(g - change)[0]
    assert np.isclose(2.0 * np.sum(slope * change), difference, rtol=1e-5)
    np.testing.assert_allclose(slope, slope.T, rtol=1e-9, atol=1e-12 * np.abs(slope).max())
    assert np.isfinite(value)


def test_the_smooth_condition_number_is_a_close_upper_bound():
    g = gram(8, seed=3)
    sizes = np.linalg.eigvalsh(g)
    true = 0.5 * np.log(sizes[-1] / sizes[0])
    values = [Condition(np.eye(8), p).evaluate(g)[0] for p in (1.0, 4.0, 16.0, 64.0)]
    assert all(a > b - 1e-12 for a, b in zip(values, [*values[1:], true], strict=True))
    assert values[-1] - true < np.log(8) / 64.0


@pytest.mark.parametrize(
    ("robot", "effects"),
    [
        ("two_link", ["coulomb", "viscous", "offset", "stribeck", "load_friction"]),
        ("panda", ["coulomb", "viscous_polynomial", "armature"]),
    ],
)
def test_gradient_of_an_objective_in_the_free_variables(robot, effects):
    model = lieid.Model(lieid.Robot.load(robot), effects=effects)
    problem = ExcitationProblem(model, basis=Fourier(harmonics=3), samples=40, limits=())
    z = problem.random_start(3)
    direction = np.random.default_rng(4).normal(size=z.size)
    for criterion in (LogDet(), Condition(problem.metric, 2.0)):
        near = LogDet().evaluate(problem.gram(z))[0] + 0.1
        objective = problem.objective(criterion, ceiling=near)
        here = objective(z)
        ahead, behind = objective(z + STEP * direction), objective(z - STEP * direction)
        slope = (ahead.value - behind.value) / (2.0 * STEP)
        assert np.isclose(here.gradient @ direction, slope, rtol=1e-4, atol=1e-7)
        bounded = (ahead.excess - behind.excess) / (2.0 * STEP)
        np.testing.assert_allclose(here.slopes @ direction, bounded, rtol=1e-4, atol=1e-7)


def test_information_matrix_uses_the_regressor_of_the_model():
    """With a sign that is sharp at these speeds, Y_b equals that of the compiled model."""
    model = lieid.Model(ROBOT, effects=["coulomb", "load_friction", "viscous", "warm_up:2"])
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.normal(size=(3, 20, 2))
    dq = np.sign(dq) * (0.5 + np.abs(dq))
    information = InformationMatrix(model, sign_width=np.full(2, 1e-3))
    rows = information.rows(MotionSamples(np.arange(20.0), q, dq, ddq))
    arm = lieid.compile(model)
    load = arm.inverse_dynamics(q, dq, ddq, model.robot.link_parameters)
    expected = arm.base_regressor(q, dq, ddq, load=load, time=np.arange(20.0))
    np.testing.assert_allclose(
        rows.reshape(model.base.count, 2, 20), expected.transpose(2, 1, 0), atol=1e-12
    )


@pytest.mark.parametrize("effect", ["temperature_friction", "presliding", "bias_drift"])
def test_effects_that_no_motion_excites_are_refused(effect):
    model = lieid.Model(lieid.robots.two_link(), effects=[effect])
    with pytest.raises(ExcitationError, match=effect):
        InformationMatrix(model, sign_width=np.ones(2))


@pytest.mark.parametrize(
    "limit",
    [
        Torque(), CartesianSpeed(1.0), SelfCollision(), Wall((0.0, 1.0, -2.0), 0.4),
        Obstacle((0.3, -0.2, 0.1), (0.6, 0.2, 0.5)),
    ],
    ids=lambda limit: type(limit).__name__,
)  # fmt: skip
def test_jacobian_of_a_limit(limit):
    robot = lieid.robots.panda()
    limits = limit.on(robot)
    rng = np.random.default_rng(7)
    low, high = robot.limit("position_lower"), robot.limit("position_upper")
    q = rng.uniform(low, high, (30, 7))
    dq, ddq = rng.normal(size=(2, 30, 7))
    jacobian = limits.jacobian(MotionSamples(np.arange(30.0), q, dq, ddq))
    assert jacobian.shape == (len(limits.labels), 21, 30)
    for kind, signal in enumerate((q, dq, ddq)):
        change = rng.normal(size=signal.shape)
        sides = []
        for sign in (1.0, -1.0):
            moved = [x.copy() for x in (q, dq, ddq)]
            moved[kind] = signal + sign * STEP * change
            sides.append(limits.values(MotionSamples(np.arange(30.0), *moved)))
        expected = (sides[0] - sides[1]) / (2.0 * STEP)
        found = np.einsum("kjt,tj->kt", jacobian[:, 7 * kind : 7 * kind + 7], change)
        # closest points jump where they are not unique; nowhere else do the two differ
        close = np.isclose(found, expected, rtol=1e-4, atol=1e-5)
        assert close.mean() > 0.98
        if isinstance(limit, Torque | CartesianSpeed | Wall):
            assert close.all()


def test_thresholds_of_the_combined_criterion_end_the_search():
    """Eq. 20 as printed: below Δ₁ with −log det at most Δ₂, verified, in fewer iterations."""

    def solved(**thresholds):
        model, basis = lieid.Model(lieid.robots.two_link()), Fourier(duration=6.0)
        problem = ExcitationProblem(model, basis=basis, limits=(), **thresholds)
        return problem, Search(problem, 0).solve()

    _, full = solved()
    threshold, bound = 1.3 * full.condition_number, full.neg_log_det + 0.5
    problem, early = solved(condition_threshold=threshold, neg_log_det_threshold=bound)
    assert full.condition_number < early.condition_number <= threshold
    assert early.neg_log_det <= bound
    assert problem.within_limits(early.z)
    assert early.iterations < full.iterations


@pytest.mark.parametrize(
    ("effects", "expected", "messages"),
    [
        ("coulomb,viscous", ["coulomb", "viscous"], []),
        ("presliding,viscous", ["coulomb", "viscous"], ["replaced by coulomb in the regressor"]),
        ("presliding/load:2", ["coulomb:2", "load_friction:2"], ["by coulomb and load_friction"]),
        ("coulomb,presliding:1", ["coulomb"], ["presliding:1"]),
        ("viscous,temperature_friction", ["viscous"], ["temperature_friction:1"]),
        ("temperature_friction/exponential", ["viscous"], ["by viscous"]),
        ("viscous,base_tilt,torque_delay:2", ["viscous"], ["base_tilt, torque_delay:2"]),
        ("warm_up", ["warm_up"], []),
    ],
)
def test_effects_of_the_design_model(effects, expected, messages):
    reduced, warnings = design_model(lieid.Model(ROBOT, effects=effects))
    assert reduced.effects == expected
    assert len(warnings) == len(messages)
    for warning, message in zip(warnings, messages, strict=True):
        assert isinstance(warning, NotCountedWarning)
        assert message in str(warning)


MODEL = lieid.Model(ROBOT, effects="coulomb,viscous")
QUICK = {"duration": 6.0, "starts": 1, "limits": ()}


def volume(information):
    return -2.0 * ca.sum1(ca.log(ca.diag(ca.chol(information)))) / information.size1()


def test_a_criterion_of_the_users():
    """−log det as an expression: value, derivative, and the optimum of the built-in criterion."""
    rows = np.random.default_rng(3).normal(size=(30, 6))
    value, slope = ExpressionCriterion(volume, 6).evaluate(rows.T @ rows)
    expected, expected_slope = LogDet().evaluate(rows.T @ rows)
    assert np.isclose(value, expected)
    np.testing.assert_allclose(slope, expected_slope, rtol=1e-9)
    own, named = (excite(MODEL, criterion=c, **QUICK) for c in (volume, "logdet"))
    assert own.criterion == "volume"
    assert np.isclose(own.neg_log_det, named.neg_log_det, atol=0.5)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"limits": ["torque"]}, "limits: 'torque'; expected limits"),
        ({"criterion": lambda g: g}, "shape .*; expected a scalar"),
    ],
)
def test_bad_extensions(options, message):
    with pytest.raises(ExcitationError, match=message):
        excite(MODEL, **{**QUICK, **options})


UNITS = np.array([[2.0, 2.0, 5.0], [1.0, 3.0, 9.0]])


@pytest.fixture(name="p")
def parametrization():
    return Parametrization(Fourier(4, 8.0), np.array([0.3, -0.7]), UNITS)


def test_fourier_series_as_printed():
    rng = np.random.default_rng(0)
    q0, a, b = rng.normal(), rng.normal(size=3), rng.normal(size=3)
    basis = Fourier(3, 20.0)
    t, w = np.linspace(0.0, 20.0, 50), 2.0 * np.pi * 0.05
    expected = q0 + sum(
        a[k - 1] / (k * w) * np.sin(k * w * t) - b[k - 1] / (k * w) * np.cos(k * w * t)
        for k in (1, 2, 3)
    )
    motion = Trajectory(basis, np.concatenate([[q0], a, b])[None]).at(t)
    np.testing.assert_allclose(motion.q[:, 0], expected, atol=1e-12)


def test_rounding_does_not_rotate_the_free_variables():
    """The singular vectors of a null space do rotate: other processors began elsewhere."""
    ends = Fourier(4, 8.0).evaluate(np.array([0.0, 8.0]))
    rows = np.vstack([ends[k] * 8.0**k for k in (0, 1, 2)])
    noise = 1e-14 * np.abs(rows).max() * np.random.default_rng(0).normal(size=rows.shape)
    directions = null_space(rows)
    np.testing.assert_allclose(null_space(rows + noise), directions, atol=1e-9)
    np.testing.assert_allclose(rows @ directions, 0.0, atol=1e-10 * np.abs(rows).max())
    np.testing.assert_allclose(directions.T @ directions, np.eye(directions.shape[1]), atol=1e-12)
    assert directions.shape[1] == rows.shape[1] - np.linalg.matrix_rank(rows)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"duration": 0.0}, "duration: 0 s"),
        ({"duration": float("nan")}, "duration: nan s"),
        ({"harmonics": 1}, "harmonics: 1; expected 2 to 100"),
    ],
)
def test_bad_series(options, message):
    with pytest.raises(ExcitationError, match=message):
        Fourier(**options)
