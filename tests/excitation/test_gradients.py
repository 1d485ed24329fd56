"""Gradients and Jacobians of a design against finite differences."""

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi.errors import ExcitationError
from lieid_casadi.excitation import (
    CartesianSpeed,
    Obstacle,
    SelfCollision,
    Torque,
    Wall,
    capsules_of,
)
from lieid_casadi.excitation.criteria import (
    NAMES,
    AOptimal,
    Condition,
    EOptimal,
    Hadamard,
    LogDet,
    UnitNormColumns,
    stages,
)
from lieid_casadi.excitation.design import ExcitationProblem, make_design, random_start
from lieid_casadi.excitation.information import InformationMatrix
from lieid_casadi.excitation.trajectory import MotionSamples, make

STEP = 1e-6


def gram(size, seed=0):
    rows = np.random.default_rng(seed).normal(size=(3 * size, size)) * np.logspace(0, -1, size)
    return rows.T @ rows


CRITERIA = [
    Hadamard(), LogDet(), AOptimal(np.eye(6)), EOptimal(np.eye(6), 3.0),
    Condition(np.eye(6), 1.0), Condition(np.tril(np.full((6, 6), 0.5)) + np.eye(6), 8.0),
    UnitNormColumns(Condition(np.eye(6), 4.0)), UnitNormColumns(LogDet()),
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


def test_unit_norm_columns():
    g = gram(6)
    norms = np.sqrt(np.diag(g))
    assert np.isclose(
        UnitNormColumns(LogDet()).evaluate(g)[0],
        -np.linalg.slogdet(g / np.outer(norms, norms))[1] / 6,
    )
    scale = np.diag(np.arange(1.0, 7.0))
    value = UnitNormColumns(Condition(np.eye(6), 4.0)).evaluate
    assert np.isclose(value(g)[0], value(scale @ g @ scale)[0])


def test_values_of_criteria():
    g = np.diag([4.0, 9.0])
    assert np.isclose(LogDet().evaluate(g)[0], -0.5 * np.log(36.0))
    assert np.isclose(Hadamard().evaluate(g)[0], -0.5 * np.log(6.0))
    assert np.isclose(AOptimal(np.eye(2)).evaluate(g)[0], np.log(1 / 4 + 1 / 9))
    assert np.isclose(EOptimal(np.eye(2), 200.0).evaluate(g)[0], -np.log(4.0), atol=1e-3)


def test_names_of_criteria():
    for name in NAMES[1:]:
        assert stages(name, np.eye(3))
    with pytest.raises(ExcitationError, match="expected one of combined"):
        stages("best", np.eye(3))


@pytest.mark.parametrize(
    ("robot", "effects"),
    [
        ("two_link", ["coulomb", "viscous", "offset", "stribeck", "load_friction"]),
        ("panda", ["coulomb", "viscous_polynomial", "armature"]),
    ],
)
def test_gradient_of_an_objective_in_the_free_variables(robot, effects):
    model = lieid.Model(lieid.Robot.load(robot), effects=effects)
    design = make_design(model, basis=make(harmonics=3), samples=40, limits=())
    problem = ExcitationProblem(design)
    z = random_start(problem, 3)
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
    model = lieid.Model(lieid.robots.two_link(), effects=["coulomb", "load_friction", "viscous"])
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.normal(size=(3, 20, 2))
    dq = np.sign(dq) * (0.5 + np.abs(dq))
    information = InformationMatrix(model, sign_width=np.full(2, 1e-3))
    rows = information.at(MotionSamples(np.arange(20.0), q, dq, ddq)).rows
    arm = lieid.compile(model)
    load = arm.inverse_dynamics(q, dq, ddq, model.robot.link_parameters)
    expected = arm.base_regressor(q, dq, ddq, load=load)
    np.testing.assert_allclose(
        rows.reshape(model.base.count, 2, 20), expected.transpose(2, 1, 0), atol=1e-12
    )


@pytest.mark.parametrize("effect", ["temperature_friction", "presliding", "bias_drift"])
def test_effects_that_no_motion_excites_are_refused(effect):
    from lieid_casadi.effects.registry import REGISTER

    if effect not in REGISTER:
        pytest.skip(f"no effect {effect}")
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


def test_bundled_capsules_of_the_panda_are_used():
    assert len(capsules_of(lieid.robots.panda())) == 8
