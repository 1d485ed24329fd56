"""Errors and warnings: one named class per cause.

Errors stop the work (bad input, no solution). Warnings do not: they are in the ``warnings``
field of every result, so that a suspicious recording is reported beside its numbers.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager


class LieidError(ValueError):
    """Base of every error that the package raises on purpose."""


class RobotError(LieidError):
    """A robot description that cannot be used."""


class RecordingError(LieidError):
    """A recording that is certainly wrong or cannot be read."""


class EffectError(LieidError):
    """An unknown effect, or an effect that does not fit the robot or the recording."""


class ModelError(LieidError):
    """Arguments that do not fit the model: wrong shape, missing signal."""


class IdentificationError(LieidError):
    """A request that identification cannot meet: no recordings, an unknown method."""


class ExcitationError(LieidError):
    """A request that no excitation can meet: limits are missing or contradictory."""


class CompilerError(LieidError):
    """No C compiler that works, or a processor that cannot run the requested code."""


class FitFileError(LieidError):
    """A fit file that is truncated, of a newer schema, or not a fit."""


class ExportError(LieidError):
    """A fit that cannot be exported to this format."""


class OutputError(LieidError):
    """A file or folder that cannot be written, or may not be replaced."""


class RecordError(LieidError):
    """A command or function of an experiment that did not record the motion."""


class FleetError(LieidError):
    """A fleet file, a history or a cluster that cannot be used."""


class UsageError(LieidError):
    """A command line that asks for something impossible."""


class MissingDependency(LieidError):
    """An optional package is needed; the message names the extra to install."""


class PremiseError(LieidError):
    """Robot and recording do not belong together (exit status 4)."""


class NoSolution(LieidError):
    """The problem was well posed but no solution was found (exit status 3)."""


class ClusterLost(NoSolution):
    """The connection to a cluster was lost; what was finished is recorded."""


class LieidWarning(UserWarning):
    """Base of every warning; results carry them in ``warnings``."""


class UnidentifiableWarning(LieidWarning):
    """A direction of the parameters that this data does not excite."""


class UnusableEffectWarning(LieidWarning):
    """A user's effect whose code raises; a search leaves it out."""


class AliasWarning(LieidWarning):
    """An effect that the other columns absorb completely or almost."""


class BoundWarning(LieidWarning):
    """A coefficient or shape parameter at its bound."""


class RoughFitWarning(LieidWarning):
    """Held-out data are predicted much worse than the data of the fit: these are too few."""


class FrictionAtRestWarning(LieidWarning):
    """Friction is undetermined at rest: samples were excluded, or increase a test's error."""


class LateFrictionWarning(LieidWarning):
    """Dry friction that reverses later than the velocity, by stiction or a delayed signal."""


class NominalInertiaWarning(LieidWarning):
    """A stated inertia that is physically impossible."""


class StatedMassWarning(LieidWarning):
    """Masses of a physically consistent fit that are far from those that the robot states."""


class NotReadWarning(LieidWarning):
    """Statements of a robot's description that change its dynamics and were not read."""


class LockedBranchWarning(LieidWarning):
    """Joints off the chain were locked, and their bodies added to a link."""


class MissingMeshWarning(LieidWarning):
    """Files of shapes that do not exist; the robot was read without them."""


class MimicJointWarning(LieidWarning):
    """A joint that follows another in the robot's description, and is kept at zero here."""


class ConvergenceWarning(LieidWarning):
    """An iteration stopped before it had converged."""


class UnknownColumnWarning(LieidWarning):
    """Columns of a recording that were ignored because their names are unknown."""


class LargeFileWarning(LieidWarning):
    """A file that is larger than the memory: its rate was lowered while it was read."""


class RepairWarning(LieidWarning):
    """Damage of a recording that was repaired on reading."""

    def __init__(self, message: str, *, samples: int = 0, joints: Sequence[int] = ()) -> None:
        super().__init__(message)
        self.samples, self.joints = samples, tuple(joints)


class DamagedRowsWarning(RepairWarning):
    """Rows with missing or not finite values were left out."""


class DuplicateRowsWarning(RepairWarning):
    """Rows that repeat the previous one exactly, time included, were left out."""


class WrappedAngleWarning(RepairWarning):
    """Angles that jump by a whole turn were made continuous."""


class OutlierWarning(RepairWarning):
    """Rows with an outlier of a single sample were left out."""


class ColumnNamesWarning(LieidWarning):
    """Columns were assigned to signals by other names than those of the file format."""


class DropoutWarning(LieidWarning):
    """Samples are missing; segments are not joined across gaps."""


class IrregularTimeWarning(LieidWarning):
    """Time stamps come in clusters: they are not the instants of the measurements."""


class ConstantTorqueWarning(LieidWarning):
    """A joint's torque has the same value in every row: it was probably not recorded."""


class JointStillWarning(LieidWarning):
    """A joint that never moves: its friction and most of its inertia are not identifiable."""


class TorqueClippedWarning(LieidWarning):
    """Torque that stays at its largest value or reaches the robot's limit."""


class LowRateWarning(LieidWarning):
    """The rate is too low for the motion."""


class NotDissipativeWarning(LieidWarning):
    """Fitted friction that would drive the joint instead of braking it."""


class JointLimitWarning(LieidWarning):
    """Positions or velocities beyond the robot's own limits."""


class RepeatedRowsWarning(LieidWarning):
    """Rows that repeat the previous one while the arm moves: the source is slower."""


class LateVelocityWarning(LieidWarning):
    """Recorded velocities that are later than the positions, and were derived from these."""


class AssumedCalibrationWarning(LieidWarning):
    """Units or zero positions of a recording that were assumed, because it does not state them."""


class RelativeTorqueWarning(LieidWarning):
    """Torques and parameters in units of a drive stiffness that is not known."""


class ShortSegmentWarning(LieidWarning):
    """A segment that is too short to be filtered was left out."""


class SameRecordingWarning(LieidWarning):
    """A test on a recording that the fit was made from."""


class BeyondTrainingWarning(LieidWarning):
    """Motion outside the range of the training data of a smooth function, which is zero there."""


class TorqueConstantsWarning(LieidWarning):
    """Currents were converted by other torque constants than those of the fit."""


class NegativeMassWarning(LieidWarning):
    """A payload whose mass came out negative."""


class PayloadMisfitWarning(LieidWarning):
    """A run whose error a payload does not explain."""


class HeldJointWarning(LieidWarning):
    """A joint under position control that rests against more torque than its friction holds."""


class DriveLimitWarning(LieidWarning):
    """Drives seem to deliver less torque than their control laws state at large errors."""


class DriveProtectionWarning(LieidWarning):
    """Stretches in which a servo's overload protection lowers its torque below that of its law."""


class NotSimulatedWarning(LieidWarning):
    """An effect of a fit changes the motion of its links, and a simulation leaves it out."""


class NotCountedWarning(LieidWarning):
    """An effect that an excitation's regressor leaves out, or counts as another."""


class FrictionChangedWarning(LieidWarning):
    """Friction that differs from that of the fit."""


@contextmanager
def of_extra(extra: str, need: str) -> Iterator[None]:
    """Raise `MissingDependency` if a package that an extra installs cannot be imported."""
    try:
        yield
    except ImportError as error:
        raise MissingDependency(f"{need}: pip install 'lieid-casadi[{extra}]'") from error


def warning_list(warnings: Sequence[LieidWarning]) -> list[dict[str, str]]:
    """Return warnings as JSON holds them: ``[{name, message}]``."""
    return [{"name": type(w).__name__, "message": str(w)} for w in warnings]


def unique_warnings(warnings: Sequence[LieidWarning]) -> tuple[LieidWarning, ...]:
    """Return warnings in their order, without repetitions of class and message."""
    kept: dict[tuple[type, str], LieidWarning] = {}
    for warning in warnings:
        kept.setdefault((type(warning), str(warning)), warning)
    return tuple(kept.values())
