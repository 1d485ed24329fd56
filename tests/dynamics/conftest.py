"""Every arm on which the dynamics are tested, as a `Robot` and as a model of Pinocchio."""

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from real_arms import FINGERS, PANDA, TX40, UR10E, needs
from robot.random_arms import random_arm, random_states, shift_to_axes, to_pinocchio

from lieid_casadi.compiled import compile
from lieid_casadi.dynamics.lie import Motion
from lieid_casadi.model import Model
from lieid_casadi.robot import Robot


@dataclass(frozen=True)
class Arm:
    """A robot, and the same arm in Pinocchio with the tool as a frame."""

    robot: Robot
    pinocchio: pin.Model
    tool: int
    shift: np.ndarray  # matrix that maps our link parameters to Pinocchio's
    states: tuple[np.ndarray, np.ndarray, np.ndarray]

    @cached_property
    def compiled(self):
        return compile(Model(self.robot))

    def evaluate(self, function):
        """Values (N, …) of function(robot, motion, link parameters), over all states."""
        q, dq, ddq = (ca.SX.sym(name, self.robot.n) for name in ("q", "dq", "ddq"))
        parameters = ca.SX(ca.DM(self.robot.link_parameters))
        result = function(self.robot, Motion.of(q, dq, ddq), parameters)
        evaluated = ca.Function("function", [q, dq, ddq], [ca.densify(result)])
        return np.array([evaluated(*state).full() for state in self.moments])

    @property
    def moments(self):
        """The states one by one: (q, dq, ddq), each (n,)."""
        return list(zip(*self.states, strict=True))


def of_screws(robot, seed=0):
    model = to_pinocchio(robot)
    states = random_states(np.random.default_rng(seed), robot, 10)
    return Arm(robot, model, model.getFrameId("tool"), shift_to_axes(robot), states)


def of_urdf(path, tip, lock=()):
    """Pinocchio reads the file itself and reduces its own model."""
    robot = Robot.load(path, tip=tip, lock=lock)
    model = pin.buildModelFromUrdf(str(path))
    model = pin.buildReducedModel(model, [model.getJointId(j) for j in lock], np.zeros(model.nq))
    assert [j.name for j in robot.joints] == list(model.names)[1:]
    states = random_states(np.random.default_rng(0), robot, 10)
    return Arm(robot, model, model.getFrameId(tip), np.eye(10 * robot.n), states)


BUNDLED = ("panda", "panda_luo2024", "two_link")
REAL = {
    "ur10e": (UR10E / "ur10e.urdf", "tool0"),
    "tx40": (TX40 / "tx40.urdf", "tool0"),
    "panda_urdf": (PANDA / "panda.urdf", "panda_hand_tcp", FINGERS),
}
RANDOM = {f"random_{seed}_of_{2 + seed % 8}": seed for seed in range(20)}
ARMS = [
    *(pytest.param(name, id=name) for name in BUNDLED),
    *(
        pytest.param(name, id=name, marks=[pytest.mark.real, needs(path)])
        for name, (path, *_) in REAL.items()
    ),
    *(
        pytest.param(name, id=name, marks=[pytest.mark.slow] if seed >= 4 else [])
        for name, seed in RANDOM.items()
    ),
]


@pytest.fixture(scope="session", params=ARMS)
def arm(request):
    name = request.param
    if name in BUNDLED:
        return of_screws(Robot.load(name))
    if name in REAL:
        return of_urdf(*REAL[name])
    seed = RANDOM[name]
    return of_screws(random_arm(np.random.default_rng(seed), 2 + seed % 8), seed)
