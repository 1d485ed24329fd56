"""``discriminate``: the motion along which no rival effect can replace the true one."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.blas_threads import blas_on_one_thread
from lieid_casadi.discrimination.discrimination import Discrimination, RivalPair
from lieid_casadi.discrimination.motion_search import (
    FeasibleMotions,
    SearchedMotion,
    best_starts,
    feasible_motions,
    independent_rate,
    random_search,
)
from lieid_casadi.discrimination.rival_effects import (
    RivalEffects,
    groups_of,
    noncentrality,
    noncentrality_needed,
    rival_pairs,
    separable_pairs,
)
from lieid_casadi.errors import ExcitationError, ModelError
from lieid_casadi.excitation.checks import MARGIN, default_limits, verify
from lieid_casadi.excitation.limits import Limit, motion_range
from lieid_casadi.excitation.sample_functions import FittedArm
from lieid_casadi.identification import Fit
from lieid_casadi.recording import Recording

TRIED = 12  # random motions from which separability and sizes are determined
REFINED = 3  # of the best random motions


@blas_on_one_thread
def discriminate(
    fit: Fit,
    effects: Sequence[str] | Sequence[Sequence[str]],
    *,
    sizes: Mapping[str, Sequence[float]] | None = None,
    recordings: Sequence[Recording] = (),
    level: float = 0.95,
    duration: float = 10.0,
    harmonics: int = 5,
    samples: int | None = None,
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
        Its noise, link parameters and effects are used. Rivals that it contains keep their
        fitted size.
    effects : sequence of str, or of sequences
        ``stribeck:1``, each on one joint; two at least. Several groups of rivals are separated by
        one motion: pairs are those within a group, beside the fit's effects of the other groups.
    sizes : mapping, optional
        Label of an effect → its coefficients, optionally followed by its shape parameters. An
        effect without a stated or fitted size gets the RMS torque of the largest of these, or of
        the noise, in equal parts to its columns.
    recordings : sequence of Recording
        Along which the autocorrelation of the residual is measured.
    level : float
        Of the test and its power, 0.5 to 1.
    duration : float
        Of one period, s.
    harmonics : int
        Of the Fourier series.
    samples : int, optional
        Of the criterion over a period, by default 200, or 8 per coefficient if that is more.
    start_pose : (n,), optional
        Where the motion begins and ends at rest, rad. Default: the middle of the joint ranges or,
        where that is near a limit, a pose that is far from all limits.
    acceleration : float or (n,), optional
        Limits in place of the robot's, rad/s². Default: 3 where the robot states none.
    margin : float
        Part of the velocity limits, and of the torque limits by default, that is used.
    limits : sequence of Limit, optional
        Besides those of the joints. Default: those of `default_limits`, with the torque of the
        fit; ``()`` leaves all out.
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
        Fewer than two effects, one twice, an unknown one, one that is not on a single joint or
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
    true effect has parameters. Correlated samples count by their effective number, which is at
    most two per second and Hz of the fit's cut-off frequency.
    """
    began = time.monotonic()
    _check_options(fit, level, starts, evaluations, rate)
    progress("compile", 0.0)
    arm, robot = FittedArm.of(fit), fit.model.robot
    if limits is None:
        limits = default_limits(robot, margin=margin)
    feasible = feasible_motions(
        robot, arm, motion_range(robot, acceleration, margin=margin), limits,
        duration=duration, harmonics=harmonics, samples=samples, start_pose=start_pose,
    )  # fmt: skip
    groups = groups_of(effects, sizes or {})
    rate_of_samples = independent_rate(fit, recordings)
    rivals = [
        RivalEffects(
            fit, group, sizes or {}, independent_rate=rate_of_samples,
            duration=duration, velocity=feasible.range.velocity,
        )
        for group in groups
    ]  # fmt: skip
    random = np.random.default_rng([seed, 20])
    drawn = [feasible.drawn(random) for _ in range(starts)]
    first = [feasible.motion(z) for z in drawn[:TRIED]]
    separable = []
    for group in rivals:
        group.assign_sizes(first)
        tried = [group.columns_along(motion) for motion in first]
        separable.append(separable_pairs(group, tried))
    criterion = _WorstPair.of(rivals, feasible, separable, level)
    values = []
    for k, z in enumerate(drawn):
        progress("random motions", 0.3 * k / starts)
        values.append(criterion(z))
    refined = _refined(
        criterion, feasible, [drawn[k] for k in best_starts(values, REFINED)],
        evaluations=max((evaluations - starts) // REFINED, 1), random=random, progress=progress,
    )  # fmt: skip
    best, violation = feasible.verified(max(refined, key=lambda motion: motion.value).z)
    pairs: list[RivalPair] = []
    for group, apart in zip(rivals, separable, strict=True):
        group.refine_grids()
        stacked = group.columns_along(feasible.motion(best))
        pairs += rival_pairs(group, stacked, apart, level=level, samples=feasible.samples)
    worst = max(p.needed / p.noncentrality for p in pairs if p.separable)
    median = float(np.median(values))
    trajectory = feasible.parametrization.trajectory(best)
    times = np.append(np.arange(0.0, duration, 1.0 / rate), duration)
    verified = verify(robot, trajectory.at(times), feasible.range, feasible.limits, arm)
    return Discrimination(
        model=rivals[0].common, trajectory=trajectory,
        periods=int(np.ceil(worst)), level=level,
        sizes={
            r.label: [*r.coefficients.tolist(), *r.shapes.tolist()]
            for group in rivals for r in group.effects
        },
        pairs=tuple(pairs), random_seconds=duration / median if median > 0.0 else float("inf"),
        max_violation=violation, evaluations=len(values) + sum(r.evaluations for r in refined),
        solve_seconds=time.monotonic() - began, rate=rate, interrupted=refined[-1].interrupted,
        checked=verified.checked, unchecked=verified.unchecked,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _WorstPair:
    """The criterion: the smallest ratio, over the pairs, of noncentrality to the one needed.

    Its inverse is the number of periods after which the test separates all pairs.
    """

    feasible: FeasibleMotions
    needed: Sequence[tuple[RivalEffects, Mapping[tuple[int, int], float]]]

    @classmethod
    def of(
        cls,
        rivals: Sequence[RivalEffects],
        feasible: FeasibleMotions,
        separable: Sequence[Sequence[tuple[int, int]]],
        level: float,
    ) -> _WorstPair:
        needed = []
        for group, pairs in zip(rivals, separable, strict=True):
            parameters = [effect.parameters for effect in group.effects]
            chi2 = {pair: noncentrality_needed(parameters[pair[0]], level) for pair in pairs}
            needed.append((group, chi2))
        return cls(feasible, needed)

    def __call__(self, z: Array) -> float:
        motion, ratios = self.feasible.motion(z), []
        for group, needed in self.needed:
            stacked = group.columns_along(motion)
            ratios += [noncentrality(group, stacked, *pair) / x for pair, x in needed.items()]
        return min(ratios)


def _refined(
    criterion: Callable[[Array], float],
    feasible: FeasibleMotions,
    starts: Sequence[Array],
    *,
    evaluations: int,
    random: np.random.Generator,
    progress: Callable[[str, float], None],
) -> list[SearchedMotion]:
    """Return the starts (m,) improved by random steps, with so many evaluations for each."""
    refined: list[SearchedMotion] = []
    for k, start in enumerate(starts):
        progress(f"refine {k + 1} of {len(starts)}", 0.3 + 0.7 * k / len(starts))
        refined.append(
            random_search(criterion, feasible, start, evaluations=evaluations, random=random)
        )
        if refined[-1].interrupted:
            break
    return refined


def _check_options(fit: Fit, level: float, starts: int, evaluations: int, rate: float) -> None:
    """Raise an error if options are out of their range, or if the fit has no noise."""
    if not 0.5 <= level < 1.0:
        raise ExcitationError(f"level: {level:g}; expected 0.5 to 1")
    if starts < TRIED or evaluations < 1 or not rate > 0.0:
        raise ExcitationError(
            f"starts {starts}, evaluations {evaluations}, rate {rate:g}; expected at least "
            f"{TRIED}, at least 1, and a positive number"
        )
    silent = [f"joint {j + 1}" for j, noise in enumerate(fit.noise) if not noise > 0.0]
    if silent:
        raise ModelError(
            f"the fit has no noise on {', '.join(silent)}; expected a fit to measured recordings"
        )
