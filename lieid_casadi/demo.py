"""The whole workflow on a simulated arm: excite, measure, identify, diagnose, add, export."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from lieid_casadi.arrays import Array
from lieid_casadi.comparison import Comparison, compare
from lieid_casadi.compiled.cache import cache_folder
from lieid_casadi.diagnosis import Diagnosis, diagnose
from lieid_casadi.errors import RecordingError
from lieid_casadi.excitation import Excitation, Torque, excite
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
from lieid_casadi.robot import Robot

Progress = Callable[[str, float], None]

HIDDEN, HIDDEN_JOINT = "load_friction", 1  # in the plant, missing in the first model
EFFECTS = "coulomb,viscous,offset"
DURATION = 20.0  # s of each run
STARTS = 2  # of the search for the excitation


@dataclass(frozen=True, eq=False)
class Demo:
    """Results of the demo."""

    excitation: Excitation  # executed by the plant for ``train``; ``test`` is another motion
    train: Recording
    test: Recording
    fit: Fit  # of the model without the hidden effect
    comparison: Comparison
    diagnosis: Diagnosis
    better: Fit  # of the model with the effects that the diagnosis found
    better_comparison: Comparison


def run_demo(robot: Robot, *, seed: int = 0, progress: Progress | None = None) -> Demo:
    """Design a motion, record a simulated arm along it, and diagnose the model."""
    report = progress or (lambda stage, fraction: None)
    model = Model(robot, EFFECTS)
    report("design the excitation", 0.0)
    excitation = excite(
        model,
        duration=DURATION,
        starts=STARTS,
        seed=seed,
        margin=1.0,
        limits=(Torque(dry=0.0, viscous=0.0),),
    )  # the simulated arm has no floor, and torque to spare for friction
    if excitation.interrupted:
        raise KeyboardInterrupt  # `excite` returns its best motion; the steps after it need time
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
        motion = self.excitation.trajectory.at(t)
        return motion.q, motion.dq, motion.ddq


def _measured(
    robot: Robot,
    trajectory: ReferenceTrajectory,
    name: str,
    seed: int,
    report: Progress,
    begun: float,
    *,
    part: float = 0.2,
    rate: float = 1000.0,
) -> Recording:
    """Measure the demo's arm, which is a ``part`` of all that is done."""
    arm = demo_arm(robot, seed=0, hidden=HIDDEN, joint=HIDDEN_JOINT)
    return simulate(
        arm,
        trajectory,
        rate=rate,
        sensors=demo_sensors(robot),
        seed=seed,
        name=name,
        progress=lambda done: report(f"measure {name}", begun + part * done),
    )


DEMO_ROBOT = "panda"
VERSION = 1  # of the recordings below; a new one when arm, sensors or motion change
CONTROL_RATE = 500.0  # Hz
RUNS = {"train": 0, "test": 1000}  # seeds of the motions


def demo_recordings(progress: Progress | None = None) -> tuple[Path, Path]:
    """Return files with recordings of the demo's arm, simulated on the first call and cached."""
    report = progress or (lambda stage, fraction: None)
    folder = cache_folder()
    files = {name: folder / f"demo-{VERSION}" / f"demo_{name}.npz" for name in RUNS}
    robot = Robot.load(DEMO_ROBOT)
    for k, (name, file) in enumerate(files.items()):
        if not _is_recording(file):
            motion = FourierTrajectory(robot, base_frequency=1.0 / DURATION, seed=RUNS[name])
            part = 1.0 / len(RUNS)
            recording = _measured(
                robot, motion, name, k, report, k * part, part=part, rate=CONTROL_RATE
            )
            recording.save(file)
    return files["train"], files["test"]


def _is_recording(file: Path) -> bool:
    """Whether a file has a recording; one that was cut short has none."""
    try:
        Recording.load(file)
    except RecordingError:
        return False
    return True
