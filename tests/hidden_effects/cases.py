"""Recordings with hidden effects: written by the plant, which shares nothing with the effects.

A case is sized by what it leaves unexplained: the RMS that the plain model cannot explain of a
noise-free measurement, over the RMS of the noise, both through the same filter.
"""

from dataclasses import asdict, dataclass, replace

import numpy as np

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.errors import LieidError
from lieid_casadi.recording import Processing, process

EFFECTS = "coulomb,viscous,offset"
DURATION, INNER_RATE = 15.0, 1000.0
WHOLE_ARM = ("base_tilt", "payload", "external_wrench")
ABSORBED = ("payload",)  # in a fit of the last link; seen where the model is kept
MOST_STRENGTH = 60.0


@dataclass(frozen=True)
class Case:
    """What is hidden where, and how large beside the noise."""

    kind: str  # single, pair, triple, none, foreign, changed
    arm: str
    names: tuple[str, ...]
    joints: tuple[int, ...]
    size: float
    seed: int
    temperature: bool = False

    def to_dict(self):
        return asdict(self)


@dataclass(frozen=True, eq=False)
class Recorded:
    """What the tool gets to see, and what only the scorer does."""

    robot: lieid.Robot
    train: lieid.Recording
    test: lieid.Recording
    truth: tuple[tuple[str, tuple[int, ...]], ...]
    size: float


def robot_named(name):
    if name == "six_axes":
        from six_axes import six_axes

        return six_axes()
    return getattr(lieid.robots, name)()


def foreign(arm, joint, strength, seed):
    """An effect of no library: torque that follows angle and velocity in an odd way."""
    random = np.random.default_rng([seed, 77])
    other = int(random.choice([j for j in range(arm.n) if j != joint]))
    scale = 0.05 * strength * float(plant.torque_scale(arm.robot)[joint])
    functions = [
        lambda s: scale * np.tanh(3.0 * s.q[..., joint] * s.dq[..., joint]),
        lambda s: scale * np.sin(2.0 * s.q[..., joint]) * np.sin(2.0 * s.q[..., other]),
        lambda s: scale * np.maximum(s.q[..., joint] - 0.2, 0.0) ** 2 * np.cos(s.dq[..., joint]),
        lambda s: scale * np.sin(1.5 * s.q[..., other]) * np.tanh(4.0 * s.dq[..., joint]),
    ]
    return plant.ForeignTorque(joint, functions[int(random.integers(len(functions)))])


def _arm(case, strengths):
    robot = robot_named(case.arm)
    bare = plant.demo_arm(robot, seed=case.seed, hidden=None)
    if case.temperature or "temperature_friction" in case.names:
        warm = plant.Thermal(rise=12.0, time_constant=20.0)
        bare = plant.Arm(robot, bare.parameters, bare.friction, (), warm)
    hidden = []
    for k, (name, joint) in enumerate(zip(case.names, case.joints, strict=True)):
        if strengths[k] == 0.0:
            continue
        seed = case.seed + 31 * k
        if name == "foreign":
            hidden.append(foreign(bare, joint, strengths[k], seed))
        else:
            hidden.append(plant.hidden_effect(bare, name, joint, strength=strengths[k], seed=seed))
    return bare, bare.with_effects(*hidden), hidden


def _measured(case, arm, run, *, noise=True):
    robot = arm.robot
    trajectory = plant.FourierTrajectory(
        robot, base_frequency=1.0 / DURATION, seed=case.seed + 1000 * (run + 1)
    )
    t = np.arange(0.0, DURATION, 1.0 / INNER_RATE)
    sensors = plant.demo_sensors(robot)
    warm = case.temperature or "temperature_friction" in case.names
    sensors = replace(sensors, temperature=warm)
    if not noise:
        sensors = replace(sensors, torque_noise=0.0, coloured_noise=0.0, torque_step=0.0)
    return plant.measure_along(
        arm, t, *trajectory.at(t), sensors=sensors, seed=case.seed + run, name=f"run{run}"
    )


def size_of(case, arm):
    """Return what the plain model leaves of this arm's torque over the noise (n,)."""
    model = lieid.Model(arm.robot, EFFECTS)
    clean, noisy = (_measured(case, arm, 0, noise=flag) for flag in (False, True))
    options = Processing(cutoff=lieid.identify(model, noisy).processing.cutoff)
    left = lieid.identify(model, clean, method="ols", processing=options).rms_train
    (a,), (b,) = process(clean, options), process(noisy, options)
    return left / np.std(a.filter(a.tau) - b.filter(b.tau), axis=0)


def record(case):
    """Return the recordings of a case; None where no effect of that size can be had."""
    strengths = [1.0] * len(case.names)
    sizes = [case.size] * len(case.names)
    if case.kind != "changed":
        for k in range(len(case.names)):
            sized = _sized(case, k)
            if sized is None:
                return None
            strengths[k], sizes[k] = sized
    bare, arm, hidden = _arm(case, strengths)
    truth = tuple((e.name, () if e.name in WHOLE_ARM else _joints(e)) for e in hidden)
    found = min(sizes, default=0.0)
    if case.kind == "changed":
        runs = [_measured(case, a, k) for k, a in enumerate((bare, bare, arm))]
        joined = lieid.Recording.join(runs[:2])
        return Recorded(arm.robot, joined, runs[2], truth, found)
    train, test = (_measured(case, arm, k) for k in range(2))
    return Recorded(arm.robot, train, test, truth, found)


def _sized(case, k):
    """Return the strength at which effect k alone has the wanted size, and the size reached."""
    alone = [0.0] * len(case.names)
    bare, _, _ = _arm(case, alone)
    null, strength = size_of(case, bare), 1.0
    for attempt in range(4):
        alone[k] = strength
        try:
            _, arm, _ = _arm(case, alone)
        except LieidError:
            return None
        size = float(np.sqrt(np.maximum(size_of(case, arm) ** 2 - null**2, 0.0)).max())
        if size < 1e-3:
            return None
        if abs(np.log(size / case.size)) < 0.1 or attempt == 3:
            break
        strength *= case.size / size
        if not 1e-3 < strength < MOST_STRENGTH:
            return None
    return (strength, size) if 0.7 < size / case.size < 1.4 else None


def _joints(effect):
    source = getattr(effect, "source", None)
    return (effect.joint,) if source is None else (effect.joint, source)
