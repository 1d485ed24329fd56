"""Which quantities of which arms have changed by a night, and which arms are unlike their kind."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from operator import itemgetter

import numpy as np
from scipy.stats import false_discovery_control, median_abs_deviation
from scipy.stats import t as student

from lieid_casadi.arrays import Array
from lieid_casadi.blas_threads import blas_on_one_thread
from lieid_casadi.fleet import changes
from lieid_casadi.fleet.arm_history import ERROR, ArmHistory, Quantity
from lieid_casadi.fleet.history import History
from lieid_casadi.tables import Table, make_table

FALSE_ALARMS = 5e-4  # per arm and night, at most
KNOWN_CHANGE = 0.01  # p-value of a quantity of a joint with an open alarm, not corrected
DISCOVERY_RATE = 0.05  # false discoveries among the arms with a new change, at most
LEAST_SIZE = 3.0  # of a change, in units of the night-to-night scatter
SEEN_WITHOUT_NIGHT = 0.01  # p-value at which nights show a change without any one of them
RARE_FINDING = 0.002  # least rate of a finding, per night
POOLED = 400  # arms of a kind from which the scatter of the kind is estimated
FEWEST_ARMS = 6  # of one kind that are compared
MOST_OUTLIERS = 0.25  # part of the arms of a kind
FALSE_OUTLIERS = 1e-3  # of the arms of one kind together, if their coefficients are normal


@dataclass(frozen=True, eq=False)
class ChangedQuantity:
    """A quantity of an arm whose change is significant."""

    quantity: Quantity
    change: changes.Change
    since: date

    @property
    def label(self) -> str:
        """Label of the quantity."""
        return self.quantity.label

    @property
    def joint(self) -> int | None:
        """Joint of the quantity, from 1."""
        return self.quantity.joint


@dataclass(frozen=True)
class RepeatedEffect:
    """An effect that diagnoses find on an arm since a night."""

    effect: str
    joint: int | None
    since: date

    @property
    def label(self) -> str:
        """Name of the effect, with its joint if it has one."""
        return label_of(self.effect, self.joint)


def label_of(name: str, joint: int | None) -> str:
    """Return a name with the joint, from 1, if there is one."""
    return name if joint is None else f"{name}:{joint}"


#: What may have changed, and the p-value.
Test = tuple[ChangedQuantity | RepeatedEffect, float]


@dataclass(frozen=True, eq=False)
class JudgedArm:
    """Changes of one arm by a night, the most significant first."""

    arm: ArmHistory
    changed: tuple[ChangedQuantity, ...]
    repeated: tuple[RepeatedEffect, ...]


@blas_on_one_thread
def judge_night(
    arms: Sequence[ArmHistory],
    last: date,
    *,
    alarmed: Mapping[str, Collection[int | None]] | None = None,
) -> list[JudgedArm]:
    """Return the significant changes of all arms with a recording of a night, without later nights.

    Every change is judged against the scatter of its own arm. The p-values of an arm are adjusted
    for their number (Benjamini and Hochberg); the smallest is the p-value of the arm (Simes). Arms
    have changed if it is at most `FALSE_ALARMS`, and if they are discoveries at `DISCOVERY_RATE`
    among the arms without an open alarm. The quantities of other arms, and known changes, therefore
    do not raise the limit of an arm. ``alarmed`` has the joints with an open alarm by serial
    number: a quantity of these belongs to that alarm from `KNOWN_CHANGE` on.
    """
    alarmed = alarmed or {}
    known = [arm for arm in (each.until(last) for each in arms) if arm.dates]
    tonight = [arm for arm in known if arm.dates[-1] == last]
    tests, smallest = _adjusted_tests(tonight, known, alarmed)
    quiet = [k for k, arm in enumerate(tonight) if arm.serial not in alarmed]
    chosen = set(range(len(tonight)))
    if quiet:
        rates = false_discovery_control([smallest[k] for k in quiet])
        chosen -= {k for k, rate in zip(quiet, rates, strict=True) if rate > DISCOVERY_RATE}
    return [_judged(arm, tests[k] if k in chosen else []) for k, arm in enumerate(tonight)]


def _adjusted_tests(
    tonight: Sequence[ArmHistory],
    known: Sequence[ArmHistory],
    alarmed: Mapping[str, Collection[int | None]],
) -> tuple[list[list[Test]], list[float]]:
    """Return, for each arm, significant changes, and the smallest p-value of all."""
    scatter, warmth = _priors(known)
    # on an arm that has changed an effect is found every night; each arm therefore counts once
    counts = Counter(x for arm in known for x in {e for night in arm.found for e, _ in night})
    nights = sum(len(arm.dates) for arm in known)
    significant, smallest = [], []
    for arm in tonight:
        tests: list[Test] = []
        for quantity, series, first in _judged_series(arm):
            prior = scatter.get((arm.robot, quantity.name, series.has_temperature))
            change = changes.strongest_change(
                series,
                prior or changes.scatter_prior([series]),  # no arm of the pool is like it
                warmth.get((arm.robot, quantity)),
                rises_only=quantity.name == ERROR,
            )
            if change is not None:
                item = ChangedQuantity(quantity, change, arm.dates[first + change.first])
                tests.append((item, change.p_value))
        others = max(nights - len(arm.dates), 1)
        rates = {e: (counts[e] - 1) / others for night in arm.found for e, _ in night}
        tests += _repeated(arm, rates)
        if tests:
            p_values = false_discovery_control([p for _, p in tests])
            known_joints, limit = alarmed.get(arm.serial, ()), FALSE_ALARMS / KNOWN_CHANGE
            tests = [
                (item, limit * own if item.joint in known_joints else float(p))
                for (item, own), p in zip(tests, p_values, strict=True)
            ]
        smallest.append(min((p for _, p in tests), default=1.0))
        significant.append([test for test in tests if test[1] <= FALSE_ALARMS])
    return significant, smallest


def _judged(arm: ArmHistory, tests: Sequence[Test]) -> JudgedArm:
    found = [test for test in tests if _is_relevant(arm, test[0])]
    items = [item for item, _ in sorted(found, key=itemgetter(1))]
    return JudgedArm(
        arm,
        tuple(item for item in items if isinstance(item, ChangedQuantity)),
        tuple(item for item in items if isinstance(item, RepeatedEffect)),
    )


def _judged_series(arm: ArmHistory) -> list[tuple[Quantity, changes.NightSeries, int]]:
    """Return the series of an arm since their baselines, and the position of the first night."""
    found = [(q, series, arm.baseline_of(q.joint)) for q, series in arm.series.items()]
    chosen = [(q, s, k) for q, s, k in found if len(s) - k >= changes.FEWEST_NIGHTS]
    return [(q, s.at(slice(k, None)) if k else s, k) for q, s, k in chosen]


def _priors(
    arms: Sequence[ArmHistory],
) -> tuple[
    dict[tuple[str, str, bool], changes.ScatterPrior],
    dict[tuple[str, Quantity], changes.TemperaturePrior],
]:
    """Return the priors of scatter and of the slope over temperature.

    Scatter is pooled over the joints of arms with the same robot, apart for series with and
    without temperatures; slopes over arms with the same robot; in both cases over at most `POOLED`
    arms, evenly spread. Temperatures that are not recorded are expected to vary like those of the
    other arms, and to act like on their strongest joint.
    """
    kinds = defaultdict[str, list[ArmHistory]](list)
    for arm in arms:
        kinds[arm.robot].append(arm)
    pooled = [arm for own in kinds.values() for arm in own[:: -(-len(own) // POOLED)]]
    judged = [(arm.robot, _judged_series(arm)) for arm in pooled]
    by_joint: dict[tuple[str, Quantity], list[changes.NightSeries]] = defaultdict(list)
    for robot, own in judged:
        for quantity, series, _ in own:
            by_joint[robot, quantity].append(series)
    warmth: dict[tuple[str, Quantity], changes.TemperaturePrior] = {}
    slow: dict[tuple[str, str, bool], float] = defaultdict(lambda: changes.EXPECTED_SLOW)
    for (robot, quantity), every in by_joint.items():
        prior = changes.temperature_prior(every)
        if prior is not None:
            warmth[robot, quantity] = prior
            unknown = robot, quantity.name, False
            slow[unknown] = max(slow[unknown], prior.variance)
    pools: dict[tuple[str, str, bool], list[changes.NightSeries]] = defaultdict(list)
    for robot, own in judged:  # the series of one arm beside each other: they share a matrix
        for quantity, series, _ in own:
            known = warmth.get((robot, quantity)) if series.has_temperature else None
            corrected = series if known is None else series.at_mean_temperature(known.slope)
            pools[robot, quantity.name, series.has_temperature].append(corrected)
    scatter = {k: changes.scatter_prior(each, expected_slow=slow[k]) for k, each in pools.items()}
    return scatter, warmth


def _repeated(arm: ArmHistory, rates: dict[str, float]) -> list[tuple[RepeatedEffect, float]]:
    """Return effects that were found this night and before, and their p-values."""
    found = []
    for effect, joint in arm.found[-1]:
        first = arm.baseline_of(joint)
        nights = np.array([(effect, joint) in night for night in arm.found[first:]])
        if effect != "unexplained" and nights.sum() >= 2 and len(nights) >= changes.FEWEST_NIGHTS:
            p, start = changes.repeated_finding(nights, max(rates[effect], RARE_FINDING))
            found.append((RepeatedEffect(effect, joint, arm.dates[first + start]), p))
    return found


def _is_relevant(arm: ArmHistory, item: ChangedQuantity | RepeatedEffect) -> bool:
    """Whether a change exceeds the scatter, and is more than one unusual night."""
    if isinstance(item, RepeatedEffect):
        return True
    change = item.change
    if abs(change.size) < LEAST_SIZE * change.scatter:
        return False
    if change.p_without_night <= SEEN_WITHOUT_NIGHT:
        return True
    joints = {joint for _, joint in arm.found[-1]}
    return item.since == arm.dates[-1] and bool(joints & {None, item.quantity.joint})


@dataclass(frozen=True)
class Outlier:
    """A coefficient of an arm that is unlike those of the other arms with the same robot."""

    serial: str
    robot: str
    name: str
    joint: int  # from 1
    value: float  # on the latest night
    median: float  # over the arms
    spread: float  # robust standard deviation over the arms
    unit: str
    arms: int

    @property
    def sentence(self) -> str:
        """The finding in words."""
        usual = f"{self.median:.4g} ± {self.spread:.2g} {self.unit}"
        return (
            f"{self.serial}: {self.name} of joint {self.joint} is {self.value:.4g} {self.unit}; "
            f"that of the {self.arms} arms {self.robot!r} is {usual}"
        )


def outliers(history: History) -> list[Outlier]:
    """Return the outliers among arms with the same robot, on the latest night of each."""
    kinds = defaultdict[str, dict[tuple[str, int, str], list[tuple[str, float]]]](
        lambda: defaultdict(list)
    )
    for robot, name, joint, unit, serial, value in history.rows(
        "SELECT a.robot, p.name, p.joint, p.unit, serial, p.value FROM latest l "
        "JOIN arms a USING (serial) JOIN parameters p USING (run_id, serial) "
        "WHERE isfinite(p.value) ORDER BY ALL"
    ):
        kinds[robot][name, joint, unit].append((serial, value))
    found = []
    for robot, coefficients in kinds.items():
        for (name, joint, unit), rows in coefficients.items():
            values = np.array([value for _, value in rows])
            for k in extreme(values, FALSE_OUTLIERS / len(coefficients)):
                middle = float(np.median(values))
                spread = float(median_abs_deviation(values, scale="normal"))
                serial, value = rows[k]
                found.append(
                    Outlier(serial, robot, name, joint, value, middle, spread, unit, len(rows))
                )
    return sorted(found, key=lambda x: (x.serial, x.joint, x.name))


def extreme(values: Array, level: float) -> list[int]:
    """Return the positions of outliers among normal values (N,), at a false rate of ``level``.

    The generalized extreme Studentized deviate test (Rosner, Technometrics 25, 1983): the most
    extreme value is removed again and again, so that outliers do not hide each other.
    """
    count = len(values)
    if count < FEWEST_ARMS:
        return []
    rest, removed, outliers = np.arange(count), list[int](), 0
    for step in range(1, int(MOST_OUTLIERS * count) + 1):
        own = values[rest]
        spread = float(own.std(ddof=1))
        if not spread > 0.0:
            break
        worst = int(np.argmax(np.abs(own - own.mean())))
        deviation = abs(float(own[worst] - own.mean())) / spread
        n = len(rest)
        quantile = float(student.isf(level / (2.0 * n), n - 2))
        critical = (n - 1) * quantile / np.sqrt((n - 2 + quantile**2) * n)
        removed.append(int(rest[worst]))
        rest = np.delete(rest, worst)
        if deviation > critical:
            outliers = step
    return removed[:outliers]


def outlier_table(found: Sequence[Outlier]) -> Table:
    """Return one row per outlier."""
    return make_table(
        "Arms unlike the others of their kind",
        ("serial", "robot", "coefficient", "joint", "value", "median", "spread", "unit", "arms"),
        [tuple(vars(x).values()) for x in found],
        note="On the latest night of each arm. Spread: robust standard deviation over the arms.",
    )
