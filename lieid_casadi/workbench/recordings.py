"""Recordings of a page: without what is excluded, evenly thinned, and processed once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import PurePath
from typing import Protocol

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.comparison import Comparison
from lieid_casadi.comparison.compare import compare_segments, compared_segments
from lieid_casadi.compiled import compile
from lieid_casadi.diagnosis import change_torque
from lieid_casadi.errors import LieidWarning, RecordingError
from lieid_casadi.identification import Fit
from lieid_casadi.identification.identify import identify_segments
from lieid_casadi.identification.prediction import center_temperature
from lieid_casadi.identification.recording_checks import check_recordings, check_with_model
from lieid_casadi.identification.regression.design_matrix import FilteredColumns
from lieid_casadi.identification.regression.fixed_point import Progress, ShapeStart
from lieid_casadi.model import Model
from lieid_casadi.recording import Processed, Recording, process
from lieid_casadi.robot import Robot
from lieid_casadi.workbench.session import (
    ExcludedRange,
    ProposedEffect,
    WorkbenchInputs,
    kept_parts,
)

MOST_STRETCHES = 8  # of each recording in a quick fit
LEAST_DURATION = 5.0  # s, of a stretch; the filter needs a second at each of its ends


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

    ``prepare`` is called once, before anything is opened: it loads the user's file of effects.
    """

    prepare: Callable[[], None]
    robot: LoadRobot
    read: ReadRecordings


def recording_titles(inputs: WorkbenchInputs) -> list[str]:
    """Return a short, unique title of each recording: its file name, its path if two are equal."""
    names = [PurePath(r.path).name for r in inputs.recordings]
    count = Counter(names)
    paths = Counter(r.path for r in inputs.recordings)
    titles = []
    for k, (name, each) in enumerate(zip(names, inputs.recordings, strict=True)):
        if count[name] > 1:
            name = each.path if paths[each.path] == 1 else f"{each.path} ({k + 1})"
        titles.append(name)
    return titles


def used_parts(
    recording: Recording, number: int, excluded: Sequence[ExcludedRange], *, share: float = 1.0
) -> list[Recording]:
    """Return the parts of recording ``number`` that are not excluded; of each, a share below 1.

    A share is made of stretches that are evenly spread.
    """
    parts = []
    for start, end in kept_parts(excluded, number):
        if start is None and end is None:
            parts.append(recording)
            continue
        try:
            parts.append(recording.cut(start, end))
        except RecordingError:  # no rows between two excluded stretches
            continue
    return parts if share >= 1.0 else [s for part in parts for s in _evenly_spread(part, share)]


def _evenly_spread(recording: Recording, share: float) -> list[Recording]:
    count = int(np.clip(share * recording.duration / LEAST_DURATION, 1, MOST_STRETCHES))
    edges = np.linspace(0, len(recording), count + 1)
    length = share * len(recording) / count
    return [recording.rows(int(first), int(first + length)) for first in edges[:-1]]


@dataclass(frozen=True, eq=False)
class NoiseFloor:
    """Noise floor of each joint (n,), N·m, and its source, as in a `Comparison`."""

    floor: Array
    source: str


@dataclass(frozen=True, eq=False)
class PreparedRecordings:
    """Recordings with their segments through the filter of a fit, and warnings of the checks.

    Temperatures of the segments are relative to the fit's mean.
    """

    recordings: tuple[Recording, ...]
    segments: tuple[Processed, ...]
    warnings: tuple[LieidWarning, ...]

    @classmethod
    def of(cls, fit: Fit, recordings: Sequence[Recording], *, average: bool) -> PreparedRecordings:
        """Check and process recordings as a fit does (``average`` periods) or a comparison."""
        check_recordings(fit.model, recordings)
        if average:
            averaged = process(recordings, fit.processing)
            segments, _ = center_temperature(averaged, fit.temperature_mean)
        else:
            segments = compared_segments(fit, recordings)
        found = [w for r in recordings for w in check_with_model(fit.compiled, r)]
        found += [w for segment in segments for w in segment.warnings]
        return cls(tuple(recordings), segments, tuple(found))

    @cached_property
    def _known(self) -> tuple[FilteredColumns, ...]:
        """Filtered columns of each segment, which all fitted models share."""
        return tuple(FilteredColumns() for _ in self.segments)

    def fitted(
        self,
        model: Model,
        first: Fit,
        *,
        start: ShapeStart | None,
        uncertainty: bool,
        report: Progress,
    ) -> Fit:
        """Return the fit of another model with the method and filter of the first one.

        Without ``uncertainty``, standard deviations are left out; they take longer than the fit.
        """
        check_recordings(model, self.recordings)
        return identify_segments(
            compile(model),
            self.segments,
            method="wls",
            start=start,
            uncertainty=uncertainty,
            temperature_mean=first.temperature_mean,
            provenance=first.provenance,
            known=self._known,
            warnings=self.warnings,
            report=report,
        )

    def compared(
        self,
        fit: Fit,
        changes: Sequence[ProposedEffect],
        *,
        noise: NoiseFloor | None,
        with_noise: bool = True,
    ) -> Comparison:
        """Return the comparison of a fit, with changes since it, with these recordings.

        ``noise`` is that of another model of these recordings, in place of an estimate; without
        ``with_noise``, the result has none.
        """
        check_recordings(fit.model, self.recordings)
        made = compare_segments(
            fit,
            self.recordings,
            self.segments,
            added=[_torque_of(changes, fit, segment) for segment in self.segments],
            warnings=self.warnings,
            with_noise=with_noise and noise is None,
        )
        if noise is None or not with_noise:
            return made
        # A noise floor never exceeds the error; np.minimum keeps NaN of joints that do not move.
        floor = np.minimum(noise.floor, made.rms_moving)
        return replace(made, noise_floor=floor, noise_source=noise.source)


def _torque_of(changes: Sequence[ProposedEffect], fit: Fit, segment: Processed) -> Array:
    """Return the torque (K, n) of changes since a fit on a segment's grid, N·m."""
    torque = np.zeros_like(segment.q)
    for change in changes:
        torque += change_torque(fit, segment, change.label, dict(change.parameters))
    return torque
