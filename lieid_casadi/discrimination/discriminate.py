"""``discriminate``: the motion along which no rival can pass for another."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieid_casadi.blas_threads import blas_on_one_thread
from lieid_casadi.discrimination.discrimination import Discrimination, Pair
from lieid_casadi.discrimination.rivals import Rivals, Stacked
from lieid_casadi.discrimination.trajectory_search import Climb, Feasible, best_starts, climb
from lieid_casadi.errors import ExcitationError, ModelError, NoSolution
from lieid_casadi.excitation.basis import families
from lieid_casadi.excitation.basis.trajectory import Parametrization
from lieid_casadi.excitation.limits.joint_limits import (
    check_duration,
    check_start_pose,
    motion_range,
)
from lieid_casadi.excitation.limits.symbolic_limits import Limit, Torque
from lieid_casadi.identification import Fit
from lieid_casadi.recording import Recording, process

Array = NDArray[np.float64]
ALIAS = 1e-6  # remaining part of an effect below which no data can tell it
TRIED = 12  # random motions from which aliases and sizes are judged
SAMPLES = 200
CLIMBS = 3  # of the best random motions are refined


@blas_on_one_thread
def discriminate(
    fit: Fit,
    effects: Sequence[str],
    *,
    sizes: Mapping[str, Sequence[float]] | None = None,
    recordings: Sequence[Recording] = (),
    level: float = 0.95,
    duration: float = 10.0,
    harmonics: int = 5,
    samples: int | None = None,
    start_pose: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    constraints: Sequence[Limit] | None = None,
    starts: int = 100,
    evaluations: int = 1500,
    time_limit: float = 20.0,
    rate: float = 1000.0,
    seed: int = 0,
    progress: Callable[[str, float], None] = lambda stage, fraction: None,
) -> Discrimination:
    """Design the motion that tells rival effects apart, and say how long to run it.

    T-optimal (Atkinson, Fedorov, Biometrika 1975), for the worst pair: of each effect's torque,
    that part counts which the best refit of the other rival's model (all base columns, the
    effects of the fit, its own columns at any of a grid of shapes, finer for the result) leaves,
    over the noise of each joint. Random motions within the limits are screened by projections;
    the best three are refined by random steps, so the optimum is local and, where the time limit
    ends the search, depends on the machine. Shapes of effects that the rivals share stay at their
    fitted values.

    The time is that at which the likelihood ratio rejects the wrong rival at level 1 − ``level``
    with probability ``level``: noncentral χ² with as many degrees of freedom as the true effect
    has numbers. Rows of correlated noise count as the independent ones they are worth: two per
    second and Hz of the fit's cut-off, or fewer where the residual along ``recordings`` says so.

    Parameters
    ----------
    fit : Fit
        Its noise, its bodies and effects; rivals that it has keep their fitted size.
    effects : sequence of str
        ``stribeck:1``, each on one joint.
    sizes : mapping, optional
        Of an effect's label: its coefficients, followed or not by its shapes. An effect without
        a stated or fitted size gets the RMS torque of the largest of those, or of the noise, in
        equal parts to its columns.
    recordings : sequence of Recording
        Along which the colour of the residual is measured.
    duration : float
        Of one period, s.
    samples : int
        Of the criterion over a period; 200, or 8 a coefficient, if left out.
    starts, evaluations : int
        Random motions, and evaluations of the criterion altogether. Ctrl-C while the best of
        them are refined keeps the best so far.
    time_limit : float
        s of the search.
    rate : float
        Of the trajectory file, Hz.

    Raises
    ------
    EffectError
        Fewer than two effects, one twice, unknown, not on one joint, or one that needs a
        temperature; a size that does not fit.
    ModelError
        A fit without noise.
    ExcitationError
        Limits that are missing or contradict each other.
    NoSolution
        Exact aliases, that no data can tell apart; no motion within the limits.
    """
    began = time.monotonic()
    if not 0.5 <= level < 1.0:
        raise ExcitationError(f"level: {level:g}; expected 0.5 to 1")
    if starts < TRIED or evaluations < 1 or not rate > 0.0:
        raise ExcitationError(
            f"starts {starts}, evaluations {evaluations}, rate {rate:g}; expected {TRIED} at "
            "least, 1 at least, and a positive number"
        )
    silent = [f"joint {j + 1}" for j, noise in enumerate(fit.noise) if not noise > 0.0]
    if silent:
        raise ModelError(f"the fit knows no noise of {', '.join(silent)}; fit a measured recording")
    progress("compiling", 0.0)
    feasible = _feasible(fit, duration, harmonics, samples, start_pose, acceleration, constraints)
    rivals = Rivals(
        fit, effects, sizes or {}, independent_rate=independent_rate(fit, recordings),
        duration=duration, velocity=feasible.range.velocity,
    )  # fmt: skip
    random = np.random.default_rng([seed, 20])
    drawn = [feasible.drawn(random) for _ in range(starts)]
    first = [feasible.motion(z) for z in drawn[:TRIED]]
    rivals.sized(first)
    told = _told(rivals, [rivals.along(motion) for motion in first])
    needed = {(a, b): noncentrality_needed(rivals.rivals[a].parameters, level) for a, b in told}

    def value(z: Array) -> float:
        stacked = rivals.along(feasible.motion(z))
        return min(_noncentrality(rivals, stacked, *pair) / needed[pair] for pair in told)

    until = time.monotonic() + time_limit
    values: list[float] = []
    for k, z in enumerate(drawn):
        progress("random motions", 0.3 * k / starts)
        values.append(value(z))
        if time.monotonic() > until - 0.5 * time_limit:
            break
    climbs: list[Climb] = []
    share = (evaluations - len(values)) // CLIMBS
    for k, at in enumerate(best_starts(values, CLIMBS)):
        progress(f"refining {k + 1} of {CLIMBS}", 0.3 + 0.7 * k / CLIMBS)
        end = time.monotonic() + (until - time.monotonic()) / (CLIMBS - k)
        climbs.append(
            climb(value, feasible, drawn[at], evaluations=share, until=end, random=random)
        )
        if climbs[-1].interrupted:
            break
    best, violation = feasible.verified(max(climbs, key=lambda c: c.value).z)
    rivals.finer()
    stacked = rivals.along(feasible.motion(best))
    pairs = tuple(
        _pair(rivals, stacked, pair, pair in told, level, feasible.samples) for pair in rivals.pairs
    )
    worst = max(p.needed / p.noncentrality for p in pairs if p.told)
    return Discrimination(
        model=rivals.common, trajectory=feasible.parametrization.trajectory(best),
        periods=int(np.ceil(worst)), level=level,
        sizes={r.label: [*r.coefficients.tolist(), *r.shapes.tolist()] for r in rivals.rivals},
        pairs=pairs, random=_seconds(float(np.median(values)), duration),
        max_violation=violation, evaluations=len(values) + sum(c.evaluations for c in climbs),
        solve_seconds=time.monotonic() - began, rate=rate, interrupted=climbs[-1].interrupted,
    )  # fmt: skip


def noncentrality_needed(parameters: int, level: float) -> float:
    """Return the noncentrality at which χ² rejects at 1 − level with probability level."""
    from scipy.optimize import brentq
    from scipy.stats import chi2, ncx2

    threshold = chi2.ppf(level, parameters)
    return float(brentq(lambda x: ncx2.sf(threshold, parameters, x) - level, 1e-6, 1e3))


def independent_rate(fit: Fit, recordings: Sequence[Recording]) -> Array:
    """Return independent samples per second of each joint's residual (n,).

    A residual with correlations ρ_k at lags of h s is worth 1/(h·(1 + 2·Σρ_k)) slow samples per
    second; the sum ends where the correlogram first falls below zero.
    """
    cutoff = fit.processing.cutoff
    assert cutoff is not None
    rates = np.full(fit.model.n, 2.0 * cutoff)
    for recording in recordings:
        fit.check_joints(recording)
        for segment in process(recording, fit.processing):
            if segment.tau is None:
                continue
            residual = segment.filter(segment.tau) - fit.predict_processed(segment)
            step = (segment.kept.step or 1) / segment.rate
            worth = [1.0 / (step * correlation_sum(e)) for e in residual.T]
            rates = np.minimum(rates, worth)
    return rates


def correlation_sum(residual: Array) -> float:
    """Return 1 + 2·Σρ_k of a residual (M,), at least 1."""
    centred = residual - residual.mean()
    size = len(centred)
    spectrum = np.abs(np.fft.rfft(centred, 2 * size)) ** 2
    covariance = np.fft.irfft(spectrum)[:size]
    if covariance[0] <= 0.0:
        return 1.0
    correlation = covariance / covariance[0]
    negative = np.flatnonzero(correlation < 0.0)
    end = int(negative[0]) if len(negative) else size
    return max(1.0, float(1.0 + 2.0 * correlation[1:end].sum()))


def _feasible(
    fit: Fit,
    duration: float,
    harmonics: int,
    samples: int | None,
    start_pose: ArrayLike | None,
    acceleration: ArrayLike | None,
    constraints: Sequence[Limit] | None,
) -> Feasible:
    robot = fit.model.robot
    basis = families.make("fourier", duration=duration, harmonics=harmonics)
    if samples is None:
        samples = max(SAMPLES, 8 * basis.size)
    if samples < 4 * basis.size:
        raise ExcitationError(f"samples: {samples}; expected {4 * basis.size} at least")
    limits = motion_range(robot, acceleration)
    check_duration(robot, limits, duration)
    pose = limits.middle if start_pose is None else np.asarray(start_pose, dtype=float)
    check_start_pose(robot, limits, pose)
    if constraints is None:
        known = robot.has_inertia and bool(np.isfinite(robot.limit("torque")).any())
        constraints = (Torque(),) if known else ()
    sets = tuple(s for s in (limit.on(robot) for limit in constraints) if s is not None)
    return Feasible(Parametrization(basis, pose, True, limits.units), limits, sets, samples)


def _told(rivals: Rivals, tried: Sequence[Stacked]) -> list[tuple[int, int]]:
    """Return the pairs of which the true effect leaves something along some motion.

    Raises
    ------
    NoSolution
        An effect that the model absorbs, or two that are one: whatever the motion.
    """
    for k, rival in enumerate(rivals.rivals):
        parts = []
        for stacked in tried:
            own = stacked.columns[k][0] @ rival.coefficients
            left = stacked.rest(own[:, None])
            parts.append(np.linalg.norm(left) / max(float(np.linalg.norm(own)), 1e-300))
        if max(parts) < ALIAS:
            raise NoSolution(
                f"{rival.label}: the model's other parameters absorb it along any motion; no data "
                "can tell. Leave it out, or fix what absorbs it"
            )
    told = [
        (a, b)
        for a, b in rivals.pairs
        if max(_remaining(rivals, stacked, a, b) for stacked in tried) >= ALIAS
    ]
    for a, b in rivals.pairs:
        if (a, b) not in told and (b, a) not in told:
            one, other = rivals.rivals[a].label, rivals.rivals[b].label
            raise NoSolution(
                f"{one} and {other} of these sizes explain the same torque along any motion; no "
                "data can tell them apart. Leave one of them out, or state other sizes"
            )
    return told


def _noncentrality(rivals: Rivals, stacked: Stacked, true: int, rival: int) -> float:
    left = stacked.unexplained(true, rival, rivals.rivals[true].coefficients)
    return float(left @ left)


def _remaining(rivals: Rivals, stacked: Stacked, true: int, rival: int) -> float:
    own = stacked.columns[true][0] @ rivals.rivals[true].coefficients
    left = np.sqrt(_noncentrality(rivals, stacked, true, rival))
    return float(left / max(float(np.linalg.norm(own)), 1e-300))


def _pair(
    rivals: Rivals,
    stacked: Stacked,
    pair: tuple[int, int],
    told: bool,
    level: float,
    samples: int,
) -> Pair:
    true, other = (rivals.rivals[k] for k in pair)
    left = stacked.unexplained(*pair, true.coefficients)
    torque = left.reshape(samples, -1) * np.sqrt(samples) / rivals.torque_weight()
    return Pair(
        true=true.label, rival=other.label, noncentrality=float(left @ left),
        needed=noncentrality_needed(true.parameters, level),
        remaining=_remaining(rivals, stacked, *pair), told=told, left=torque,
    )  # fmt: skip


def _seconds(value: float, duration: float) -> float:
    return duration / value if value > 0.0 else float("inf")
