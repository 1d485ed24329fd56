"""What the worker process returns: plain data, so that it can be sent between processes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.comparison import Comparison
from lieid_casadi.identification import Fit
from lieid_casadi.recording import Recording
from lieid_casadi.robot import Robot
from lieid_casadi.workbench.state.inputs import WorkbenchInputs
from lieid_casadi.workbench.state.session import StepErrors

Array = NDArray[np.float64]


class LoadRobot(Protocol):
    """Loads the robot of inputs with the options of the command line."""

    def __call__(self, inputs: WorkbenchInputs) -> Robot:
        """Return the robot, with the drive laws that are stated."""


class ReadRecordings(Protocol):
    """Reads the recordings of inputs with the limits and options of the command line."""

    def __call__(self, inputs: WorkbenchInputs, source: Robot | Fit) -> list[Recording]:
        """Return the recordings."""


@dataclass(frozen=True)
class WorkerSetup:
    """What a worker process runs with: picklable functions of the command line.

    Attributes
    ----------
    prepare : callable
        Called once, before anything is opened: loads the user's file of effects.
    robot : callable
        Loads the robot.
    read : callable
        Reads recordings.
    """

    prepare: Callable[[], None]
    robot: LoadRobot
    read: ReadRecordings


@dataclass(frozen=True)
class OpenedRecording:
    """Facts about one recording, for the list of what is open."""

    name: str
    rows: int
    start: float
    end: float
    rate: float
    warnings: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class ArmSolid:
    """A capsule, or the drum that marks a joint, in the frame of a link (0: base).

    Attributes
    ----------
    link : int
        0 for the base, i for the link that joint i (from 1) moves.
    drum : bool
        Whether it marks joint ``link``.
    middle : (3,)
        m.
    rotation : (3, 3)
        Turns the y axis to the axis of the solid.
    length, radius : float
        Without the caps of a capsule, m.
    """

    link: int
    drum: bool
    middle: Array
    rotation: Array
    length: float
    radius: float


@dataclass(frozen=True, eq=False)
class ArmMesh:
    """The mesh of a link in its frame: a binary STL file, m."""

    link: int
    stl: bytes


@dataclass(frozen=True, eq=False)
class ArmMotion:
    """Poses of an arm along a recording.

    Attributes
    ----------
    times : (F,)
        s, on the recording's own clock.
    poses : (F, n + 1, 4, 4)
        Of the base and the links, in the base frame.
    centre : (3,)
        Of the box around all positions, m.
    radius : float
        Half the diagonal of this box, m.
    """

    times: Array
    poses: Array
    centre: Array
    radius: float


@dataclass(frozen=True, eq=False)
class OpenedInputs:
    """What was opened.

    Attributes
    ----------
    robot : str
        Name of the robot.
    joint_names, units : tuple of str
        Of each joint: its name, and N·m or N.
    revolute : tuple of bool
    effects : tuple of str
        Labels of the placements of the first model.
    expected : tuple of float or None
        Held-out error of an opened fit, N·m.
    recordings : tuple of OpenedRecording
    solids : tuple of ArmSolid
    meshes : tuple of ArmMesh
        Of a URDF whose files are found; they replace the capsules.
    """

    robot: str
    joint_names: tuple[str, ...]
    units: tuple[str, ...]
    revolute: tuple[bool, ...]
    effects: tuple[str, ...]
    expected: tuple[float | None, ...]
    recordings: tuple[OpenedRecording, ...]
    solids: tuple[ArmSolid, ...]
    meshes: tuple[ArmMesh, ...]


@dataclass(frozen=True)
class EffectCurve:
    """Fitted torque of an effect, N·m or N, at values of the signal ``name``."""

    name: str
    unit: str
    signal: tuple[float, ...]
    torque: tuple[float, ...]


@dataclass(frozen=True)
class SimulationError:
    """How far a simulation leaves the measured motion within short windows.

    Attributes
    ----------
    window : float
        s.
    rms : tuple of float or None
        At the ends of the windows, per joint, rad or m.
    reason : str
        Why there is no simulation; empty if there is one.
    """

    window: float
    rms: tuple[float | None, ...]
    reason: str


@dataclass(frozen=True, eq=False)
class EffectRow:
    """One effect of the model on one joint.

    ``values`` are its parameters as text, ``name = value ± std unit``.
    """

    label: str
    effect: str
    joint: int | None
    formula: str
    values: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A fitted model compared with all recordings.

    Attributes
    ----------
    exact : bool
        False if shape parameters were held or only parts of the recordings were used.
    complete : bool
        Whether it is exact, with the standard deviations and the noise floor of this model.
    errors : StepErrors
    train, test : Comparison or None
        With the recordings that were fitted, and with the others; ``test`` holds all recordings
        if the fit is kept. The series of a recording are named after it, see `recording_title`.
    sentence : str
        How large the error is, compared with the noise.
    effects : tuple of EffectRow
    warnings : tuple of str
    shapes : dict
        Label of each shape parameter → its value, from which later fits start.
    cutoff : float
        Hz.
    seconds, cpu_seconds : float
        Time that the computation took, and that of the processor.
    """

    exact: bool
    complete: bool
    errors: StepErrors
    train: Comparison | None
    test: Comparison | None
    sentence: str
    effects: tuple[EffectRow, ...]
    warnings: tuple[str, ...]
    shapes: dict[str, float]
    cutoff: float
    seconds: float = 0.0
    cpu_seconds: float = 0.0
