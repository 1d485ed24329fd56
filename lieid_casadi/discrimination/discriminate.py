"""``discriminate``: the motion along which no rival effect can replace the true one."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.blas_threads import blas_on_one_thread
from lieid_casadi.discrimination.discrimination import Discrimination
from lieid_casadi.discrimination.motion_search import (
    SearchedMotion,
    feasible_motions,
    independent_rate,
    random_search,
)
from lieid_casadi.discrimination.rival_effects import RivalEffects, groups_of
from lieid_casadi.errors import ExcitationError, ModelError, NoSolution
from lieid_casadi.excitation.checks import MARGIN, control_times, default_limits, verify
from lieid_casadi.excitation.limits import Limit, motion_range
from lieid_casadi.excitation.sample_functions import FittedArm
from lieid_casadi.excitation.trajectory import MotionSamples
from lieid_casadi.identification import Fit

LEVEL = 0.95  # of the test and its power
TRIED = 12  # random motions from which separability and sizes are determined
REFINED = 3  # of the best random motions


@blas_on_one_thread
def discriminate(
    fit: Fit,
    effects: Sequence[str] | Sequence[Sequence[str]],
    *,
    sizes: Mapping[str, Sequence[float]] | None = None,
    level: float = LEVEL,
    duration: float = 10.0,
    harmonics: int = 5,
    start_pose: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    margin: float = MARGIN,
    limits: Sequence[Limit] | None = None,
    starts: int = 100,
    evaluations: int = 1500,
    rate: float = 1000.0,
    seed: int = 0,
    progress: Callable[[str, float], None] = lambda stage, fraction: None,
) -> Discrimination:
    """Design the motion that separates rival effects, and state how long it must be run.

    Parameters
    ----------
    fit : Fit
        Its noise, link parameters and effects are used. Rivals in it keep their size.
    effects : sequence of str, or of sequences
        ``stribeck:1``, each on one joint; a single one is separated from its absence. Several
        groups of rivals are separated by one motion: pairs are those within a group, beside the
        fit's effects of the other groups.
    sizes : mapping, optional
        Label of an effect → its coefficients, optionally followed by its shape parameters. An
        effect without a stated or fitted size gets the RMS torque of the largest of these, or of
        the noise, in equal parts to its columns.
    level : float
        Of the test and its power, 0.5 to 1.
    duration : float
        Of one period, s.
    harmonics : int
        Of the Fourier series.
    start_pose, acceleration, margin, limits
        As of `excite`.
    starts, evaluations : int
        Number of random motions, and of evaluations of the criterion altogether. Ctrl-C during
        the refinement keeps the best motion so far.
    rate : float
        Of the trajectory file, Hz.
    seed : int
        Of the random motions.
    progress : callable
        Called with the name of a stage and the fraction done, 0 to 1.

    Returns
    -------
    Discrimination

    Raises
    ------
    EffectError
        No effect, one twice, an unknown one, one that is not on a single joint or
        needs a temperature; a size that does not fit.
    ModelError
        A fit without noise.
    ExcitationError
        Limits that are missing or contradict each other.
    NoSolution
        Effects that no data can separate; no motion within the limits.

    Notes
    -----
    The criterion is T-optimality (Atkinson, Fedorov, Biometrika 1975) for the worst pair: the
    part of each effect's torque, relative to the noise of each joint, that the best refit of the
    other effect's model leaves. The refit comprises all base columns, the effects of the fit, and
    the rival's own columns on a grid of shape parameters; the grid is finer for the result. Shape
    parameters of shared effects keep their fitted values. Random motions within the limits are
    screened, and the best three are refined by random steps, so that the optimum is local.

    The stated time is that at which the likelihood ratio rejects the wrong rival at level
    1 − ``level`` with probability ``level``: noncentral χ² with as many degrees of freedom as the
    true effect has parameters. Correlated samples count by their effective number, by the noise
    of the fit: at most two per second and Hz of its cut-off frequency.
    """
    began = time.monotonic()
    _check_options(fit, level, starts, evaluations, rate)
    progress("compile", 0.0)
    arm, robot = FittedArm.of(fit), fit.model.robot
    if limits is None:
        limits = default_limits(robot, margin=margin)
    feasible = feasible_motions(
        robot, arm, motion_range(robot, acceleration, margin=margin), limits,
        duration=duration, harmonics=harmonics, start_pose=start_pose,
    )  # fmt: skip
    groups = _groups(
        fit, effects, sizes or {}, duration=duration, velocity=feasible.range.velocity, level=level
    )
    random = np.random.default_rng([seed, 20])
    drawn = [feasible.drawn(random) for _ in range(starts)]
    for group in groups:
        group.prepare([feasible.motion(z) for z in drawn[:TRIED]])

    def criterion(z: Array) -> float:
        motion = feasible.motion(z)
        return min(group.worst(motion) for group in groups)

    progress("random motions", 0.1)
    values = [criterion(z) for z in drawn]
    refined: list[SearchedMotion] = []
    for k, start in enumerate(np.argsort(values)[::-1][:REFINED]):
        progress(f"refine {k + 1} of {REFINED}", 0.3 + 0.7 * k / REFINED)
        budget = max((evaluations - starts) // REFINED, 1)
        refined.append(
            random_search(criterion, feasible, drawn[start], evaluations=budget, random=random)
        )
        if refined[-1].interrupted:
            break
    best, violation = feasible.verified(max(refined, key=lambda motion: motion.value).z)
    pairs = tuple(pair for group in groups for pair in group.result(feasible.motion(best)))
    worst = max(p.needed / p.noncentrality for p in pairs if p.separable)
    trajectory = feasible.parametrization.trajectory(best)
    whole = trajectory.at(control_times(duration))
    verified = verify(robot, whole, feasible.range, feasible.limits, arm)
    return Discrimination(
        model=groups[0].common, trajectory=trajectory, periods=int(np.ceil(worst)), level=level,
        sizes={
            r.label: [*r.coefficients.tolist(), *r.shapes.tolist()]
            for group in groups for r in group.effects
        },
        pairs=pairs, max_violation=violation,
        evaluations=len(values) + sum(r.evaluations for r in refined),
        solve_seconds=time.monotonic() - began, rate=rate, interrupted=refined[-1].interrupted,
        checked=verified.checked, unchecked=verified.unchecked,
    )  # fmt: skip


def shown_of(
    fit: Fit, effect: str, motion: MotionSamples, *, size: Sequence[float], velocity: Array
) -> float:
    """Return what a stated motion shows of one effect of a stated size.

    This is the noncentrality of the test against its absence, relative to that which `discriminate`
    needs; 0 where other parameters absorb the effect. ``velocity`` (n,) are the speed limits.
    """
    (group,) = _groups(
        fit, [effect], {effect: size}, duration=float(motion.t[-1]), velocity=velocity, level=LEVEL
    )
    try:
        group.prepare([motion])
    except NoSolution:
        return 0.0
    return group.worst(motion)


def _groups(
    fit: Fit,
    effects: Sequence[str] | Sequence[Sequence[str]],
    sizes: Mapping[str, Sequence[float]],
    *,
    duration: float,
    velocity: Array,
    level: float,
) -> list[RivalEffects]:
    """Return the groups of rivals beside a fit, for a period of ``duration`` seconds."""
    rate = independent_rate(fit)
    return [
        RivalEffects(
            fit, group, sizes,
            independent_rate=rate, duration=duration, velocity=velocity, level=level,
        )
        for group in groups_of(effects, sizes)
    ]  # fmt: skip


def _check_options(fit: Fit, level: float, starts: int, evaluations: int, rate: float) -> None:
    """Raise an error if options are out of their range, or if the fit has no noise."""
    if not 0.5 <= level < 1.0 or starts < TRIED or evaluations < 1 or not rate > 0.0:
        raise ExcitationError(
            f"level {level:g}, starts {starts}, evaluations {evaluations}, rate {rate:g}; expected "
            f"0.5 to 1, at least {TRIED}, at least 1, and a positive number"
        )
    silent = [f"joint {j + 1}" for j, noise in enumerate(fit.noise) if not noise > 0.0]
    if silent:
        raise ModelError(
            f"the fit has no noise on {', '.join(silent)}; expected a fit to measured recordings"
        )
