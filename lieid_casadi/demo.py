"""The whole loop on a simulated arm: measure, identify, compare, add what is missing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from lieid_casadi.comparison import Comparison, compare
from lieid_casadi.identification import Fit, identify
from lieid_casadi.model import Model
from lieid_casadi.plant import FourierTrajectory, demo_arm, demo_sensors, simulate
from lieid_casadi.recording import Recording

if TYPE_CHECKING:
    from lieid_casadi.robot import Robot

Progress = Callable[[str, float], None]

HIDDEN, HIDDEN_JOINT = "load_friction", 1  # what the plant has and the first model lacks
DURATION = 20.0  # s of each run


@dataclass(frozen=True, eq=False)
class Demo:
    """What the demo measured and found.

    Attributes
    ----------
    train, test : Recording
        Two runs of the plant along different trajectories.
    fit, comparison
        Of the model without the hidden effect, on ``test``.
    better, better_comparison
        With the effect added.
    """

    train: Recording
    test: Recording
    fit: Fit
    comparison: Comparison
    better: Fit
    better_comparison: Comparison


def run_demo(robot: Robot, *, seed: int = 0, progress: Progress | None = None) -> Demo:
    """Measure a simulated arm twice, fit on one run, compare on the other.

    The plant's inertias differ from the nominal ones by up to 20 %; its friction and the hidden
    effect are written out in the plant.
    """
    report = progress or (lambda stage, fraction: None)
    arm = demo_arm(robot, seed=seed, hidden=HIDDEN, joint=HIDDEN_JOINT)
    runs = []
    for k, name in enumerate(("train", "test")):
        trajectory = FourierTrajectory(
            robot, base_frequency=1.0 / DURATION, seed=seed + 1000 * (k + 1)
        )
        runs.append(
            simulate(
                arm,
                trajectory,
                sensors=demo_sensors(robot),
                seed=seed + k,
                name=name,
                progress=lambda done, k=k, name=name: report(  # type: ignore[misc]
                    f"measure {name}", 0.4 * (k + done)
                ),
            )
        )
    train, test = runs
    report("identify", 0.8)
    fit = identify(Model(robot, "coulomb,viscous,offset"), train)
    comparison = compare(fit, test)
    report("add the missing effect", 0.9)
    better = identify(fit.model.with_effect(HIDDEN, joints=[HIDDEN_JOINT]), train)
    result = Demo(train, test, fit, comparison, better, compare(better, test))
    report("done", 1.0)
    return result
