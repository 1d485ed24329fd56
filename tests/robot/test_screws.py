"""`Robot.from_screws`: numbers and SX, and what it refuses."""

import casadi as ca
import numpy as np
import pytest
from robot.random_arms import random_arm

import lieid_casadi as lieid
from lieid_casadi.errors import RobotError

TURN = [0, 0, 1, 0, 0, 0]


def two_link(length, twist=0.0, gravity=-9.81):
    return lieid.Robot.from_screws(
        [TURN, [0, 0, 1, 0, -length, 0]],
        [np.eye(4), {"xyz": [length, 0, 0], "rpy": [twist, 0, 0]}],
        tool={"xyz": [0.4, 0, 0]},
        gravity=[0, gravity, 0],
    )


def test_numbers_give_the_robot_itself():
    robot = random_arm(np.random.default_rng(3), 5)
    made = lieid.Robot.from_screws(
        [j.screw for j in robot.joints],
        [j.home for j in robot.joints],
        links=[j.link for j in robot.joints],
        tool=robot.tool,
        gravity=robot.gravity,
        limits=[j.limits for j in robot.joints],
        joint_names=[j.name for j in robot.joints],
    )
    assert not made.symbols
    for ours, given in zip(made.joints, robot.joints, strict=True):
        np.testing.assert_array_equal(ours.axis, given.axis)
        np.testing.assert_array_equal(ours.home, given.home)
        assert (ours.name, ours.limits) == (given.name, given.limits)
    np.testing.assert_array_equal(made.link_parameters, robot.link_parameters)


def test_symbols_and_their_values():
    robot = two_link(ca.SX.sym("a"), ca.SX.sym("twist"), -ca.SX.sym("g"))
    assert [str(symbol) for symbol in robot.symbols] == ["a", "twist", "g"]
    numbers = robot.with_values({"a": 0.5, "twist": 0.3, "g": 9.81})
    expected = two_link(0.5, 0.3)
    assert not numbers.symbols
    for ours, theirs in zip(numbers.joints, expected.joints, strict=True):
        np.testing.assert_allclose(ours.screw, theirs.screw, atol=1e-15)
        np.testing.assert_allclose(ours.home, theirs.home, atol=1e-15)
    np.testing.assert_array_equal(numbers.gravity, expected.gravity)


def test_a_matrix_of_symbols_is_a_home():
    length = ca.SX.sym("length")
    home = ca.SX.eye(4)
    home[0, 3] = length
    robot = lieid.Robot("arm", (lieid.Joint("turn", ca.SX([0, 0, 1, 0, 0, 0]), home),))
    assert robot.joints[0].screw.dtype == float
    assert [str(symbol) for symbol in robot.symbols] == ["length"]


L = ca.SX.sym("L")
REFUSED = {
    "not of unit length": (([[0, 0, 2, 0, 0, 0]], [np.eye(4)]), "expected |ω| = 1"),
    "with pitch": (([[0, 0, 1, 0, 0, 0.1]], [np.eye(4)]), "ω·v = 0.1"),
    "symbols not of unit length": (([[0, L, L, 0, 0, 0]], [np.eye(4)]), "expected |ω| = 1"),
    "five numbers": (([TURN[:5]], [np.eye(4)]), "screw: 5 numbers; expected 6"),
    "text": (([[0, 0, 1, 0, "a", 0]], [np.eye(4)]), "'a'; expected numbers or SX"),
    "one home too few": (([TURN], []), "1 screws and 0 homes"),
    "no joint": (([], []), "expected at least one"),
    "no rotation": (([TURN], [2.0 * np.eye(4)]), "found no rotation and translation"),
    "MX symbols": (([ca.MX.sym("screw", 6)], [np.eye(4)]), "MX symbols; expected numbers or SX"),
    "unknown key": (([TURN], [{"position": [0, 0, 1]}]), "unknown key 'position'"),
    "two symbols of a name": (
        ([TURN], [{"xyz": [L, ca.SX.sym("L"), 0]}]),
        "two symbols are named 'L'",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refusals(name):
    arguments, words = REFUSED[name]
    with pytest.raises(RobotError) as error:
        lieid.Robot.from_screws(*arguments)
    assert words in str(error.value)


def test_values_of_other_names():
    robot = two_link(L)
    with pytest.raises(RobotError, match="'L' has no value"):
        robot.with_values({})
    with pytest.raises(RobotError, match="'M' has a value and is no symbol"):
        robot.with_values({"L": 0.5, "M": 1.0})


@pytest.mark.parametrize(("name", "use"), [("compile", lieid.compile), ("excite", lieid.excite)])
def test_what_needs_numbers_names_the_symbols(name, use):
    with pytest.raises(RobotError, match=f"{name} needs numbers, and robot 'robot' has the symbol"):
        use(lieid.Model(two_link(L)))
