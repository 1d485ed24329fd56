"""A fit along its recordings: weighted rows of model, residual and candidates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lieid_casadi.arrays import Array, Indices
from lieid_casadi.comparison.noise_floor import FASTEST, WAVES
from lieid_casadi.diagnosis.candidates import Candidate, Course, CourseKind, list_candidates
from lieid_casadi.diagnosis.columns import (
    Columns,
    ColumnStore,
    RowPart,
    SegmentSignals,
    evaluate,
    scan_peaks,
)
from lieid_casadi.diagnosis.path import Span
from lieid_casadi.effects import Effect
from lieid_casadi.identification import Fit
from lieid_casadi.identification.prediction import torque_along
from lieid_casadi.identification.regression.design_matrix import Design, FilteredColumns
from lieid_casadi.identification.regression.least_squares import Rows as DesignRows
from lieid_casadi.identification.regression.variable_projection import shape_columns
from lieid_casadi.identification.uncertainty.covariance import square_root
from lieid_casadi.identification.uncertainty.noise_model import (
    Runs,
    dry_level,
    expected_sign,
    friction_torque_std,
    runs_of,
    spread_of,
)
from lieid_casadi.recording import Processed

FEWEST = 5  # instants in a recording at which a change is tried


@dataclass(frozen=True, eq=False)
class Rows:
    """A fit, its decimated rows along recordings, and the columns of all candidates on them."""

    fit: Fit
    #: temperatures relative to the fit's mean
    segments: tuple[Processed, ...]
    #: instants of each joint that are used, at twice the cut-off, without rests
    runs: tuple[Runs, ...]
    #: (R_j, p) of each joint: the model's columns, the derivatives by its shape parameters, and
    #: columns set apart (`with_apart`)
    model: tuple[Array, ...]
    #: (R_j,) of each joint: measured torque, and its difference from the fit's prediction, N·m
    torque: tuple[Array, ...]
    residual: tuple[Array, ...]
    signals: tuple[SegmentSignals, ...]
    #: all that the library has, and the columns of those that were chosen, not weighted
    candidates: tuple[Candidate, ...]
    columns: Columns
    store: ColumnStore

    @classmethod
    def of(
        cls,
        fit: Fit,
        segments: Sequence[Processed],
        *,
        known: Sequence[FilteredColumns] | None = None,
        before: Rows | None = None,
        with_candidates: bool = True,
        model_fixed: bool = False,
    ) -> Rows:
        """Evaluate the columns of a fit's model and list the candidates.

        ``before`` are rows of another fit on the same segments: they are kept, and their columns
        where these do not depend on the fit. If the model is fixed, it is not fitted again, and
        candidates are changes of its effects, too.
        """
        design = Design(fit.compiled, segments, known=known)
        rows = design.linearized(fit.shapes, fit.parameters)
        runs = _runs(fit, rows, segments) if before is None else before.runs
        slopes = None
        if len(fit.shapes):
            slopes = shape_columns(design, fit.values, fit.shapes, fit.parameters)
        model = _on_runs(rows, runs, _dense(rows, slopes))
        torque = _on_runs(rows, runs, [design.torque(j) for j in range(fit.model.n)])
        residual = _on_runs(rows, runs, rows.residuals(fit.values))
        signals = tuple(SegmentSignals.of(fit, s) for s in segments)
        store = ColumnStore() if before is None else replace(before.store, of_fit={})

        def scan(effect: Effect, joint: int) -> tuple[Array, float]:
            key = effect.label, joint
            if key not in store.scans:
                store.scans[key] = scan_peaks(
                    effect, joint, signals, runs[joint], residual[joint], store
                )
            return store.scans[key]

        wanted: tuple[Candidate, ...] = ()
        if with_candidates:
            usable = np.array([run.count > 0 for run in runs])
            wanted = list_candidates(fit.model, segments, usable, scan, model_fixed=model_fixed)
        none, made = evaluate((), signals, runs, store), tuple(segments)
        return cls(fit, made, runs, model, torque, residual, signals, wanted, none, store)

    def with_candidates(self, candidates: Sequence[Candidate]) -> Rows:
        """Return the rows with other candidates, or other grids of the same ones."""
        columns = evaluate(candidates, self.signals, self.runs, self.store)
        return replace(self, columns=columns)

    def with_apart(self, columns: Sequence[Array]) -> Rows:
        """Return the rows with further columns (R_j, a) of each joint beside the model's."""
        beside = tuple(np.hstack(both) for both in zip(self.model, columns, strict=True))
        return replace(self, model=beside)

    def with_equal_weights(self) -> Rows:
        """Return the rows as if dry friction were certain at reversals, too."""
        runs = tuple(replace(run, friction_std=0.0 * run.friction_std) for run in self.runs)
        return replace(self, runs=runs)

    def spread(self, residual: Sequence[Array] | None = None) -> Array:
        """Return the standard deviation (n,) of residuals away from uncertain friction, N·m."""
        pairs = zip(self.residual if residual is None else residual, self.runs, strict=True)
        return np.array([spread_of(r, runs.friction_std) for r, runs in pairs])

    def weights(self, spread: Array) -> list[Array]:
        """Return the weight (R_j,) of each row that gives it unit variance, 1/(N·m)."""
        return [run.weights(float(s)) / float(s) for run, s in zip(self.runs, spread, strict=True)]

    def span(self, spread: Array, prior: Array | None = None) -> Span:
        """Return the span of the model's columns, weighted by `weights`; see `Span.of`."""
        weights = self.weights(spread)
        model = [m * w[:, None] for m, w in zip(self.model, weights, strict=True)]
        residual = [r * w for r, w in zip(self.residual, weights, strict=True)]
        return Span.of(model, residual, prior)

    def expected_error(self, spread: Array, covariance: Array) -> Array:
        """Return the RMS error (n,) of noise, dry friction at reversals and the parameters, N·m."""
        root, found = square_root(covariance), spread.copy()
        for j, (model, run) in enumerate(zip(self.model, self.runs, strict=True)):
            if run.count:
                parts = np.column_stack([model @ root, run.friction_std])
                found[j] = np.hypot(spread[j], np.sqrt(np.mean(np.sum(parts**2, axis=1))))
        return found

    @cached_property
    def times(self) -> Array:
        """Time of each instant of the common time line of all segments, s; gaps are kept apart."""
        parts, first = [], 0.0
        for segment in self.segments:
            own = segment.filtered_time
            parts.append(first + own - own[0])
            first = float(parts[-1][-1]) + 1e3
        return np.concatenate(parts)

    @cached_property
    def segment_of(self) -> Indices:
        """Segment of each instant of the common time line."""
        return np.repeat(
            np.arange(len(self.segments)), [len(s.filtered_time) for s in self.segments]
        )

    @cached_property
    def pieces(self) -> dict[int | None, list[int]]:
        """Segments of each recording, by its number, in their order."""
        found: dict[int | None, list[int]] = {}
        for k, s in enumerate(self.segments):
            found.setdefault(s.number, []).append(k)
        return found

    @cached_property
    def recording_names(self) -> tuple[str, ...]:
        """Names of the recordings, in their order."""
        names = (self.segments[own[0]].recording.name for own in self.pieces.values())
        return tuple(name or f"recording {k + 1}" for k, name in enumerate(names))

    @cached_property
    def starts(self) -> Array:
        """Time at which each recording begins, on its own clock, s."""
        return np.array([self.segments[own[0]].t[0] for own in self.pieces.values()])

    @cached_property
    def recordings(self) -> Indices:
        """Recording of each instant of the common time line."""
        of = {piece: k for k, own in enumerate(self.pieces.values()) for piece in own}
        return np.array([of[k] for k in range(len(of))], dtype=np.intp)[self.segment_of]

    @cached_property
    def clock(self) -> Array:
        """Time since its recording began of each instant of the common time line, s."""
        time = np.concatenate([s.filtered_time for s in self.segments])
        return time - self.starts[self.recordings]

    def part(self, recording: int | None, course: Course | None = None) -> RowPart:
        """Return one recording, or each of them (None), with a change in its course or whole."""
        whole = np.ones((len(self.clock), 1, 1))
        factors = whole if course is None else course.factors(self.clock)
        if recording is not None:
            factors = factors * (self.recordings == recording)[:, None, None]
        return RowPart(recording, course, [factors[run.all] for run in self.runs])

    def course_parts(self, kind: CourseKind, count: int) -> list[RowPart]:
        """Return changes in the course of one recording, and of each of several.

        ``count`` instants divide the time of one, or of all; of a wave they are periods.
        """
        whole = range(len(self.recording_names))
        found = []
        for k in [None, *whole] if len(whole) > 1 else whole:
            clock = self.clock if k is None else self.clock[self.recordings == k]
            length, number = float(np.ptp(clock)), max(count // len(whole), FEWEST)
            at = clock.min() + length * np.linspace(0.0, 1.0, number + 2)[1:-1]
            if kind == "wave":
                if length * FASTEST <= 1.0:  # less than a whole wave resembles a drift
                    continue
                own = [self.clock[self.recordings == r] for r in (whole if k is None else [k])]
                fastest = max(2.0 / WAVES * min(map(np.ptp, own)), 1.0 / FASTEST)
                at = 1.0 / np.linspace(1.0 / length, 1.0 / fastest, count)
            found.append(self.part(k, Course(kind, at)))
        return found

    @cached_property
    def friction_at_rest(self) -> tuple[Array, ...]:
        """What the residual at rest, where friction is undetermined, adds to rows beside it, N·m.

        These samples are not used, but the low-pass filter mixes them with their neighbours.
        """
        parts = []
        for s in self.segments:
            assert s.tau is not None  # of a recording that is fitted
            torque = torque_along(self.fit.compiled, s, self.fit.parameters, self.fit.shapes)
            parts.append(s.filter(np.where(s.moving, 0.0, s.tau - torque)))
        rest = np.concatenate(parts)
        return tuple(rest[run.all, j] for j, run in enumerate(self.runs))

    def shifted_friction(self, early: float = 0.0) -> tuple[Array, ...]:
        """Return the change of torque (R_j,) if dry friction is a sample late, by its delay, N·m/s.

        Or ``early`` by so many seconds. A joint sticks for a moment at a reversal, until the torque
        of its drive has changed by twice the level of dry friction; positions do not show it.
        """
        fit, parts = self.fit, []
        for segment in self.segments:
            level = dry_level(fit.compiled, segment, fit.shapes, fit.parameters)
            friction = np.where(segment.moving, level * expected_sign(segment), 0.0)
            shift = -max(1, round(early * segment.rate)) if early else 1
            rows = np.clip(np.arange(len(friction)) - shift, 0, len(friction) - 1)
            parts.append(segment.filter((friction[rows] - friction) * segment.rate / shift))
        change = np.concatenate(parts)
        return tuple(change[run.all, j] for j, run in enumerate(self.runs))


def _runs(fit: Fit, rows: DesignRows, segments: Sequence[Processed]) -> tuple[Runs, ...]:
    doubt = [friction_torque_std(fit.compiled, s, fit.shapes, fit.parameters) for s in segments]
    usable = np.zeros((int(rows.segments[-1]), fit.model.n), dtype=bool)
    for j, joint in enumerate(rows.joints):
        usable[joint.instant, j] = True
    return runs_of(usable, segments, np.concatenate(doubt))


def _dense(rows: DesignRows, slopes: Sequence[Array] | None) -> list[Array]:
    """Return the matrix of each joint in all columns, with derivatives by shapes beside them."""
    matrices = []
    for j, joint in enumerate(rows.joints):
        wide = np.zeros((len(joint.torque), rows.count))
        wide[:, joint.columns] = joint.matrix
        matrices.append(wide if slopes is None else np.column_stack([wide, slopes[j]]))
    return matrices


def _on_runs(rows: DesignRows, runs: Sequence[Runs], values: Sequence[Array]) -> tuple[Array, ...]:
    """Return values on the rows of each joint at the instants of its runs."""
    found = []
    for joint, run, own in zip(rows.joints, runs, values, strict=True):
        line = np.zeros((int(rows.segments[-1]), *own.shape[1:]))
        line[joint.instant] = own
        found.append(line[run.all])
    return tuple(found)
