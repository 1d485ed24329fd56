"""Warnings about a payload: quantities not identified, contradictions to the fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.errors import (
    ConvergenceWarning,
    FrictionChangedWarning,
    IdentificationError,
    ImpossiblePayloadWarning,
    LieidWarning,
    NegativeMassWarning,
    PayloadMisfitWarning,
    SameRecordingWarning,
    UnidentifiableWarning,
)
from lieid_casadi.identification import Fit
from lieid_casadi.identification.regression.least_squares import name_direction
from lieid_casadi.payload.body import DEPENDS_ON, NAMES, UNITS
from lieid_casadi.payload.estimate import INSIGNIFICANT, NotIdentified, PayloadEstimate, with_std
from lieid_casadi.payload.feasible_body import distance
from lieid_casadi.payload.regression import LoadedRun, LoadedRunEstimate
from lieid_casadi.recording import Recording
from lieid_casadi.robot.inertia import LINK_PARAMETER_NAMES

WEAK = 0.3  # relative standard deviation above which a quantity is reported as not identified
MASS = 0.05  # kg: a mass with this standard deviation is reported however small it is
LENGTH = 0.02  # m: the same for the centre of mass
ANOTHER_ARM = 0.2  # residual over the torque's standard deviation that no payload explains, …
TIMES = 5.0  # … if it is also that many times the fit's own error
IMPOSSIBLE = 6.0  # standard deviations in ten parameters: p = 1e-4
MISFIT = 2.0  # residual over the fit's own error that is reported
FALL = 0.1  # relative reduction of the error by refitting friction that is reported
CERTAIN = 4.0  # standard deviations of a change of friction that is reported


def rms(errors: Sequence[Array]) -> Array:
    """Return the RMS (n,) of each joint, NaN for a joint without rows."""
    return np.array([np.sqrt(np.mean(e**2)) if len(e) else np.nan for e in errors])


def too_uncertain(values: Array, std: Array) -> NDArray[np.bool_]:
    """Mark quantities (10,) whose uncertainty exceeds their size; without mass, all others too."""
    unknown = ~(std <= _sizes(values))
    unknown[1:] |= _no_mass(values, std)
    return unknown


def _no_mass(values: Array, std: Array) -> bool:
    return not abs(values[0]) > INSIGNIFICANT * std[0]


def _sizes(values: Array) -> Array:
    """Return the sizes (10,) that standard deviations are compared with."""
    moment = float(np.max(np.abs(values[[4, 6, 9]])))
    places = np.maximum(np.abs(values[1:4]), LENGTH / WEAK)
    return np.array([max(abs(values[0]), MASS / WEAK), *places, *(moment,) * 6])


def not_identified(
    values: Array, std: Array, identifiable: NDArray[np.bool_], hidden: Array
) -> tuple[NotIdentified, ...]:
    """Return the quantities that cannot be identified from the recording, with reasons.

    ``values``, ``std`` (10,): values and standard deviations in the order of `body.NAMES` (kg, m,
    kg·m²); ``identifiable`` (10,): quantities that do not involve a hidden direction; ``hidden``
    (h, 10): directions of m, m·c, I that cannot be identified, in comparable units.
    """
    sizes, found = _sizes(values), []
    for k, name in enumerate(NAMES):
        if not identifiable[k]:
            reason = _hidden_reason(k, hidden)
        elif k > 0 and _no_mass(values, std):
            reason = f"the mass, {with_std(values[0], std[0])} kg, is not significant"
        elif not std[k] <= WEAK * sizes[k]:
            reason = f"standard deviation {std[k]:.2g} {UNITS[k]}{_beside(k, values, std, sizes)}"
            reason += ": the motion is too slow or too small"
        else:
            continue
        found.append(NotIdentified(name, reason))
    return tuple(found)


def _beside(k: int, values: Array, std: Array, sizes: Array) -> str:
    if k == 0:
        return f", {100 * std[0] / abs(values[0]):.0f} % of the value"
    return f"; the largest moment of inertia is {sizes[k]:.2g}" if k > 3 else ""


def _hidden_reason(k: int, hidden: Array) -> str:
    for direction in hidden:
        if np.any(DEPENDS_ON[k] & (np.abs(direction) > 1e-6)):
            return (
                f"the torque does not depend on {name_direction(direction, LABELS)} "
                "(for this arm, or in this motion)"
            )
    return "a mass of exactly zero has no centre"


LABELS = tuple(name.replace("mc", "m·c") for name in LINK_PARAMETER_NAMES)


def fit_warnings(fit: Fit, recordings: Sequence[Recording]) -> list[LieidWarning]:
    """Warn of properties of the fit that make it unsuitable for a payload."""
    # parts of one file (FILE@T0:T1) have its hash and names of their own
    trained = {(source.sha256, source.name) for source in fit.provenance.recordings}
    found: list[LieidWarning] = [
        SameRecordingWarning(
            f"{r.name or 'the recording'} is one of the fit's training recordings: its payload is "
            "already part of the fit"
        )
        for r in recordings
        if r.source_hash and (r.source_hash, r.name) in trained
    ]
    found += [
        UnidentifiableWarning(
            f"training of the fit: {w}; if the loaded run excites it, the estimate of the payload "
            "includes its error"
        )
        for w in fit.warnings
        if isinstance(w, UnidentifiableWarning)
    ]
    return found


def require_same_arm(fit: Fit, estimate: LoadedRunEstimate, run: LoadedRun) -> None:
    """Raise if the residual is too large to be explained by a payload.

    ``fit``: without the payload.
    Raises `IdentificationError`.
    """
    rows = run.design.rows(fit.shapes, fit.parameters)
    residual, own = estimate.noise, _own_error(fit)
    spread = np.array([np.std(j.torque) if len(j.torque) else np.inf for j in rows.joints])
    part = residual / np.where(spread > 0.0, spread, np.inf)
    bad = (part > ANOTHER_ARM) & (residual > TIMES * own)
    # a small joint may differ by its friction alone: the joint with the largest torque decides
    heaviest = int(np.argmax(np.where(np.isfinite(spread), spread, 0.0)))
    if not bad[heaviest] and bad.sum() <= len(bad) // 2:
        return
    j = int(np.argmax(np.where(bad, part, 0.0)))
    name = run.design.segments[0].recording.name or "the recording"
    raise IdentificationError(
        f"{name}: no payload explains this run: the residual on joint {j + 1} is "
        f"{residual[j]:.3g} N·m, with a torque of standard deviation {spread[j]:.3g} N·m and a "
        f"held-out error of the fit of {own[j]:.2g} N·m; expected a run of the arm "
        f"{fit.model.robot.name!r}, torques in N·m or currents with "
        "--torque-constants"
    )


def changed_friction(
    run: LoadedRun,
    kept: LoadedRunEstimate,
    refitted: LoadedRunEstimate,
    frictional: NDArray[np.bool_],
) -> list[LieidWarning]:
    """Warn of friction that differs from the fit's, with the mass after refitting it.

    ``kept``, ``refitted``: estimates with the fit's friction and with friction refitted;
    ``frictional`` (p,): base columns of the friction that was refitted.
    """
    before, after = rms(kept.after), rms(refitted.after)
    fall = np.nan_to_num(1.0 - after / np.where(before > 0.0, before, np.inf))
    free = np.flatnonzero(frictional | run.drifting)
    columns = run.fit.model.base_columns
    certain = np.abs(refitted.free) > CERTAIN * refitted.free_std
    parts = [
        f"{columns[k].label} {run.fit.values[k]:.3g} → {run.fit.values[k] + change:.3g}"
        for k, change, sure in zip(free, refitted.free, certain, strict=True)
        if sure and frictional[k] and fall[columns[k].joint] > FALL
    ]
    if not parts:
        return []
    std = float(np.sqrt(refitted.covariance[0, 0]))
    return [
        FrictionChangedWarning(
            f"friction differs from that of the fit ({', '.join(parts[:6])}"
            f"{', …' if len(parts) > 6 else ''}); with refitted friction (--refit-friction) "
            f"the mass is {with_std(float(refitted.parameters[0]), std)} kg"
        )
    ]


def payload_warnings(
    fit: Fit, result: PayloadEstimate, estimate: LoadedRunEstimate
) -> list[LieidWarning]:
    """Warn of a negative mass, an infeasible body, a large residual, missing convergence.

    ``estimate``: the estimate that the result was made from.
    """
    found: list[LieidWarning] = []
    if result.mass < 0.0:
        significant = result.mass < -INSIGNIFICANT * result.mass_std
        found.append(
            NegativeMassWarning(
                f"mass {with_std(result.mass, result.mass_std)} kg is negative"
                f"{'' if significant else ', but not significantly'}; the nearest physically "
                f"consistent body has {result.feasible.mass:.3g} kg"
            )
        )
    away = distance(
        result.feasible.parameters, estimate.parameters, estimate.covariance, estimate.hidden
    )
    if away > IMPOSSIBLE and not result.mass < 0.0:
        found.append(
            ImpossiblePayloadWarning(
                f"these parameters are physically implausible: the nearest physically consistent "
                f"body is {away:.0f} standard deviations away; something else has changed as well, "
                "or the run is of another arm"
            )
        )
    own = _own_error(fit)
    for j, residual in enumerate(estimate.noise):
        if np.isfinite(result.rms_after[j]) and residual > MISFIT * own[j]:
            found.append(
                PayloadMisfitWarning(
                    f"joint {j + 1}: the residual with the payload is {residual:.3g} N·m, "
                    f"{residual / own[j]:.1f} times the fit's own error; the payload is less "
                    "accurate than its standard deviations state (lieid diagnose FIT REC finds "
                    "what else has changed)"
                )
            )
    if not estimate.converged:
        found.append(ConvergenceWarning("the iteration of load and payload did not converge"))
    return found


def _own_error(fit: Fit) -> Array:
    return np.maximum(np.where(np.isfinite(fit.rms_cv), fit.rms_cv, fit.noise), 1e-9)
