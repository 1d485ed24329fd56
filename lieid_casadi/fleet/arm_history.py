"""Nights of each arm as series of its quantities, read from the tables of the history."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date, timedelta
from itertools import pairwise
from typing import Any

import numpy as np

from lieid_casadi.arrays import Array, Indices
from lieid_casadi.fleet.changes import EARLIER_NIGHTS, LATEST_NIGHTS, NightSeries, used_nights
from lieid_casadi.fleet.history import History
from lieid_casadi.fleet.night_result import Finding

ERROR = "error"  # name of the series of a joint's error
#: Motions are the same if positions differ by less than this part of the range, and this, rad.
SAME_MOTION, SAME_POSITION = 0.05, 0.01
LEAST_ERROR_SCATTER = 0.02  # of the logarithm of an error: its unit of scale
ARMS_AT_ONCE = 250  # that are read by one query, which scans whole tables
#: Runs of the present fit of some arms, numbered night by night (k); of a recording that was run
#: twice, also at another place, the later one. Of nights before the latest ones only some are kept.
KEPT = f"""
CREATE OR REPLACE TEMP TABLE kept AS
WITH used AS (
    SELECT r.run_id, r.serial, r.date, r.started, r.payload FROM runs r
    JOIN arms a ON r.serial = a.serial AND r.fit_sha256 = a.fit_sha256
    WHERE r.status = 'done' AND r.serial BETWEEN $first AND $last AND NOT EXISTS (
        SELECT 1 FROM maintenance m
        WHERE m.serial = r.serial AND r.date BETWEEN m.first AND m.last)
    QUALIFY row_number() OVER (PARTITION BY r.serial, recording ORDER BY started DESC) = 1
        AND row_number() OVER (PARTITION BY r.serial, recording_sha256 ORDER BY started DESC) = 1
), aged AS (
    SELECT *, row_number() OVER (PARTITION BY serial ORDER BY date DESC, started DESC) AS age,
        count(*) OVER (PARTITION BY serial) AS total
    FROM used
)
SELECT run_id, serial, date, payload,
    row_number() OVER (PARTITION BY serial ORDER BY age DESC) - 1 AS k
FROM aged WHERE age <= $latest
    OR (total - age) % ceil((total - $latest) / {EARLIER_NIGHTS})::BIGINT = 0
"""
_JOINT_COLUMNS = (
    "rms_moving", "expected", "torque_rms", "temperature", "q_low", "q_high", "q_mean", "q_std",
)  # fmt: skip


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


@dataclass(frozen=True, eq=False)
class ArmHistory:
    """Nights of one arm with its present fit."""

    serial: str
    robot: str
    joints: int
    dates: tuple[date, ...]  # one per night, increasing
    series: Mapping[Quantity, NightSeries]  # errors are logarithms relative to the expected error
    units: Mapping[Quantity, str]
    found: tuple[Mapping[tuple[str, int | None], Finding], ...]  # by effect and joint
    shares: Array  # (N,) largest part of a joint's torque that the fit no longer predicts
    starts: Mapping[int | None, date]  # joint → first night of its baseline; None: of all joints
    limits: Mapping[str, list[float]]  # effect or parameter → largest permitted values

    def until(self, last: date) -> ArmHistory:
        """Return the nights up to a date that a judgement uses."""
        nights = used_nights(sum(night <= last for night in self.dates))
        if len(nights) == len(self.dates):
            return self
        return replace(
            self,
            dates=tuple(self.dates[k] for k in nights),
            series={quantity: s.at(nights) for quantity, s in self.series.items()},
            found=tuple(self.found[k] for k in nights),
            shares=self.shares[nights],
        )

    def baseline_of(self, joint: int | None) -> int:
        """Return the position of the first night of the baseline of a joint, or of the arm."""
        starts = [self.starts[j] for j in (None, joint) if j in self.starts]
        return sum(night < max(starts) for night in self.dates) if starts else 0


def read_arms(history: History, *, waiting: int | None = None) -> Iterator[ArmHistory]:
    """Yield the histories of all arms that have nights, in the order of their serial numbers."""
    latest = 10**9 if waiting is None else LATEST_NIGHTS + waiting - 1
    starts: defaultdict[str, dict[int | None, date]] = defaultdict(dict)
    for serial, joint, last in history.rows(
        "SELECT serial, joint, max(date) FROM acknowledgements GROUP BY serial, joint"
    ):
        starts[serial][joint] = last + timedelta(days=1)
    arms = history.rows(
        "SELECT serial, robot, joints, limits FROM arms WHERE retired IS NULL ORDER BY serial"
    )
    for first, end in pairwise([*range(0, len(arms), ARMS_AT_ONCE), len(arms)]):
        part = arms[first:end]
        ends = {"first": part[0][0], "last": part[-1][0]}
        history.connection.execute(KEPT, ends | {"latest": latest})
        rows = _rows_by_arm(history, ends)
        for serial, robot, joints, limits in part:
            if rows["nights"][serial]:
                own = {name: each[serial] for name, each in rows.items()}
                yield _arm((serial, robot, joints), own, starts[serial], json.loads(limits))


def _rows_by_arm(
    history: History, ends: Mapping[str, str]
) -> dict[str, defaultdict[str, list[tuple[Any, ...]]]]:
    """Return rows of the kept runs by table and arm: nights, quantities, joints and findings."""
    own = "USING (run_id, serial) WHERE serial BETWEEN $first AND $last"
    lists = ", ".join(f"list({name} ORDER BY k)" for name in _JOINT_COLUMNS)
    queries = {
        "nights": "SELECT serial, date, payload FROM kept WHERE serial BETWEEN $first AND $last "
        "ORDER BY serial, k",
        "quantities": "SELECT serial, name, joint, any_value(unit), list(value ORDER BY k), "
        f"list(std ORDER BY k) FROM kept JOIN parameters p {own} "
        "GROUP BY serial, name, joint ORDER BY serial, min(p.rowid)",
        "joints": f"SELECT serial, joint, {lists} FROM kept JOIN errors {own} "
        "GROUP BY serial, joint ORDER BY serial, joint",
        "findings": "SELECT serial, k, effect, joint, change, std, unit, severity, sentence, "
        f"rivals FROM kept JOIN findings f {own} ORDER BY serial, k, f.rowid",
    }
    found: dict[str, defaultdict[str, list[tuple[Any, ...]]]] = {}
    for name, query in queries.items():
        found[name] = defaultdict(list)
        for serial, *rest in history.connection.execute(query, ends).fetchall():
            found[name][serial].append(tuple(rest))
    return found


def _arm(
    identity: tuple[str, str, int],
    rows: Mapping[str, list[tuple[Any, ...]]],
    starts: Mapping[int | None, date],
    limits: Mapping[str, list[float]],
) -> ArmHistory:
    """Return one arm from its rows; quantities that a night lacks are left out."""
    dates = tuple(night for night, _ in rows["nights"])
    count, joints = len(dates), identity[2]
    columns = np.full((len(_JOINT_COLUMNS), joints, count), np.nan)
    for joint, *lists in rows["joints"]:
        if len(lists[0]) == count:
            columns[:, joint - 1] = np.array(lists, dtype=float)
    rms, expected, torque, warm = (column.copy() for column in columns[:4])  # views keep all 8
    motions = motions_of([load or "" for _, load in rows["nights"]], np.moveaxis(columns[4:], 2, 0))
    days = np.array([night.toordinal() for night in dates], dtype=float)
    series, units = {}, {}
    for name, joint, unit, values, stds in rows["quantities"]:
        if len(values) == count:
            scales = np.maximum(np.array(stds, dtype=float), 1e-12)
            quantity, x = Quantity(name, joint), np.array(values, dtype=float)
            series[quantity] = NightSeries(days, x, scales, warm[joint - 1], motions)
            units[quantity] = unit
    with np.errstate(divide="ignore", invalid="ignore"):
        log_error = np.log(rms / expected)
        lost = np.sqrt(np.maximum(rms**2 - expected**2, 0.0)) / torque
    unknown, scales = np.full(count, np.nan), np.full(count, LEAST_ERROR_SCATTER)
    for j in np.flatnonzero(np.isfinite(log_error).all(axis=1)):
        own = NightSeries(days, log_error[j], scales, unknown, motions)
        series[Quantity(ERROR, int(j) + 1)] = own
    nothing: dict[tuple[str, int | None], Finding] = {}  # of nearly all nights
    found = [nothing] * count
    for k, *columns_of_finding in rows["findings"]:
        finding = Finding(*columns_of_finding)
        found[k] = found[k] | {(finding.effect, finding.joint): finding}
    shares = np.where(np.isfinite(lost), lost, 0.0).max(axis=0, initial=0.0)
    return ArmHistory(*identity, dates, series, units, tuple(found), shares, starts, limits)


def motions_of(labels: Sequence[str], positions: Array) -> Indices:
    """Return the number of each night's motion (N,), from 0, by payload and positions.

    Positions (N, 4, n) are the lowest, highest and mean one and the standard deviation of each
    joint; nights without positions (NaN) have one motion.
    """
    unknown = np.asarray(np.isnan(positions).any(axis=(1, 2)))
    span: Array = positions[:, 1] - positions[:, 0]
    numbers = np.full(len(labels), -1, dtype=np.intp)
    for number in range(len(labels)):
        rest = np.flatnonzero(numbers < 0)
        if not len(rest):
            break
        first = rest[0]
        tolerance = SAME_MOTION * np.maximum(span, span[first]) + SAME_POSITION
        farthest = np.abs(positions - positions[first]).max(axis=1) - tolerance
        alike = np.where(unknown, unknown[first], (farthest <= 0.0).all(axis=1))
        same_label = np.array([label == labels[first] for label in labels])
        numbers[alike & same_label & (numbers < 0)] = number
    return numbers
