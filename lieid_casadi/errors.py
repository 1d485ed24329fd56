"""Errors and warnings: one named class per cause.

Errors stop the work (bad input, no solution). Warnings never do: they travel in the
``warnings`` field of every result, so that a suspicious recording is seen beside the
numbers it produced.
"""

from __future__ import annotations


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


class FitFileError(LieidError):
    """A fit file that is truncated, of a newer schema, or not a fit."""


class UsageError(LieidError):
    """A command line that asks for something impossible."""


class MissingDependency(LieidError):
    """An optional package is needed; the message names the extra to install."""


class NoSolution(LieidError):
    """The problem was well posed but no solution was found (exit status 3)."""


class LieidWarning(UserWarning):
    """Base of every warning; results carry them in ``warnings``."""


class UnidentifiableWarning(LieidWarning):
    """A direction of the parameters that this data does not excite."""


class AliasWarning(LieidWarning):
    """An effect that the other columns absorb, wholly or almost."""


class BoundWarning(LieidWarning):
    """A coefficient or shape parameter that ran to its bound."""


class FrictionAtRestWarning(LieidWarning):
    """Samples at rest left the fit: friction is undetermined there."""


class ConvergenceWarning(LieidWarning):
    """An iteration stopped before it had converged."""
