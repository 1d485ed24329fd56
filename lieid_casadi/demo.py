"""The whole loop on a simulated arm: excite, measure, identify, diagnose, add, export."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.comparison import Comparison, compare
from lieid_casadi.diagnosis import Diagnosis, diagnose
from lieid_casadi.excitation import Excitation, excite
from lieid_casadi.identification import Fit, identify
from lieid_casadi.model import Model
from lieid_casadi.plant import (
    FourierTrajectory,
    ReferenceTrajectory,
    demo_arm,
    demo_sensors,
    simulate,
)
from lieid_casadi.recording import Recording

if TYPE_CHECKING:
    from lieid_casadi.robot import Robot

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

HIDDEN, HIDDEN_JOINT = "load_friction", 1  # what the plant has and the first model lacks
EFFECTS = "coulomb,viscous,offset"
DURATION = 20.0  # s of each run
STARTS = 2  # of the excitation's optimization


@dataclass(frozen=True, eq=False)
class Demo:
    """What the demo designed, measured and found.

    Attributes
    ----------
    excitation : Excitation
        Run on the plant for ``train``; ``test`` is another motion.
    fit, comparison
        Of the model without the hidden effect, on ``test``.
    diagnosis : Diagnosis
    better, better_comparison
        With the effects that the diagnosis found.
    """

    excitation: Excitation
    train: Recording
    test: Recording
    fit: Fit
    comparison: Comparison
    diagnosis: Diagnosis
    better: Fit
    better_comparison: Comparison


def run_demo(robot: Robot, *, seed: int = 0, progress: Progress | None = None) -> Demo:
    """Design a motion, measure a simulated arm along it, find what the model lacks.

    The plant's inertias differ from the nominal ones by up to 20 %; its friction and the hidden
    effect are written out in the plant, and nothing of them is passed on but the recordings.

    Parameters
    ----------
    robot : Robot
        With inertias and torque limits.
    seed : int
        Of the excitation, the test motion and the noise.
    progress : callable, optional
        Called with a stage's name and the fraction done.
    """
    report = progress or (lambda stage, fraction: None)
    model = Model(robot, EFFECTS)
    report("design the excitation", 0.0)
    excitation = excite(model, duration=DURATION, starts=STARTS, seed=seed)
    other = FourierTrajectory(robot, base_frequency=1.0 / DURATION, seed=seed + 1000)
    train = _measured(robot, _Commanded(excitation), "train", seed, report, 0.15)
    test = _measured(robot, other, "test", seed + 1, report, 0.35)
    report("identify", 0.55)
    fit = identify(model, train)
    comparison = compare(fit, test)
    diagnosis = diagnose(
        model,
        train,
        test,
        seed=seed,
        progress=lambda stage, done: report(f"diagnose: {stage}", 0.6 + 0.35 * done),
    )
    better = diagnosis.fit
    after = compare(better, test)
    report("done", 1.0)
    return Demo(excitation, train, test, fit, comparison, diagnosis, better, after)


@dataclass(frozen=True)
class _Commanded:
    """An excitation as the plant's controller tracks it."""

    excitation: Excitation

    @property
    def duration(self) -> float:
        return self.excitation.duration

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        motion = self.excitation.at(t)
        return motion.q, motion.dq, motion.ddq


def _measured(
    robot: Robot,
    trajectory: ReferenceTrajectory,
    name: str,
    seed: int,
    report: Progress,
    begun: float,
) -> Recording:
    arm = demo_arm(robot, seed=0, hidden=HIDDEN, joint=HIDDEN_JOINT)
    return simulate(
        arm,
        trajectory,
        sensors=demo_sensors(robot),
        seed=seed,
        name=name,
        progress=lambda done: report(f"measure {name}", begun + 0.2 * done),
    )
