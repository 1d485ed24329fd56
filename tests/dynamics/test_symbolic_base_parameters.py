"""Base parameters with lengths as symbols, against those with the numbers.

`test_base_parameters` compares the latter with the numerical rank of Pinocchio's regressor.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from real_arms import URDFS
from robot.random_arms import random_arm

from lieid_casadi import Model, Robot, robots
from lieid_casadi.dynamics.symbolic_lengths import Polynomial, lengths_of, symbolic_base
from lieid_casadi.errors import ModelError

FRICTION = "coulomb,viscous,offset,armature"


def check(robot, effects="", tolerance=1e-9):
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
    shown, _ = check(robots.two_link(), "coulomb")
    assert shown[:6] == ["mcx1 + d2 m2", "mcy1", "Izz1 + d2² m2", "mcx2", "mcy2", "Izz2"]
    shown, used = check(robots.panda(), FRICTION)
    assert "mcx3 + d4 (m4 + m5 + m6 + m7)" in shown
    assert used == {"d3", "d4", "d5x", "d5y", "d7"}


@pytest.mark.real
@pytest.mark.parametrize(("path", "lock"), URDFS)
def test_real_arms(path, lock):
    check(Robot.from_urdf(path, lock=lock), FRICTION)


@given(seed=st.integers(0, 10_000), n=st.integers(2, 3))
@settings(max_examples=6, deadline=None)
def test_random_arms(seed, n):
    """Revolute and prismatic joints, axes in any direction, some off their link frames."""
    check(random_arm(np.random.default_rng(seed), n), tolerance=1e-6)


def test_an_arm_whose_parameters_are_no_polynomials_is_refused():
    """Four axes in any directions; those of real arms are parallel, perpendicular or meet."""
    with pytest.raises(ModelError, match=r"no polynomial of low degree.*without --symbolic"):
        check(random_arm(np.random.default_rng(247), 4))
