"""Single terms of formulas that whole fits hardly depend on, each against something independent."""

import numpy as np
import pytest
from scipy.optimize import least_squares

import lieid_casadi as lieid
from lieid_casadi.compiled.triangular_factors import Triangle
from lieid_casadi.errors import ModelError
from lieid_casadi.identification.regression.cross_validation import with_whole_fit
from lieid_casadi.identification.regression.least_squares import (
    Factor,
    JointRows,
    Rows,
    robust,
    solve,
    stacked,
)
from lieid_casadi.identification.uncertainty.covariance import hac_covariance
from lieid_casadi.identification.uncertainty.noise_model import motion_ratio_of
from lieid_casadi.recording.filtering import central_difference

ROBOT = lieid.robots.two_link()


def rows_of(matrix, torque):
    count = len(torque)
    columns, instants = np.arange(matrix.shape[1]), np.arange(count)
    return Rows([JointRows(columns, matrix, torque, instants)], len(columns), np.array([0, count]))


@pytest.mark.parametrize("dq", [-0.7, 0.7])
@pytest.mark.parametrize("load", [-3.0, 3.0])
def test_a_motor_drives_its_load_or_is_driven_by_it(dq, load):
    """The drive delivers power against friction and load when both have the same sign."""
    model = lieid.Model(ROBOT, "load_friction/motoring:1")
    sizes = {"f_motor": 0.1, "f_generator": 0.02}
    coefficients = [sizes[c.name.rpartition(".")[2]] for c in model.columns]
    zero, speed, torque = np.zeros((1, 2)), np.array([[dq, 0.0]]), np.array([[load, 0.0]])
    arm = lieid.compile(model)
    columns = arm.effect_columns(zero, speed, zero, load=torque)[0, 0]
    used = sizes["f_motor"] if load * dq > 0 else sizes["f_generator"]
    assert columns @ coefficients == pytest.approx(used * abs(load) * np.sign(dq))


def test_the_shared_rotor_is_accelerated_by_the_other_joint():
    arm = lieid.compile(lieid.Model(ROBOT, "transmission_coupling/rotor:1<2"))
    zero = np.zeros((1, 2))
    columns = arm.effect_columns(zero, zero, np.array([[5.0, 0.3]]))[0, 0]
    np.testing.assert_allclose(columns, [0.0, 0.0, 0.3])


def test_the_robust_fit_minimizes_hubers_loss():
    """Against SciPy's minimization of the loss, with the noise that the fit found."""
    random = np.random.default_rng(0)
    matrix = random.normal(size=(300, 3))
    torque = matrix @ [1.0, -2.0, 0.5] + 0.1 * random.normal(size=300)
    torque[::7] += random.uniform(0.2, 3.0, size=len(torque[::7]))
    found = robust(rows_of(matrix, torque), np.ones(1))
    threshold = 1.345 * found.noise[0]
    expected = least_squares(
        lambda beta: matrix @ beta - torque, np.zeros(3), loss="huber", f_scale=threshold,
        xtol=1e-12, ftol=1e-12, gtol=1e-12,
    ).x  # fmt: skip
    np.testing.assert_allclose(solve(found.factor).values, expected, atol=3e-4)


def test_columns_of_the_noise_of_encoders_alone_have_no_values():
    """As those of joints that stand still: divided by their size they gave values of 1e11."""
    random = np.random.default_rng(2)
    matrix = random.normal(size=(200, 2)) * [1.0, 1e-11]
    values = solve(stacked(rows_of(matrix, random.normal(size=200)))).values
    assert abs(values[1]) < 1e-6


def test_the_covariance_counts_the_noise_that_the_fit_absorbed():
    """White noise of a stated size, and one parameter for every ten rows."""
    random = np.random.default_rng(1)
    count, width, sigma = 200, 20, 0.3
    matrix = random.normal(size=(count, width))
    unit = np.linalg.inv(matrix.T @ matrix)
    ratios = []
    for _ in range(60):
        torque = sigma * random.normal(size=count)
        residual = torque - matrix @ (unit @ (matrix.T @ torque))
        covariance = hac_covariance(rows_of(matrix, torque), [np.ones(count)], [residual], unit)
        ratios.append(np.median(np.diag(covariance) / (sigma**2 * np.diag(unit))))
    assert 0.97 < np.mean(ratios) < 1.2  # 0.9 without what was absorbed


@pytest.mark.parametrize("rate", [20.0, 1000.0])
def test_a_numerical_velocity_is_per_second(rate):
    """Exact for a parabola, at the ends too."""
    t = np.arange(0.0, 1.0, 1.0 / rate)
    velocity = central_difference((3.0 * t**2 - t)[:, None], rate)
    np.testing.assert_allclose(velocity[:, 0], 6.0 * t - 1.0, atol=1e-9)


def test_functions_of_single_joints_refuse_effects_on_the_whole_arm():
    """They left them out silently: 2 kg at the tool changed nothing."""
    compiled = lieid.compile(lieid.Model(lieid.robots.panda(), "coulomb,payload"))
    motion = tuple(np.random.default_rng(3).uniform(-1.5, 1.5, (3, 4, 7)))
    coefficients = np.linspace(0.1, 0.5, len(compiled.model.columns))
    for call in (
        lambda: compiled.effect_torque(*motion, coefficients),
        lambda: compiled.effect_columns(*motion),
        lambda: compiled.base_regressor(*motion),
    ):
        with pytest.raises(ModelError, match=r"payload.*lieid.symbolic"):
            call()
    friction = compiled.effect_torque(*motion, coefficients, joint_effects_only=True)
    coulomb = np.sign(motion[1]) * coefficients[:7]
    np.testing.assert_allclose(friction, coulomb, atol=1e-12)


WHOLE = np.array([1.0, 2.0])  # values of the fit of all rows


def factor(matrix, torque):
    triangle = Triangle(3)
    triangle.add(np.asarray(matrix, dtype=float), np.asarray(torque, dtype=float))
    return Factor(triangle.r, len(matrix))


@pytest.mark.parametrize(("excited", "second"), [(1e-3, 2.0), (0.5, 7.0)])
def test_a_fold_keeps_what_its_rows_do_not_determine(excited, second):
    """The other rows alone give (3, 7); they hardly depend on the second parameter, or they do."""
    rest = factor([[1.0, 0.0], [0.0, excited]], [3.0, 7.0 * excited])
    held = factor([[0.0, 1.0]], [2.0])
    np.testing.assert_allclose(solve(rest).values, [3.0, 7.0])
    found = solve(with_whole_fit(rest, held, WHOLE)).values
    np.testing.assert_allclose(found, [3.0, second], atol=0.01)


SURE = np.ones(900)


def test_stationary_noise_has_ratio_one():
    random = np.random.default_rng(0)
    ratios = [
        motion_ratio_of(random.standard_normal(900), SURE, np.arange(900), 1.0, 30)
        for _ in range(200)
    ]
    assert np.mean(np.array(ratios) > 1.0) < 0.12  # the test's level is 5 %
    assert np.max(ratios) < 1.4


def test_rows_with_uncertain_friction_are_no_dependence_on_the_motion():
    random = np.random.default_rng(3)
    uncertain = np.arange(900) % 150 < 12
    residual = random.standard_normal(900) * np.where(uncertain, 10.0, 1.0)
    weights = np.where(uncertain, 0.3, 1.0)
    assert motion_ratio_of(residual, weights, np.arange(900), 1.0, 30) == 1.0
    assert motion_ratio_of(weights * residual, SURE, np.arange(900), 1.0, 30) > 1.2
