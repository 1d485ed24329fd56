"""Warnings of a fit about its own parameters and recordings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.effects.torque_saturation import TorqueSaturation
from lieid_casadi.errors import (
    AliasWarning,
    BoundWarning,
    ConvergenceWarning,
    DriveLimitWarning,
    FrictionAtRestWarning,
    HeldJointWarning,
    LieidWarning,
    NotDissipativeWarning,
    RelativeTorqueWarning,
    RoughFitWarning,
    StatedMassWarning,
    UnidentifiableWarning,
)
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.prediction import relative_temperature, torque_along
from lieid_casadi.identification.regression.design_matrix import Design, has_dry_friction
from lieid_casadi.identification.regression.fixed_point import ROUNDS, FitState
from lieid_casadi.identification.regression.least_squares import (
    WEAK,
    Factor,
    LeastSquaresSolution,
    Rows,
    independent_fraction,
)
from lieid_casadi.identification.regression.resolved_shapes import resolved_range
from lieid_casadi.messages import in_unit
from lieid_casadi.model import Model
from lieid_casadi.recording import Processed, Recording, process
from lieid_casadi.robot import Robot

#: About the numbers of one fit: those of a later one take their place.
OF_NUMBERS = (
    AliasWarning,
    BoundWarning,
    ConvergenceWarning,
    DriveLimitWarning,
    FrictionAtRestWarning,
    NotDissipativeWarning,
    RoughFitWarning,
    StatedMassWarning,
    UnidentifiableWarning,
)
SHARE_AT_REST = 0.01  # of the samples, above which rest is reported
LIMITED = np.arange(0.5, 1.0, 0.05)  # quantiles of position errors, from which a limit may act
OF_LIMIT = 0.5  # of a joint's error, below which a limit of its drive must lower it to be stated
#: Error of held-out data relative to that of the fit, above which the fit is rough: so it is with
#: one parameter to four independent samples.
ROUGH = 1.3
EXACT = 1e-4  # error relative to the torque, below which a fit needs no warning
ROWS_FOR_LIMIT = 5  # for each column of a joint
EXCESS = 3.0  # times dry friction and the error in motion, above which something holds a joint
LEAST_TIME = 0.5  # s in all, a shorter rest is a reversal


def of_regression(
    model: Model,
    segments: Sequence[Processed],
    state: FitState,
    unweighted: Factor,
    *,
    settled: bool,
) -> list[LieidWarning]:
    """Return the warnings of a regression: aliases, unexcited directions, rest, convergence."""
    found = aliases(model, independent_fraction(unweighted))
    found += unexcited(model, state.solution) + at_rest(model, segments)
    if not settled:
        found.append(
            ConvergenceWarning(
                f"load and shape parameters had not converged after {ROUNDS} iterations; "
                "remove an effect with shape parameters, or record more data"
            )
        )
    return found


def aliases(model: Model, independent: Array) -> list[LieidWarning]:
    """Return warnings about effects that other columns absorb exactly, or nearly on this data."""
    found: list[LieidWarning] = []
    base, first = model.base, 10 * model.n
    for k in base.dropped[base.dropped >= first]:
        users = [base.names[base.kept[i]] for i in np.flatnonzero(base.combination[:, k])]
        reason = (
            f"absorbed by {', '.join(users)}: no recording can separate them"
            if users
            else "without effect on any torque of this robot"
        )
        found.append(AliasWarning(f"{base.names[k]} is {reason}"))
    for position, k in enumerate(base.kept):
        if k >= first and 0.0 < independent[position] < WEAK:
            found.append(
                AliasWarning(
                    f"{base.names[k]} is weak: the other columns explain all but "
                    f"{100.0 * independent[position]:.1f} % of its column on this recording"
                )
            )
    return found


def bounds(design: Design, least: FitState, state: FitState) -> list[LieidWarning]:
    """Return warnings about coefficients beyond their bounds and shapes at the end of a range.

    ``least`` has the least-squares values, ``state`` those of the fit, which a bound may limit.
    """
    found: list[LieidWarning] = []
    model = design.model
    values = least.solution.values, state.solution.values
    for parameter, free, value in zip(model.base_columns, *values, strict=True):
        if not parameter.lower <= free <= parameter.upper:
            what = "is outside its physical bounds"
            if value != free:
                what = f"is limited by its bound; least squares gives {free:.3g}, outside of"
            found.append(
                BoundWarning(
                    f"{parameter.label} = {in_unit(f'{value:.3g}', parameter.unit)} {what} "
                    f"[{parameter.lower:g}, {parameter.upper:g}]: another effect is "
                    "missing from the model, or this effect is not present"
                )
            )
    if len(state.shapes):
        ranges = resolved_range(design)
        for k in np.flatnonzero(ranges.at_bound(state.shapes)):
            shape = model.shapes[k]
            if not shape.fitted:
                continue
            size = in_unit(f"{state.shapes[k]:.3g}", shape.unit)
            found.append(
                BoundWarning(
                    f"{shape.label} reached its bound {size} "
                    f"(range {ranges.lower[k]:.4g} to {ranges.upper[k]:.4g}); the effect is "
                    "probably not present on this joint, or the recordings do not show it"
                )
            )
    return found


def unexcited(model: Model, solution: LeastSquaresSolution) -> list[LieidWarning]:
    """Return a warning about directions of the parameters that the recordings do not excite."""
    if not solution.unexcited:
        return []
    count, spanned = len(solution.unexcited), np.linalg.qr(np.transpose(solution.unexcited))[0]
    part = np.sum(spanned**2, axis=1)  # of each parameter that they contain
    names = ", ".join(p.label for p, own in zip(model.base_columns, part, strict=True) if own > 0.5)
    text = f"not excited by this recording: {count} combination{'s' * (count > 1)} of {names}"
    return [UnidentifiableWarning(f"{text}; zero was used")]


def at_rest(model: Model, segments: Sequence[Processed]) -> list[LieidWarning]:
    """Return a warning that names the joints with dry friction that rested."""
    moving = np.concatenate([segment.filtered_moving for segment in segments])
    share = 1.0 - moving.mean(axis=0)
    resting = has_dry_friction(model) & (share > SHARE_AT_REST)
    if not resting.any():
        return []
    joints = ", ".join(f"joint {j + 1} ({100 * share[j]:.0f} %)" for j in np.flatnonzero(resting))
    return [
        FrictionAtRestWarning(
            "friction is undetermined at rest; samples at rest were excluded from the fit: "
            + joints
        )
    ]


def rough(rms_train: Array, rms_cv: Array, rows: Rows) -> list[LieidWarning]:
    """Return a warning where held-out data are predicted much worse than those of the fit."""
    sizes = [np.linalg.norm(own.torque) / np.sqrt(max(len(own.torque), 1)) for own in rows.joints]
    inexact = (rms_train > EXACT * np.array(sizes)) & (rms_cv > 0.0)
    ratios = rms_cv[inexact] / rms_train[inexact]
    ratio = float(np.exp(np.mean(np.log(ratios)))) if len(ratios) else 1.0
    if ratio < ROUGH:
        return []
    return [
        RoughFitWarning(
            f"the error of held-out data is {ratio:.1f} times that of the fit: the recordings "
            "determine its parameters roughly; record longer or more motion (lieid excite)"
        )
    ]


def limits_of_drives(design: Design, rows: Rows) -> list[LieidWarning]:
    """Return a warning that names joints whose error is that of a drive with less torque.

    Of a joint's regression alone, at least half of the error is explained by what its law states
    beyond a position error that at least half of the rows do not exceed.
    """
    if any(s.recording.drives is None for s in design.segments):
        return []
    have = {p.joint for p in design.model.placements if isinstance(p.effect, TorqueSaturation)}
    errors = [s.command_error for s in design.segments]
    found: dict[int, float] = {}
    for j, own in enumerate(rows.joints):
        if j in have or len(own.torque) < ROWS_FOR_LIMIT * own.matrix.shape[1]:
            continue
        error = [e[:, j : j + 1] for e in errors if e is not None]

        def filtered(values: Sequence[Array], joint: int = j) -> Array:
            pairs = zip(design.segments, values, strict=True)
            return design.on_joint(joint, [s.filter(x) for s, x in pairs])

        ends = np.quantile(np.abs(filtered(error)), LIMITED)
        beyond = filtered([np.sign(e) * np.maximum(np.abs(e) - ends, 0.0) for e in error])
        both = np.column_stack([own.torque, beyond])
        rest = both - own.matrix @ np.linalg.lstsq(own.matrix, both, rcond=None)[0]
        along, sizes = rest[:, 1:].T @ rest[:, 0], np.sum(rest[:, 1:] ** 2, axis=0)
        part = np.where(along > 0.0, along**2 / np.maximum(sizes, 1e-300), 0.0)
        left = 1.0 - part / max(float(rest[:, 0] @ rest[:, 0]), 1e-300)
        if np.sqrt(max(float(left.min()), 0.0)) < OF_LIMIT:
            found[j] = float(ends[np.argmin(left)])
    if not found:
        return []
    joints = "+".join(f"{j + 1}" for j in found)
    where = ", ".join(f"joint {j + 1} ({end:.2g} rad)" for j, end in found.items())
    return [
        DriveLimitWarning(
            "at large position errors the drives seem to deliver less torque than their laws "
            f"state, which explains most of the error: {where}. The parameters and the motion of "
            f"this fit are wrong if so; identify with the effect torque_saturation:{joints} "
            "(--effects), or lieid diagnose, which compares it with others"
        )
    ]


def relative_torque(robot: Robot, recordings: Sequence[Recording]) -> list[LieidWarning]:
    """Return a warning where torques are in units of a drive stiffness that is not known."""
    drives = robot.drives or ()
    commanded = any(r.command is not None for r in recordings)
    if not commanded or not any(drive.relative for drive in drives):
        return []
    return [
        RelativeTorqueWarning(
            "the drive stiffness K is not known: torques, noise and all parameters are in units "
            "of K (where N·m is written read rad·K), one K for all joints; --known-mass LINK=KG "
            "or lieid gains determine K in N·m/rad"
        )
    ]


def held_joints(fit: Fit, recordings: Sequence[Recording]) -> list[HeldJointWarning]:
    """Return a warning for each joint that something outside the arm holds: an object, a stop."""
    robot = fit.model.robot
    if robot.drives is None or any(r.command is None or r.tau is None for r in recordings):
        return []
    dry = np.zeros(robot.n)
    for column, value in zip(fit.model.columns, fit.effect_coefficients, strict=True):
        if column.name == "coulomb.f_c":
            dry[column.joint] = max(value, 0.0)
    limit = EXCESS * (dry + fit.rms_cv)
    time, peak = np.zeros(robot.n), np.zeros(robot.n)
    for raw in process(list(recordings), fit.processing):
        segment = relative_temperature(raw, fit.temperature_mean)
        torque = torque_along(fit.compiled, segment, fit.parameters, fit.shapes)
        assert segment.tau is not None  # that of the recording
        excess = np.where(segment.moving, 0.0, np.abs(segment.tau - torque))
        time += (excess > limit).sum(axis=0) / segment.rate
        peak = np.maximum(peak, excess.max(axis=0))
    return [
        HeldJointWarning(
            f"joint {j + 1} rests for {time[j]:.2g} s although its drive's law states up to "
            f"{peak[j]:.2g} N·m more than gravity needs (dry friction: {dry[j]:.2g} N·m): an "
            "object or a stop holds it, or the drive delivers less than its law states. Commands "
            "and positions do not distinguish these, and do not determine the torque of a contact; "
            "record this joint in free motion"
        )
        for j in np.flatnonzero(time > LEAST_TIME)
    ]
