"""What there is to say about a payload: what was not told, what contradicts the fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

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
from lieid_casadi.payload.estimate import NOTHING, NotIdentified, PayloadEstimate, with_std
from lieid_casadi.payload.feasible_body import distance
from lieid_casadi.payload.regression import Estimate, LoadedRun
from lieid_casadi.recording import Recording
from lieid_casadi.robot.inertia import LINK_PARAMETER_NAMES

Array = NDArray[np.float64]
WEAK = 0.3  # standard deviation over size, above which a number says little
MASS = 0.05  # kg: a mass this well known is told however small it is
LENGTH = 0.02  # m: so is a place
ANOTHER_ARM = 0.2  # of the torque's variation: no payload leaves that much …
TIMES = 5.0  # … and that many times the fit's own error
IMPOSSIBLE = 6.0  # standard deviations in ten numbers: p = 1e-4
MISFIT = 2.0  # times the fit's own error: told
FALL = 0.1  # of the error by refitting friction, that is worth telling
CERTAIN = 4.0  # standard deviations


def rms(errors: Sequence[Array]) -> Array:
    """Return each joint's RMS (n,), NaN without rows."""
    return np.array([np.sqrt(np.mean(e**2)) if len(e) else np.nan for e in errors])


def without_a_number(values: Array, std: Array) -> NDArray[np.bool_]:
    """Mark quantities (10,) that are not worth a number: pure noise, places of no mass."""
    lost = ~(std <= _sizes(values))
    lost[1:] |= _no_mass(values, std)
    return lost


def _no_mass(values: Array, std: Array) -> bool:
    return not abs(values[0]) > NOTHING * std[0]


def _sizes(values: Array) -> Array:
    """Return what a standard deviation (10,) is held against."""
    moment = float(np.max(np.abs(values[[4, 6, 9]])))
    places = np.maximum(np.abs(values[1:4]), LENGTH / WEAK)
    return np.array([max(abs(values[0]), MASS / WEAK), *places, *(moment,) * 6])


def not_identified(
    values: Array, std: Array, seen: NDArray[np.bool_], hidden: Array
) -> tuple[NotIdentified, ...]:
    """Return the quantities that the motion could not tell, and why.

    Parameters
    ----------
    values, std : (10,)
        As `body.NAMES`.
    seen : (10,)
        What the torque shows at all.
    hidden : (h, 10)
        Directions of m, m·c, I that it does not show, in comparable units.
    """
    sizes, found = _sizes(values), []
    for k, name in enumerate(NAMES):
        if not seen[k]:
            reason = _hidden_reason(k, hidden)
        elif k > 0 and _no_mass(values, std):
            reason = f"the mass, {with_std(values[0], std[0])} kg, cannot be told from none"
        elif not std[k] <= WEAK * sizes[k]:
            reason = f"standard deviation {std[k]:.2g} {UNITS[k]}{_beside(k, values, std, sizes)}"
            reason += ": the motion is too slow or too small for it"
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
                f"the torque does not change along {name_direction(direction, LABELS)} "
                "(the arm's joints, or this motion, do not show it)"
            )
    return "a mass of exactly zero has no place"


LABELS = tuple(name.replace("mc", "m·c") for name in LINK_PARAMETER_NAMES)


def of_the_fit(fit: Fit, recordings: Sequence[Recording]) -> list[LieidWarning]:
    """Tell what the fit itself lacks for this question."""
    # parts of one file (FILE@T0:T1) have its hash and names of their own
    trained = {(source.sha256, source.name) for source in fit.provenance.recordings}
    found: list[LieidWarning] = [
        SameRecordingWarning(
            f"{r.name or 'the recording'} is one that the fit was made from: what it carries is "
            "part of the fit already"
        )
        for r in recordings
        if r.source_hash and (r.source_hash, r.name) in trained
    ]
    found += [
        UnidentifiableWarning(
            f"the fit's own training: {w}; if the loaded run shows it, the payload takes it on"
        )
        for w in fit.warnings
        if isinstance(w, UnidentifiableWarning)
    ]
    return found


def require_same_arm(fit: Fit, estimate: Estimate, run: LoadedRun) -> None:
    """Raise where so much remains that no payload can be the reason.

    Raises
    ------
    IdentificationError
    """
    rows = run.design.rows(fit.shapes, fit.parameters)
    left, own = estimate.noise, _own_error(fit)
    spread = np.array([np.std(j.torque) if len(j.torque) else np.inf for j in rows.joints])
    part = left / np.where(spread > 0.0, spread, np.inf)
    bad = (part > ANOTHER_ARM) & (left > TIMES * own)
    # a small joint may be at odds by its friction alone: ask where the load is
    heaviest = int(np.argmax(np.where(np.isfinite(spread), spread, 0.0)))
    if not bad[heaviest] and bad.sum() <= len(bad) // 2:
        return
    j = int(np.argmax(np.where(bad, part, 0.0)))
    name = run.design.segments[0].recording.name or "the recording"
    raise IdentificationError(
        f"{name}: no payload explains this run: on joint {j + 1} an error of {left[j]:.3g} N·m "
        f"remains of a torque that varies by {spread[j]:.3g} (the fit's own error is "
        f"{own[j]:.2g}); expected a run of the arm {fit.model.robot.name!r}, torques in N·m "
        "or currents with --torque-constants"
    )


def changed_friction(
    run: LoadedRun, kept: Estimate, refitted: Estimate, frictional: NDArray[np.bool_]
) -> list[LieidWarning]:
    """Tell friction that is no longer the fit's, and what the mass would be."""
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
            f"friction is not the fit's any more ({', '.join(parts[:6])}"
            f"{', …' if len(parts) > 6 else ''}); with friction refitted (--refit-friction) the "
            f"mass is {with_std(float(refitted.parameters[0]), std)} kg"
        )
    ]


def of_the_payload(fit: Fit, result: PayloadEstimate, estimate: Estimate) -> list[LieidWarning]:
    """Tell a negative mass, an error that is left, an iteration that did not settle."""
    found: list[LieidWarning] = []
    if result.mass < 0.0:
        size = "significantly" if result.mass < -NOTHING * result.mass_std else "within its noise"
        found.append(
            NegativeMassWarning(
                f"mass {with_std(result.mass, result.mass_std)} kg is negative, {size}; the "
                f"nearest body that can exist has {result.feasible.mass:.3g} kg"
            )
        )
    away = distance(
        result.feasible.parameters, estimate.parameters, estimate.covariance, estimate.hidden
    )
    if away > IMPOSSIBLE and not result.mass < 0.0:
        found.append(
            ImpossiblePayloadWarning(
                f"no body can have these numbers: the nearest possible one is {away:.0f} standard "
                "deviations away; either something else has changed too, or this is another arm"
            )
        )
    own = _own_error(fit)
    for j, left in enumerate(estimate.noise):
        if np.isfinite(result.rms_after[j]) and left > MISFIT * own[j]:
            found.append(
                PayloadMisfitWarning(
                    f"joint {j + 1}: with the payload, and the fit's numbers moved within their "
                    f"uncertainty, an error of {left:.3g} N·m remains, {left / own[j]:.1f} times "
                    "the fit's own; the payload's numbers are worth less than their standard "
                    "deviations say (lieid diagnose FIT REC tells what else has changed)"
                )
            )
    if not estimate.settled:
        found.append(ConvergenceWarning("the load had not settled with the payload"))
    return found


def _own_error(fit: Fit) -> Array:
    return np.maximum(np.where(np.isfinite(fit.rms_cv), fit.rms_cv, fit.noise), 1e-9)
