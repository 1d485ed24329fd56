"""Base parameters with lengths as symbols, against those with the numbers.

`test_base_parameters` compares the latter with the numerical rank of Pinocchio's regressor.
"""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from real_arms import URDFS
from robot.random_arms import random_arm

from lieid_casadi import Model, Robot, robots
from lieid_casadi.dynamics.base_parameters import base_parameters
from lieid_casadi.dynamics.symbolic_lengths import symbolic_lengths
from lieid_casadi.errors import ModelError

FRICTION = "coulomb,viscous,offset,armature"


def check(robot, effects="", tolerance=1e-9):
    made = symbolic_lengths(robot)
    general, numeric = Model(made.robot, effects).base, Model(robot, effects).base
    np.testing.assert_array_equal(general.kept, numeric.kept)
    scale = np.abs(numeric.combination).max()
    np.testing.assert_allclose(
        general.at(made.values), numeric.combination, rtol=0, atol=tolerance * scale
    )
    return general


@pytest.mark.parametrize("effects", ["", FRICTION])
@pytest.mark.parametrize("name", ["panda", "panda_luo2024", "two_link"])
def test_bundled(name, effects):
    check(getattr(robots, name)(), effects)


@pytest.mark.real
@pytest.mark.parametrize(("path", "lock"), URDFS)
def test_real_arms(path, lock):
    check(Robot.from_urdf(path, lock=lock), FRICTION)


@given(seed=st.integers(0, 10_000), n=st.integers(2, 4))
@settings(max_examples=6, deadline=None)
def test_random_arms(seed, n):
    """Revolute and prismatic joints, axes in any direction, some off their link frames."""
    check(random_arm(np.random.default_rng(seed), n), tolerance=1e-6)


def test_expressions_have_the_lengths():
    base = base_parameters(symbolic_lengths(robots.two_link()).robot)
    shown = [base.expression(k) for k in range(base.count)]
    assert shown == ["mcx1 + d2 m2", "mcy1", "Izz1 + d2² m2", "mcx2", "mcy2", "Izz2"]
    panda = base_parameters(symbolic_lengths(robots.panda()).robot)
    assert "mcx3 + d4 (m4 + m5 + m6 + m7)" in [panda.expression(k) for k in range(panda.count)]
    assert panda.symbols == {"d3", "d4", "d5x", "d5y", "d7"}
    with pytest.raises(ModelError, match="expected numbers"):
        panda.lift(np.zeros(panda.count))


def twisted(twist):
    """Three joints with a twist of the second axis."""
    c, s = (np.cos, np.sin) if isinstance(twist, float) else (ca.cos, ca.sin)
    axis, point = np.array([0, -s(twist), c(twist)]), np.array([0.4, 0, 0])
    moment = [0, -point[0] * axis[2], point[0] * axis[1]]
    return Robot.from_screws(
        [[0, 0, 1, 0, 0, 0], [*axis, *moment], [*axis, 0, 0, 0]],
        [{}, {"xyz": list(point), "rpy": [twist, 0, 0]}, {"rpy": [twist, 0, 0]}],
    )


def test_angles_as_symbols():
    twist = ca.SX.sym("twist")
    general, numeric = base_parameters(twisted(twist)), base_parameters(twisted(0.7))
    np.testing.assert_array_equal(general.kept, numeric.kept)
    np.testing.assert_allclose(general.at({"twist": 0.7}), numeric.combination, atol=1e-10)
    assert any("cos(twist)" in general.expression(k) for k in range(general.count))


def test_other_functions_of_symbols_are_refused():
    length = ca.SX.sym("length")
    robot = Robot.from_screws([[0, 0, 1, 0, 0, 0]], [{"xyz": [ca.exp(length), 0, 0]}])
    with pytest.raises(ModelError, match="depends on length is no polynomial of low degree"):
        base_parameters(robot)
