"""Standard deviations against exact formulas and repeated fits, and on other motions."""

import numpy as np
import pytest
from plant.recordings import recorded
from scipy.special import erf

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.identification.regression.least_squares import JointRows, Rows, solve
from lieid_casadi.identification.regression.least_squares import stacked as stack
from lieid_casadi.identification.uncertainty.covariance import (
    hac_covariance,
    prior_rows,
    with_weak_free,
)
from lieid_casadi.identification.uncertainty.noise_model import dry_level, friction_torque_std
from lieid_casadi.recording import Processing, process

ROBOT = lieid.robots.two_link()
EFFECTS = "coulomb,viscous,offset"
FRICTION = plant.JointFriction(np.array([1.2, 0.5]), np.array([0.6, 0.3]), np.array([0.2, -0.1]))
ARM = plant.Arm(ROBOT, plant.perturbed_inertias(ROBOT, seed=3), FRICTION)
CUTOFF = Processing(cutoff=8.0)


def run(*, noise_seed=0, **sensors):
    ideal = plant.Sensors(rate=100.0, **sensors)
    return recorded(ARM, 4, seconds=30.0, step=0.01, sensors=ideal, seed=noise_seed, harmonics=8)


def true_base(model):
    parts = {"coulomb": FRICTION.coulomb, "viscous": FRICTION.viscous, "offset": FRICTION.offset}
    effects = [parts[c.name.split(".")[0]][c.joint] for c in model.columns]
    return model.base.combination @ np.concatenate([ARM.parameters, effects])


def test_a_weak_parameter_is_free_where_a_fit_is_the_prior_of_later_data():
    """Two columns that differ by 2 %: their sum is known, each of them is not."""
    columns = np.array([[1.0, 1.0, 0.0], [1.0, 0.98, 0.0], [0.0, 0.0, 1.0]])
    covariance = np.linalg.inv(columns.T @ columns)
    known = with_weak_free(covariance)
    ratio = np.sqrt(np.diag(known) / np.diag(covariance))
    assert np.all(ratio[:2] > 50.0)
    assert ratio[2] == pytest.approx(1.0)
    both = np.array([1.0, 0.99, 0.0])
    assert both @ known @ both < 3.0 * (both @ covariance @ both)


@pytest.mark.slow
@pytest.mark.parametrize(
    "noise",
    [{"torque_noise": 0.3}, {"coloured_noise": 0.3, "correlation_time": 0.1}],
    ids=["white", "coloured"],
)
def test_intervals_cover_the_truth(noise):
    """80 runs through the whole pipeline: 92-98 % pooled, at least 87 % for each parameter."""
    model = lieid.Model(ROBOT, EFFECTS)
    truth, held = true_base(model), []
    for seed in range(80):
        fit = lieid.identify(model, run(noise_seed=seed, **noise), processing=CUTOFF)
        held.append(np.abs(fit.values - truth) < 1.96 * fit.std)
    share = np.mean(held, axis=0)
    assert 0.92 <= share.mean() <= 0.98
    assert share.min() >= 0.87


def regression(rng, samples=1500, memory=0.0, cross=0.0):
    """Two joints with slow columns of their own and one in common; AR(1) residuals."""
    t = np.arange(samples)
    columns = np.array([np.sin(0.01 * (k + 1) * t + k) for k in range(5)]).T
    gains = np.sqrt(1.0 - memory**2)
    white = rng.standard_normal((samples, 2)) * gains
    white[:, 1] = cross * white[:, 0] + np.sqrt(1 - cross**2) * white[:, 1]
    noise = np.empty_like(white)
    noise[0] = white[0] / gains
    for k in range(1, samples):
        noise[k] = memory * noise[k - 1] + white[k]
    instants = np.arange(samples)
    joints = (
        JointRows(np.array([0, 1, 2]), columns[:, :3], noise[:, 0], instants),
        JointRows(np.array([2, 3, 4]), columns[:, 2:], noise[:, 1], instants),
    )
    return Rows(joints, 5, np.array([0, samples]))


def stacked(rows):
    matrix = np.zeros((2 * int(rows.segments[-1]), rows.count))
    half = int(rows.segments[-1])
    for k, joint in enumerate(rows.joints):
        matrix[k * half : (k + 1) * half, joint.columns] = joint.matrix
    return matrix


@pytest.mark.parametrize(("memory", "cross"), [(0.0, 0.0), (0.9, 0.0), (0.9, 0.7)])
def test_covariance_against_the_exact_one(memory, cross):
    """(XᵀX)⁻¹XᵀΩX(XᵀX)⁻¹ with the Ω of the generated noise; mean variance of 40 samples."""
    found = []
    for seed in range(40):
        rows = regression(np.random.default_rng(seed), memory=memory, cross=cross)
        matrix = stacked(rows)
        unit = np.linalg.inv(matrix.T @ matrix)
        values = unit @ matrix.T @ np.concatenate([j.torque for j in rows.joints])
        ones = [np.ones(len(j.torque)) for j in rows.joints]
        found.append(np.diag(hac_covariance(rows, ones, rows.residuals(values), unit)))
    lag = np.abs(np.subtract.outer(*[np.arange(int(rows.segments[-1]))] * 2))
    omega = np.kron(np.array([[1.0, cross], [cross, 1.0]]), memory**lag)
    exact = np.diag(unit @ matrix.T @ omega @ matrix @ unit)
    # the larger of two estimates is a little too large on average
    ratio = np.sqrt(np.mean(found, axis=0) / exact)
    assert np.all(ratio > 0.93)
    assert np.all(ratio < 1.25)


@pytest.mark.parametrize("difference", [1e-4, 1e-6])
def test_torque_is_certain_where_nearly_equal_columns_are_not(difference):
    """The armature of a joint that is almost perpendicular to the first one, as with π/2 rounded.

    Predicted torque has the uncertainty that it has without one of the two columns.
    """
    rows = regression(np.random.default_rng(3), memory=0.9)
    first, second = rows.joints
    other = np.random.default_rng(4).standard_normal(len(first.matrix))
    copy = first.matrix[:, 1] + difference * other
    wide = JointRows(np.array([0, 1, 2, 5]), np.column_stack([first.matrix, copy]), first.torque,
                     first.instant)  # fmt: skip

    def predicted(rows, columns):
        matrix = stacked(rows)[:, columns]
        solution = solve(stack(rows))
        ones = [np.ones(len(j.torque)) for j in rows.joints]
        residuals = rows.residuals(solution.values)
        covariance = hac_covariance(rows, ones, residuals, solution.unit_covariance)
        own = covariance[np.ix_(columns, columns)]
        return np.sqrt(np.einsum("ri,ij,rj->r", matrix, own, matrix).max())

    plain = predicted(rows, np.arange(5))
    assert predicted(Rows((wide, second), 6, rows.segments), np.arange(6)) < 1.5 * plain


def test_a_prior_does_not_depend_on_units():
    """A parameter of which little is known does not set the others free, whatever its unit."""
    rng = np.random.default_rng(0)
    half = rng.standard_normal((5, 5))
    units = np.array([1.0, 1e-4, 1.0, 1e9, 1e3])
    plain, scaled = (prior_rows((x @ half) @ (x @ half).T) for x in (np.eye(5), np.diag(units)))
    information = units[:, None] * (scaled.T @ scaled) * units
    np.testing.assert_allclose(information, plain.T @ plain, rtol=1e-6)


def test_residuals_that_grow_with_the_motion_are_accounted_for():
    """Noise in proportion to a column: the white formula's variance is three times too small."""
    rng = np.random.default_rng(1)
    samples = 2000
    x = rng.standard_normal(samples)
    instants = np.arange(samples)
    found = []
    for _ in range(20):
        joint = JointRows(np.array([0]), x[:, None], x * rng.standard_normal(samples), instants)
        rows = Rows((joint,), 1, np.array([0, samples]))
        unit = np.array([[1.0 / (x @ x)]])
        value = unit[0] * (x @ joint.torque)
        found.append(hac_covariance(rows, [np.ones(samples)], rows.residuals(value), unit)[0, 0])
    exact = np.sum(x**4) / np.sum(x**2) ** 2
    assert exact > 2.5 / np.sum(x**2)
    assert np.mean(found) == pytest.approx(exact, rel=0.15)


def test_variances_of_dependent_parameters_are_not_negative(tmp_path):
    """At constant velocity the columns of several effects are nearly dependent."""
    t = np.arange(0.0, 8.0, 0.01)
    q, tau = 0.2 * np.column_stack([t, t]), np.column_stack([np.sin(t), np.cos(2.0 * t)])
    recording = lieid.Recording.from_arrays(t, q, None, tau)
    fit = lieid.identify(lieid.Model(ROBOT, "stribeck,load_friction,armature"), recording)
    assert np.all(np.diag(fit.covariance) >= 0.0)
    fit.save(tmp_path / "fit.json")
    np.testing.assert_array_equal(lieid.Fit.load(tmp_path / "fit.json").std, fit.std)


FRICTION_MODEL = lieid.Model(lieid.robots.two_link(), "coulomb,viscous,load_friction")
LEVELS = {"coulomb.f_c:1": 2.0, "coulomb.f_c:2": 0.5, "load_friction.f_tau:2": 0.1}


@pytest.fixture(scope="module")
def segment():
    t = np.arange(0.0, 10.0, 0.01)
    q = np.column_stack([np.sin(1.3 * t), 0.4 * np.cos(2.1 * t)])
    q[(t > 4.0) & (t < 6.0), 1] = q[np.argmax(t > 4.0), 1]
    noise = np.random.default_rng(1).normal(scale=2e-5, size=q.shape)
    recording = lieid.Recording.from_arrays(t, q + noise, tau=np.zeros_like(q))
    (only,) = process(recording, Processing(cutoff=6.0))
    return only


@pytest.fixture(scope="module")
def numbers():
    names = [column.label for column in FRICTION_MODEL.columns]
    coefficients = [LEVELS.get(name, 0.3 if "viscous" in name else 0.0) for name in names]
    return np.concatenate([FRICTION_MODEL.robot.link_parameters, coefficients])


def test_standard_deviation_is_that_of_random_signs(segment, numbers):
    compiled = lieid.compile(FRICTION_MODEL)
    found = friction_torque_std(compiled, segment, np.zeros(0), numbers)
    level = dry_level(compiled, segment, np.zeros(0), numbers)
    ahead = 0.5 * np.abs(segment.ddq) / segment.rate
    mean = erf(3.0 / np.sqrt(2.0) * segment.dq / np.hypot(segment.dead_zone, ahead))
    random = np.random.default_rng(2)
    drawn = []
    for _ in range(4000):
        sign = np.where(random.uniform(-1.0, 1.0, mean.shape) < mean, 1.0, -1.0)
        rest = random.uniform(-1.0, 1.0, (1, 2))  # constant during a rest
        drawn.append(segment.filter(np.where(segment.moving, sign - mean, rest) * level))
    spread = np.sqrt(np.mean(np.square(drawn), axis=0))
    rows = found > 0.15 * found.max(axis=0)
    assert 10 < rows[:, 0].sum() < 0.6 * len(rows)
    np.testing.assert_allclose(found[rows], spread[rows], rtol=0.25)
    assert np.all(np.abs(found - spread)[~rows] < 0.05 * found.max())
