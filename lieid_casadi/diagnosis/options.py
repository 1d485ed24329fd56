"""Thresholds of the diagnosis: what each one means and where it comes from.

Every comment ends with the source. *Statistics*: a convention or the cited theory. *Resolution*:
what sampling, filtering or rounding permits. *Simulations*: set while the benchmark of hidden
effects (``tests/hidden_effects``) was developed, so that nothing is named where nothing is hidden
and effects as large as the noise are; ``tests/benchmarks/diagnosis_thresholds.py`` tabulates how
the answers depend on ten of them.
*Cost*: a larger number takes longer.
"""

from __future__ import annotations

from dataclasses import dataclass

#: Part of a unit column outside the model's span below which it is numerically dependent. Above
#: the rounding error of double precision, below any part that noise lets one estimate.
ABSORBED = 1e-6
#: Diagonal of a pivoted QR factor, relative to its largest, below which a column is dependent.
RANK_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Penalty:
    """What an effect must gain to be selected.

    Attributes
    ----------
    per_parameter : float
        Fall of the whitened sum of squares for each parameter that it adds.
    part : float
        Least fall, as a part of the number of rows of its joint.
    """

    per_parameter: float
    part: float


@dataclass(frozen=True)
class DiagnosisOptions:
    """Options of :func:`lieid_casadi.diagnose`; the comments state meaning and source."""

    # --- Grids of shape parameters -------------------------------------------------------------
    #: Values of one shape parameter; its square root for each of two. Grids are refined
    #: around the best values. Cost.
    shape_grid_size: int = 25
    #: Time constants searched, relative to the longest segment. A shorter one is over before the
    #: first reversal, a longer one is a straight line in time. Simulations.
    time_constant_range: tuple[float, float] = (0.05, 2.0)
    #: Least velocity scale in multiples of the joint's dead zone, where the sign of the velocity
    #: is uncertain. Resolution.
    least_velocity_scale: float = 3.0
    #: Largest velocity scale relative to the joint's top speed: beyond it the column is close to a
    #: polynomial of the velocity. Simulations.
    largest_velocity_scale: float = 0.35
    #: Positions between two grid points at which points are added by a refinement. Cost.
    refinement_positions: tuple[float, ...] = (1 / 3, 2 / 3)
    #: Rounds of refinement. Cost.
    refinement_rounds: int = 2
    #: Candidates with at least this part of the best gain have their grids refined. Cost.
    refined_gain: float = 0.25
    #: Relative change of a coefficient above which a column that depends on it is evaluated
    #: again. Cost.
    coefficient_tolerance: float = 0.01
    #: Peaks of a scan (periodogram) that become grid points of a joint. Cost.
    scan_peaks: int = 8
    #: Percentile of the speeds at which the highest harmonic scanned must pass the low-pass filter.
    #: Resolution.
    scan_speed_percentile: float = 25.0
    #: Step of a scan: phase over the range of motion, in turns; half a turn would miss peaks.
    #: Resolution.
    scan_phase_step: float = 0.35

    # --- Events: stretches that are left out ------------------------------------------------------
    #: Range of positions (rad, a tenth of it in m) that a joint must cover for effects on it to be
    #: candidates: less than that is compliance of a held joint. Resolution.
    least_motion: float = 0.05
    #: Robust standard deviations of a joint's error, beyond friction at rest, from which an error
    #: may be transient. Simulations.
    least_event: float = 12.0
    #: The same for the ends of the stretch. Simulations.
    least_event_end: float = 4.0
    #: End of the stretch relative to its peak. Simulations.
    event_end_part: float = 0.1
    #: Ratio of the smallest transient error to the largest other error of a joint. Simulations.
    event_ratio: float = 2.0
    #: Time (s) between two events, and between two passes through the same state. Simulations.
    event_gap: float = 0.5
    #: Largest part of a segment that transient errors may take. Statistics: the scale is a median.
    most_event_time: float = 0.4
    #: Difference of velocity, acceleration and load, relative to their largest values, within
    #: which two states of a joint are the same. Simulations.
    event_state: float = 0.2
    #: Difference of position, relative to its range, within which two positions of a joint are the
    #: same. Resolution: it moves by less between two filtered samples.
    event_place: float = 0.02
    #: Passes through the same state at other times that are needed for comparison. Statistics.
    least_event_visits: int = 3
    #: Part of the error at the peak from which another error is similar. Simulations.
    similar_event: float = 0.3
    #: Part of these passes that may have a similar error: with more, it is a property of the arm.
    #: Simulations.
    most_similar_visits: float = 0.2

    # --- Screening -----------------------------------------------------------------------------
    #: Effective number of rows that make up a column, (Σc²)²/Σc⁴. With fewer a single disturbance
    #: decides the coefficient. Simulations.
    least_support: float = 5.0
    #: Part of a column outside the model's span that a point of a shape grid must have. With less,
    #: the gain of the grid point is noise. Simulations.
    least_own_part: float = 0.1

    # --- Evidence ------------------------------------------------------------------------------
    #: Family-wise p-value above which an effect is attributed to noise. Statistics: one false
    #: alarm in a thousand recordings, if the noise is as estimated.
    significance: float = 1e-3
    #: Block-bootstrap repetitions of the screening, for `selected`. Cost: the standard error is
    #: below 0.07.
    stability_draws: int = 50
    #: Least fraction of them in which an effect is selected again; with less, the candidates that
    #: are selected in its place are among its rivals. Statistics: a convention of stability
    #: selection (Meinshausen, Bühlmann, J. R. Statist. Soc. B 2010: 0.6 to 0.9).
    least_selected: float = 0.8
    #: Draws of white noise for the distribution of the family's largest statistic. Cost.
    bootstrap_draws: int = 200
    #: Length of blocks of time (s) whose residuals count as independent. Simulations.
    block_duration: float = 1.0
    #: Length of blocks (s) that go to the folds of the cross-validation in turn. Statistics.
    fold_duration: float = 2.0
    #: Folds of the cross-validation. Statistics.
    folds: int = 5

    # --- Held-out data ---------------------------------------------------------------------------
    #: Parts of one recording, or of the period of a periodic motion; each is held out once.
    #: Statistics: five is usual for cross-validation.
    held_out_parts: int = 5
    #: Approximate length of the contiguous blocks (s) that go to the parts in turn. Longer ones
    #: leave poses that the model has to extrapolate to, shorter ones are mostly gaps. Simulations.
    held_out_duration: float = 3.0
    #: Standard deviations of the noise that the gain expected on a held-out part must exceed for
    #: the part to judge an effect. Statistics: a right effect fails on such a part with a
    #: probability below 2.5 %.
    held_out_deviations: float = 2.0

    # --- Search for missing effects --------------------------------------------------------------
    #: Least relative fall of a joint's held-out error that is reported as a finding (`--worth`).
    #: Simulations.
    worth: float = 0.03
    #: The same for the mean square error of all joints, for effects that act on several joints.
    #: Simulations.
    worth_all_joints: float = 0.02
    #: Least lead of the torque and least delay of the command in samples of the slowest recording:
    #: velocity from differences is late by as much, and commands are held for as long. Resolution.
    least_delay_samples: float = 1.0
    #: Effects after which the search ends, which is reported. The worth ends it before. Cost.
    most_steps: int = 60
    #: Effects that are selected together at most. Cost.
    most_effects_at_once: int = 10
    #: Rounds of exchange among the selected effects. Cost.
    exchange_rounds: int = 3
    #: Penalty of effects in the generous selection that estimates the noise. Simulations.
    pilot_penalty: Penalty = Penalty(per_parameter=5.0, part=0.02)
    #: Penalty of smooth functions in that selection; their small gains may be due to the
    #: correlation of the noise. Simulations.
    pilot_smooth_penalty: Penalty = Penalty(per_parameter=5.0, part=0.3)

    # --- Search for changes ----------------------------------------------------------------------
    #: Error relative to the fit's largest error on other motion, above which something changed.
    #: Simulations.
    least_misfit: float = 1.15
    #: Least relative fall of a joint's error. Larger than for missing effects, since the model is
    #: not fitted again. Simulations.
    least_change_improvement: float = 0.1
    #: Changes after which the search ends, which is reported. Cost.
    most_changes: int = 30

    # --- Rivals ----------------------------------------------------------------------------------
    #: Rivals examined for each effect. Cost.
    most_rivals: int = 12
    #: Least gain of a rival, relative to the effect's own gain. Simulations.
    least_rival_gain: float = 0.5
    #: Part of a rival's gain that may remain in addition to the effect; with more it is a further
    #: cause. Simulations.
    most_rival_gain_in_addition: float = 0.3
    #: Least gain of a rival of the same family (two curves of friction over speed), relative to the
    #: effect's own gain. The true curve may be neither. Simulations.
    least_gain_of_same_form: float = 0.85
    #: Part of the effect's gain that each member of a pair of rivals must add. Simulations.
    least_part_of_pair: float = 0.1
    #: Candidates of which pairs of rivals are formed. Cost.
    paired_candidates: int = 8
    #: Pairs of rivals reported for each effect. Cost.
    most_rival_pairs: int = 3
    #: Standard deviations by which two fits must differ. Statistics: Vuong, Econometrica 1989,
    #: about 95 %.
    rival_deviations: float = 2.0

    # --- Checks of accepted effects ---------------------------------------------------------------
    #: A shape parameter below this part of the least value that the motion resolves is rejected.
    #: Resolution.
    least_shape: float = 0.5
    #: Relative distance from a lower bound at which a shape parameter counts as being at it.
    #: Resolution.
    shape_at_bound: float = 0.02
    #: Unexplained sum of squares of a joint relative to what its effects explain, above which the
    #: effects are compared with smooth functions. Simulations.
    doubtful_residual: float = 0.03
    #: Part of an effect's gain that must remain in addition to smooth functions of the signals
    #: that the residual depends on; with less the effect only partly explains the residual.
    #: Simulations.
    least_gain_with_smooth: float = 0.25
    #: Part of what these smooth functions explain that an effect must explain to be named although
    #: they could take its place: the error that it leaves is at most a third (√0.1) of the error
    #: that they explain. Simulations.
    least_part_of_smooth: float = 0.9

    # --- Unexplained residual ---------------------------------------------------------------------
    #: Family-wise p-value of smooth functions. Stricter than for effects: they are more flexible.
    #: Statistics.
    residual_significance: float = 1e-4
    #: Least part of a joint's held-out residual variance that is reported. Simulations.
    least_residual_part: float = 0.08
    #: The same for functions of time, which coloured noise resembles. Simulations.
    least_residual_part_of_time: float = 0.3
    #: Part of what the best function of time explains from which a function of other signals is
    #: reported in its place. Simulations.
    least_part_of_time: float = 0.8
    #: Part of the gain so far that a further smooth function must add. Simulations.
    least_further_part: float = 0.25
    #: Signals named at most for each joint, as the JSON format states.
    most_signals: int = 3

    #: Held-out error relative to the noise floor above which a model is not sufficient. The floor
    #: is a lower bound: complete models have up to 4.7 if noise is coloured. Simulations.
    largest_error_over_floor: float = 8.0
    #: Error relative to that expected of a fit above which something changed. Simulations.
    largest_error_over_expected: float = 3.0

    # --- Formula of the residual ------------------------------------------------------------------
    #: Part of what smooth functions explain that a formula must explain. Simulations.
    least_formula_part: float = 0.8
    #: Part that a further term must add. Simulations.
    least_term_part: float = 0.03
    #: Penalty of one unit of a term's cost, relative to the best gain: the simpler of two equals.
    #: Simulations.
    term_cost: float = 0.002
    #: Part of a term's column outside the model's span that is needed to estimate its coefficient.
    #: Simulations.
    least_term_own_part: float = 0.05
    #: Confidence of the bands of smooth functions. Statistics.
    confidence: float = 0.95
