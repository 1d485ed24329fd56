"""Dynamics and kinematics of arms whose lengths, axes, tool and gravity are symbols."""

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from robot.random_arms import random_arm, random_link, random_states, to_pinocchio

import lieid_casadi as lieid
from lieid_casadi.dynamics.symbolic_lengths import symbolic_lengths
from lieid_casadi.errors import ModelError


def arm_of(*values):
    """An arm of three joints with a length, an angle of an axis, a tool and gravity as symbols."""
    length, angle, tool, g = values
    c, s = (np.cos, np.sin) if isinstance(angle, float) else (ca.cos, ca.sin)
    axis = [0, c(angle), s(angle)]
    point = [length, 0, 0]
    moment = [point[1] * axis[2] - point[2] * axis[1], -length * s(angle), length * c(angle)]
    random = np.random.default_rng(7)
    return lieid.Robot.from_screws(
        [[0, 0, 1, 0, 0, 0], [*axis, *moment], [0, 0, 0, 1, 0, 0]],
        [{}, {"xyz": [length, 0, 0], "rpy": [angle, 0, 0]}, {"xyz": [2 * length, 0, 0.1]}],
        links=[random_link(random) for _ in range(3)],
        tool={"xyz": [0, tool, 0], "rpy": [0, 0, tool]},
        gravity=[0.3, g, 0],
    )


VALUES = {"length": 0.5, "angle": 0.7, "tool": 0.2, "g": -9.7}


@pytest.fixture(scope="module")
def pair():
    symbols = [ca.SX.sym(name) for name in VALUES]
    return lieid.symbolic(arm_of(*symbols)), lieid.symbolic(arm_of(*VALUES.values()))


def test_every_function_is_that_of_the_numbers(pair):
    general, numeric = pair
    random = np.random.default_rng(1)
    for name in general.names:
        function, expected = getattr(general, name), getattr(numeric, name)
        given = {k: random.uniform(-1, 1, expected.size_in(k)) for k in expected.name_in()}
        theirs = expected(**given)
        ours = function(**given, **{k: v for k, v in VALUES.items() if k in function.name_in()})
        assert function.name_in()[: expected.n_in()] == expected.name_in()
        for key, value in theirs.items():
            scale = max(1.0, np.abs(value.full()).max())
            np.testing.assert_allclose(ours[key].full(), value.full(), rtol=0, atol=1e-10 * scale)


def test_frames_take_the_symbols(pair):
    names = [str(symbol) for symbol in pair[0].model.robot.symbols]
    symbols = [VALUES[name] for name in names]
    q = [0.1, -0.4, 0.2]
    for frame in ("link2", "tool"):
        for name in ("forward_kinematics", "jacobian"):
            ours, theirs = (getattr(x.frame(frame), name) for x in pair)
            np.testing.assert_allclose(ours(q, *symbols), theirs(q), atol=1e-14)


def test_symbols_may_be_differentiated_by(pair):
    """∂(pose of the tool)/∂length by CasADi, against a difference quotient."""
    general, _ = pair
    function = general.forward_kinematics
    at = {"q": [0.1, -0.4, 0.2]} | VALUES
    length = ca.SX.sym("length")
    pose = function(**(at | {"length": length}))["T"]
    slope = ca.Function("slope", [length], [ca.jacobian(pose[:3, 3], length)])(0.5).full()[:, 0]
    near = [function(**(at | {"length": x}))["T"].full()[:3, 3] for x in (0.5 - 1e-6, 0.5 + 1e-6)]
    np.testing.assert_allclose(slope, (near[1] - near[0]) / 2e-6, atol=1e-9)


def test_whole_arm_effects_with_symbols():
    """A payload, a tilt and a wrench at a tool whose place is a symbol."""
    effects = "coulomb,payload,base_tilt,external_wrench"
    symbols = [ca.SX.sym(name) for name in VALUES]
    functions = [
        lieid.symbolic(lieid.Model(robot, effects), free=["payload"]).inverse_dynamics
        for robot in (arm_of(*symbols), arm_of(*VALUES.values()))
    ]
    random = np.random.default_rng(2)
    given = {k: random.uniform(0, 1, functions[1].size_in(k)) for k in functions[1].name_in()}
    ours, theirs = functions[0](**given, **VALUES)["tau"], functions[1](**given)["tau"]
    np.testing.assert_allclose(ours, theirs, rtol=1e-11)


@pytest.mark.parametrize("seed", range(4))
def test_random_arms_with_symbolic_lengths_are_pinocchios(seed):
    robot = random_arm(np.random.default_rng(seed), 3 + seed)
    made = symbolic_lengths(robot)
    arm = lieid.symbolic(made.robot)
    model = to_pinocchio(robot)
    data = model.createData()
    for q, dq, ddq in zip(*random_states(np.random.default_rng(seed), robot, 3), strict=True):
        tau = pin.rnea(model, data, q, dq, ddq)
        ours = arm.inverse_dynamics(q=q, dq=dq, ddq=ddq, **made.values)["tau"].full()[:, 0]
        np.testing.assert_allclose(ours, tau, rtol=0, atol=1e-12 * np.abs(tau).max())


def test_base_parameters_follow_from_the_matrix():
    made = symbolic_lengths(lieid.robots.panda())
    arm = lieid.symbolic(made.robot)
    q, dq, ddq = np.random.default_rng(3).uniform(-1, 1, (3, 7))
    base = arm.base_matrix(**made.values)["B"].full() @ made.robot.link_parameters
    regressor = arm.base_regressor(q=q, dq=dq, ddq=ddq, **made.values)["Yb"].full()
    tau = arm.inverse_dynamics(q=q, dq=dq, ddq=ddq, **made.values)["tau"].full()[:, 0]
    np.testing.assert_allclose(regressor @ base, tau, rtol=0, atol=1e-12 * np.abs(tau).max())


def test_a_symbol_named_as_an_input_is_refused():
    robot = arm_of(ca.SX.sym("q"), 0.1, 0.2, -9.81)
    with pytest.raises(ModelError, match="the symbol 'q' has the name of an input"):
        _ = lieid.symbolic(robot).mass_matrix
