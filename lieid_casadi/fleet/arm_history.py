"""Nights of each arm as series of its quantities, read from the tables of the history."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.fleet.history import History
from lieid_casadi.fleet.scatter import NightSeries

ERROR = "error"  # name of the series of a joint's error


@dataclass(frozen=True)
class Quantity:
    """A coefficient of an effect, such as ``coulomb.f_c``, or ``error``, of a joint from 1."""

    name: str
    joint: int

    @property
    def effect(self) -> str:
        """Name of the effect."""
        return self.name.partition(".")[0]

    @property
    def label(self) -> str:
        """Name with the joint: ``coulomb.f_c:2``."""
        return f"{self.name}:{self.joint}"


@dataclass(frozen=True)
class FoundEffect:
    """An effect that the diagnosis of a night found; joint from 1, None for the whole arm."""

    change: float
    std: float | None
    unit: str
    severity: float
    sentence: str


@dataclass(frozen=True, eq=False)
class ArmHistory:
    """All nights of one arm since its baseline was started.

    Attributes
    ----------
    serial, robot : str
    joints : int
    dates : tuple of date
        One per night, increasing.
    series : mapping
        Quantity → values of all nights; errors are logarithms relative to the expected error.
    units : mapping
        Quantity → unit.
    found : tuple of mapping
        For each night: (effect, joint) → what the diagnosis found.
    shares : (N,)
        Largest part, over the joints, of the torque that the fit no longer predicts.
    starts : mapping
        Joint → first night of its baseline after an acknowledgement (None: of all joints).
    limits : mapping
        Effect or parameter → largest permitted values.
    """

    serial: str
    robot: str
    joints: int
    dates: tuple[date, ...]
    series: Mapping[Quantity, NightSeries]
    units: Mapping[Quantity, str]
    found: tuple[Mapping[tuple[str, int | None], FoundEffect], ...]
    shares: NDArray[np.float64]
    starts: Mapping[int | None, date]
    limits: Mapping[str, list[float]]

    def until(self, last: date) -> ArmHistory:
        """Return the nights up to a date."""
        count = sum(night <= last for night in self.dates)
        return replace(
            self,
            dates=self.dates[:count],
            series={quantity: s.part(0, count) for quantity, s in self.series.items()},
            found=self.found[:count],
            shares=self.shares[:count],
        )

    def baseline_of(self, joint: int | None) -> int:
        """Return the position of the first night of the baseline of a joint, or of the arm."""
        starts = [self.starts[j] for j in (None, joint) if j in self.starts]
        return sum(night < max(starts) for night in self.dates) if starts else 0


#: Motions are the same if positions differ by less than this part of the range, and this, rad.
SAME_MOTION, SAME_POSITION = 0.05, 0.01
LEAST_ERROR_SCATTER = 0.02  # of the logarithm of an error: its unit of scale
#: Runs of the present fit of each arm; of a recording that was run twice, the later one.
RUNS = (
    "WITH used AS (SELECT r.run_id, r.serial, r.date, r.started, r.payload FROM runs r "
    "JOIN arms a ON r.serial = a.serial AND r.fit_sha256 = a.fit_sha256 WHERE r.status = 'done' "
    "QUALIFY row_number() OVER (PARTITION BY r.serial, r.recording ORDER BY r.started DESC) = 1) "
)


def read_arms(history: History) -> list[ArmHistory]:
    """Return the histories of all arms that have nights, in the order of their serial numbers."""
    import json

    runs: dict[str, list[tuple[str, date, str]]] = defaultdict(list)
    for run_id, serial, night, payload in history.rows(
        RUNS + "SELECT run_id, serial, date, payload FROM used ORDER BY serial, date, started"
    ):
        runs[serial].append((run_id, night, payload or ""))
    rows = _RowsByRun.read(history)
    starts = _starts(history)
    arms = []
    for serial, robot, joints, limits in history.rows(
        "SELECT serial, robot, joints, limits FROM arms ORDER BY serial"
    ):
        if not runs[serial]:
            continue
        ids = [run_id for run_id, *_ in runs[serial]]
        nights = tuple(night for _, night, _ in runs[serial])
        motions = motions_of([(load, rows.ranges[run_id]) for run_id, _, load in runs[serial]])
        series, units = _series(ids, nights, motions, rows.parameters, rows.errors, joints)
        arms.append(
            ArmHistory(
                serial, robot, joints, nights, series, units,
                tuple({(f[0], f[1]): FoundEffect(*f[2:]) for f in rows.findings[i]} for i in ids),
                np.array([_share(rows.errors[i]) for i in ids]),
                starts[serial], json.loads(limits),
            )
        )  # fmt: skip
    return arms


@dataclass(frozen=True, eq=False)
class _RowsByRun:
    """Rows of the tables of the history by run_id, of the runs that `RUNS` selects.

    Attributes
    ----------
    parameters
        (name, joint, value, std, unit)
    errors
        (joint, rms_moving, expected, torque_rms, temperature), ordered by joint
    ranges
        (q_low, q_high, q_mean, q_std), ordered by joint
    findings
        (effect, joint, change, std, unit, severity, sentence)
    """

    parameters: Mapping[str, list[tuple[Any, ...]]]
    errors: Mapping[str, list[tuple[Any, ...]]]
    ranges: Mapping[str, list[tuple[Any, ...]]]
    findings: Mapping[str, list[tuple[Any, ...]]]

    @classmethod
    def read(cls, history: History) -> _RowsByRun:
        return cls(
            parameters=_by_run(
                history,
                "SELECT run_id, name, joint, value, std, unit FROM used "
                "JOIN parameters USING (run_id)",
            ),
            errors=_by_run(
                history,
                "SELECT run_id, e.joint, rms_moving, expected, torque_rms, temperature "
                "FROM used JOIN errors e USING (run_id) ORDER BY run_id, joint",
            ),
            ranges=_by_run(
                history,
                "SELECT run_id, q_low, q_high, q_mean, q_std FROM used "
                "JOIN errors e USING (run_id) WHERE q_low IS NOT NULL ORDER BY run_id, joint",
            ),
            findings=_by_run(
                history,
                "SELECT run_id, effect, joint, change, std, unit, severity, sentence "
                "FROM used JOIN findings USING (run_id)",
            ),
        )


def _by_run(history: History, query: str) -> defaultdict[str, list[tuple[Any, ...]]]:
    """Return the rows of a query on `RUNS`, whose first column is run_id, by run."""
    found: defaultdict[str, list[tuple[Any, ...]]] = defaultdict(list)
    for run_id, *rest in history.rows(RUNS + query):
        found[run_id].append(tuple(rest))
    return found


def _starts(history: History) -> defaultdict[str, dict[int | None, date]]:
    """Return, for each arm and joint, the first night of the baseline."""
    from datetime import timedelta

    starts: defaultdict[str, dict[int | None, date]] = defaultdict(dict)
    for serial, joint, last in history.rows(
        "SELECT serial, joint, max(date) FROM acknowledgements GROUP BY serial, joint"
    ):
        starts[serial][joint] = last + timedelta(days=1)
    return starts


def _series(
    ids: list[str],
    nights: tuple[date, ...],
    motions: NDArray[np.intp],
    parameters: Mapping[str, list[tuple[Any, ...]]],
    errors: Mapping[str, list[tuple[Any, ...]]],
    joints: int,
) -> tuple[dict[Quantity, NightSeries], dict[Quantity, str]]:
    """Return the series of one arm and their units; quantities that a night lacks are left out.

    Parameters
    ----------
    ids : list of str
        Of the runs, in the order of the nights.
    nights : tuple of date
    motions : (N,) int
    parameters, errors : mapping
        Rows by run.
    joints : int
    """
    days = np.array([night.toordinal() for night in nights], dtype=float)
    warm = np.full((len(ids), joints), np.nan)
    log_error = np.full((len(ids), joints), np.nan)
    values: defaultdict[Quantity, list[tuple[float, float]]] = defaultdict(list)
    units: dict[Quantity, str] = {}
    for k, run_id in enumerate(ids):
        for joint, rms, expected, _, temperature in errors[run_id]:
            if rms and expected:
                log_error[k, joint - 1] = np.log(rms / expected)
            warm[k, joint - 1] = np.nan if temperature is None else temperature
        for name, joint, value, std, unit in parameters[run_id]:
            values[Quantity(name, joint)].append((value, std))
            units[Quantity(name, joint)] = unit
    series = {}
    for quantity, pairs in values.items():
        if len(pairs) == len(ids):
            x, scale = np.array(pairs).T
            scale = np.maximum(scale, 1e-12)
            series[quantity] = NightSeries(days, x, scale, warm[:, quantity.joint - 1], motions)
    unknown = np.full(len(ids), np.nan)
    for j in range(joints):
        if np.isfinite(log_error[:, j]).all():
            scale = np.full(len(ids), LEAST_ERROR_SCATTER)
            series[Quantity(ERROR, j + 1)] = NightSeries(
                days, log_error[:, j], scale, unknown, motions
            )
    return series, units


def motions_of(nights: Sequence[tuple[str, Sequence[tuple[float, ...]]]]) -> NDArray[np.intp]:
    """Return the number of each night's motion (N,), from 0.

    Parameters
    ----------
    nights : sequence of (str, sequence of (4,))
        Label of the payload; of each joint lowest, highest and mean position and its standard
        deviation. Nights without positions have one motion.
    """
    known: list[tuple[str, NDArray[np.float64]]] = []
    numbers = []
    for label, positions in nights:
        own = np.array(positions, dtype=float)
        for number, (other, its) in enumerate(known):
            if other == label and _is_same_motion(own, its):
                numbers.append(number)
                break
        else:
            numbers.append(len(known))
            known.append((label, own))
    return np.array(numbers, dtype=np.intp)


def _is_same_motion(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    if a.shape != b.shape or not a.size:
        return a.shape == b.shape
    span = np.maximum(a[:, 1] - a[:, 0], b[:, 1] - b[:, 0])
    return bool((np.abs(a - b) <= SAME_MOTION * span[:, None] + SAME_POSITION).all())


def _share(errors: list[tuple[Any, ...]]) -> float:
    """Return the largest part of a joint's torque that the fit no longer predicts."""
    shares = [
        np.sqrt(max(rms**2 - expected**2, 0.0)) / torque
        for _, rms, expected, torque, _ in errors
        if rms and expected and torque
    ]
    return float(max(shares, default=0.0))
