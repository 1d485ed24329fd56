"""Facts about what was opened, for the page."""

from __future__ import annotations

from collections.abc import Sequence

from lieid_casadi.identification import Fit
from lieid_casadi.json_numbers import numbers_or_none
from lieid_casadi.model import Model
from lieid_casadi.recording import Recording, check
from lieid_casadi.workbench.computing.arm_meshes import arm_meshes
from lieid_casadi.workbench.computing.arm_motion import arm_solids
from lieid_casadi.workbench.computing.results import OpenedInputs, OpenedRecording


def opened_inputs(
    model: Model, recordings: Sequence[Recording], kept: Fit | None, *, file: str
) -> OpenedInputs:
    """Return facts about the first model and the recordings, which are checked.

    Parameters
    ----------
    model : Model
    recordings : sequence of Recording
    kept : Fit or None
        The fit that is kept, if it is not fitted again.
    file : str
        Of the robot or fit, near which its meshes are looked for.
    """
    robot = model.robot
    return OpenedInputs(
        robot=robot.name,
        joint_names=tuple(joint.name for joint in robot.joints),
        units=tuple("N·m" if joint.revolute else "N" for joint in robot.joints),
        revolute=tuple(joint.revolute for joint in robot.joints),
        effects=tuple(p.label for p in model.placements),
        expected=(None,) * robot.n if kept is None else tuple(numbers_or_none(kept.rms_cv)),
        recordings=tuple(
            OpenedRecording(
                name=r.name,
                rows=len(r),
                start=float(r.t[0]),
                end=float(r.t[-1]),
                rate=float(r.rate),
                warnings=tuple(str(w) for w in check(r, robot)),
            )
            for r in recordings
        ),
        solids=arm_solids(robot),
        meshes=arm_meshes(robot, file),
    )
