"""Base parameters against the rank of regressors (of Pinocchio), and with lengths as symbols."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from real_arms import FINGERS, PANDA, TX40, UR10E, URDFS, needs
from robot.random_arms import random_arm, random_link, shift_to_axes, to_pinocchio

from lieid_casadi import Model, robots
from lieid_casadi.dynamics import symbolic_lengths
from lieid_casadi.dynamics.base_parameters import EnergyColumn, base_parameters
from lieid_casadi.dynamics.symbolic_lengths import Polynomial, lengths_of, symbolic_base
from lieid_casadi.errors import ModelError
from lieid_casadi.robot import Joint, Robot

SAMPLES = 60
Z, X, Y = np.eye(3)[2], np.eye(3)[0], np.eye(3)[1]
POINTS = np.array([[0.0, 0, 0], [0.3, 0, 0.1], [0.6, 0.2, 0], [0.6, 0.5, 0.3]])


def arm(axes, *, gravity=(0, 0, -9.81), sliding=()):
    joints = []
    for k, axis in enumerate(axes):
        home = np.eye(4)
        home[:3, 3] = POINTS[k]
        slides = k in sliding
        screw = np.r_[np.zeros(3), axis] if slides else np.r_[axis, -np.cross(axis, POINTS[k])]
        joints.append(Joint(f"j{k}", screw, home, link=random_link(np.random.default_rng(k))))
    return Robot("special", tuple(joints), np.array(gravity, float))


SPECIAL = {
    "parallel first axes along gravity": arm([Z, Z, X, Y]),
    "all axes parallel, along gravity": arm([Z, Z, Z, Z]),
    "all axes parallel, across gravity": arm([X, X, X, X]),
    "prismatic along gravity": arm([Z, Y, Y], sliding=(0,)),
    "three prismatic": arm([Z, X, Y, Y], sliding=(0, 1, 2)),
    "zero gravity": arm([Z, Y, X, Y], gravity=(0, 0, 0)),
    "prismatic, zero gravity": arm([Z, Y, X], gravity=(0, 0, 0), sliding=(1,)),
}


def stacked(robot, seed=0):
    """Pinocchio's regressor, and armature and offset columns, over random states."""
    model = to_pinocchio(robot)
    data, shift = model.createData(), shift_to_axes(robot)
    rng = np.random.default_rng(seed)
    blocks = []
    for _ in range(SAMPLES):
        q, dq, ddq = rng.uniform(-2.0, 2.0, size=(3, robot.n))
        links = pin.computeJointTorqueRegressor(model, data, q, dq, ddq) @ shift
        blocks.append(np.hstack([links, np.diag(ddq), np.eye(robot.n)]))
    return np.vstack(blocks)


def base_with_effects(robot):
    n = robot.n
    extra = [EnergyColumn(kind, j) for kind in ("armature", "offset") for j in range(n)]
    return base_parameters(robot, extra, [f"{c.kind}{c.joint + 1}" for c in extra])


def rank(matrix):
    sizes = np.linalg.svd(matrix, compute_uv=False)
    return int(np.sum(sizes > 1e-9 * sizes[0]))


def check(robot):
    whole = stacked(robot)
    for base, columns in (
        (base_parameters(robot), whole[:, : 10 * robot.n]),
        (base_with_effects(robot), whole),
    ):
        assert base.count == rank(columns)
        error = columns - columns[:, base.kept] @ base.combination
        # scanning from the first column can need combinations of 10⁶ and more, which amplify
        # the rounding in the regressor itself
        amplified = max(1.0, np.abs(base.combination).max() / 1e5)
        assert np.abs(error).max() <= 1e-10 * amplified * np.abs(columns).max()


@pytest.mark.parametrize("name", SPECIAL)
def test_special_geometry(name):
    check(SPECIAL[name])


@pytest.mark.parametrize("name", ["panda", "panda_luo2024", "two_link"])
def test_bundled(name):
    check(getattr(robots, name)())


@pytest.mark.parametrize(
    ("path", "lock", "count"),
    [
        pytest.param(UR10E / "ur10e.urdf", (), 36, marks=needs(UR10E / "ur10e.urdf")),
        pytest.param(TX40 / "tx40.urdf", (), 36, marks=needs(TX40 / "tx40.urdf")),
        pytest.param(PANDA / "panda.urdf", FINGERS, 43, marks=needs(PANDA / "panda.urdf")),
    ],
)
@pytest.mark.real
def test_real_arms(path, lock, count):
    robot = Robot.from_urdf(path, lock=lock)
    assert base_parameters(robot).count == count
    check(robot)


@pytest.mark.parametrize("seed", range(8))
def test_random_arms(seed):
    rng = np.random.default_rng(seed)
    check(random_arm(rng, 2 + seed % 8))


@given(seed=st.integers(0, 10_000), n=st.integers(2, 6))
@settings(max_examples=10, deadline=None)
def test_columns_are_scanned_from_the_first(seed, n):
    """Every kept column is independent of those before it, every dropped one is not."""
    robot = random_arm(np.random.default_rng(seed), n)
    whole, base = stacked(robot), base_with_effects(robot)
    scale = np.linalg.norm(whole, axis=0)
    whole = whole / np.where(scale > 1e-9, scale, 1.0)
    kept = set(base.kept.tolist())
    orthonormal = np.zeros((len(whole), 0))
    for k, column in enumerate(whole.T):
        rest = column - orthonormal @ (orthonormal.T @ column)
        rest -= orthonormal @ (orthonormal.T @ rest)
        independent = np.linalg.norm(rest) > 1e-7
        assert (k in kept) == independent, base.names[k]
        if independent:
            orthonormal = np.column_stack([orthonormal, rest / np.linalg.norm(rest)])


def test_lift_gives_the_base_values_back_nearest_to_the_prior():
    robot = robots.panda()
    base = base_parameters(robot)
    rng = np.random.default_rng(3)
    values = rng.normal(size=base.count)
    lifted = base.lift(values, robot.link_parameters)
    np.testing.assert_allclose(base.combination @ lifted, values, atol=1e-12)
    null = np.linalg.svd(base.combination)[2][base.count :]
    assert np.abs(null @ (lifted - robot.link_parameters)).max() < 1e-12


FRICTION = "coulomb,viscous,offset,armature"


def check_symbolic(robot, effects="", tolerance=1e-9):
    numeric = Model(robot, effects).base
    general, used = symbolic_base(robot, lambda changed: Model(changed, effects).base)
    values = {length.name: length.value for length in lengths_of(robot)}
    entries = [x.at(values) if isinstance(x, Polynomial) else x for x in general.combination.flat]
    np.testing.assert_allclose(
        np.reshape(entries, general.combination.shape), numeric.combination,
        rtol=0, atol=tolerance * np.abs(numeric.combination).max(),
    )  # fmt: skip
    return [general.expression(k) for k in range(general.count)], {x.name for x in used}


def test_expressions_have_the_lengths():
    shown, _ = check_symbolic(robots.two_link(), "coulomb")
    assert shown[:6] == ["mcx1 + d2 m2", "mcy1", "Izz1 + d2² m2", "mcx2", "mcy2", "Izz2"]
    shown, used = check_symbolic(robots.panda(), FRICTION)
    assert "mcx3 + d4 (m4 + m5 + m6 + m7)" in shown
    assert used == {"d3", "d4", "d5x", "d5y", "d7"}


@pytest.mark.real
@pytest.mark.parametrize(("path", "lock"), URDFS)
def test_real_arms_with_symbols(path, lock):
    check_symbolic(Robot.from_urdf(path, lock=lock), FRICTION)


@given(seed=st.integers(0, 10_000), n=st.integers(2, 3))
@settings(max_examples=6, deadline=None)
def test_random_arms_with_symbols(seed, n):
    """Revolute and prismatic joints, axes in any direction, some off their link frames."""
    check_symbolic(random_arm(np.random.default_rng(seed), n), tolerance=1e-6)


def test_an_arm_whose_parameters_are_no_polynomials_is_refused(monkeypatch):
    """Four axes in any directions; those of real arms are parallel, perpendicular or meet."""
    monkeypatch.setattr(symbolic_lengths, "MOST_TERMS", 200)
    with pytest.raises(ModelError, match=r"no polynomial of low degree.*without --symbolic"):
        check_symbolic(random_arm(np.random.default_rng(247), 4))
