"""Identification with unknown drive stiffness: one of each joint; made absolute by known masses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import ConvergenceWarning, IdentificationError, RelativeTorqueWarning
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.identify import identify
from lieid_casadi.model import Model
from lieid_casadi.recording import Recording
from lieid_casadi.robot import Robot

GRAVITY_PARAMETERS = 4  # m, m·cx, m·cy, m·cz: the first of a link's ten parameters
ROUNDS = 6  # of fits with gains, which converge where these are below 1
MOST_GAIN = 0.9  # of a torque that a first fit may state as too large
WEAK = 0.1  # relative standard deviation, from which a stiffness is not determined
SETTLED = 1e-3  # relative change of a stiffness
SMALL = 1e-9  # kg·m: smaller known parameters do not determine a scale


def identify_each_stiffness(model: Model, recordings: Sequence[Recording], **options: Any) -> Fit:
    """Fit a model whose drives have unknown stiffnesses, relative to that of joint 1.

    With one stiffness for all, that of joint j is a gain of its torque, 1 + g = K_1/K_j, which the
    mass that several joints carry determines. The gains become stiffnesses of the laws until they
    are zero; the last fit is that of the model alone. A stiffness that the recordings do not
    determine is that of joint 1: the laws follow no gain that is uncertain.
    """
    robot, n = model.robot, model.n
    if not robot.drives or not all(drive.relative for drive in robot.drives) or n < 2:
        raise IdentificationError(
            "stiffnesses of single joints need two joints and drives without stiffness "
            "(--stiffness each)"
        )
    ratios, std, known = np.ones(n), np.zeros(n), np.zeros(n, dtype=bool)
    for _ in range(ROUNDS):
        stated, given = _stated(model, recordings, ratios)
        gained = stated.with_effect("torque_gain", joints=range(1, n))
        fit = identify(gained, given, **options | {"method": "wls"})
        rows = [row for row in fit.parameter_table() if row["name"] == "torque_gain.g"]
        factor = 1.0 + np.array([max(row["value"], -MOST_GAIN) for row in rows])
        spread = np.array([np.inf if row["std"] is None else row["std"] for row in rows]) / factor
        settled = not any(isinstance(w, ConvergenceWarning) for w in fit.warnings)
        known[1:] |= spread < WEAK
        ratios[1:] = np.where(known[1:], ratios[1:] / factor, 1.0)
        std[1:] = ratios[1:] * spread
        if settled and np.all(np.abs(factor[known[1:]] - 1.0) < SETTLED):
            break
    if not settled:
        known[:], ratios[:] = False, 1.0
    final = identify(*_stated(model, recordings, ratios), **options)
    found = [f"joint {j + 1} {ratios[j]:.3g} ± {std[j]:.2g}" for j in np.flatnonzero(known)]
    if not known[1:].all():
        others = ", ".join(f"joint {j + 1}" for j in range(1, n) if not known[j])
        found.append(f"not determined, and taken as that of joint 1: {others}")
    note = RelativeTorqueWarning(f"drive stiffness relative to that of joint 1: {'; '.join(found)}")
    return replace(final, warnings=(*final.warnings, note))


def _stated(
    model: Model, recordings: Sequence[Recording], stiffness: Array, *, relative: bool = True
) -> tuple[Model, list[Recording]]:
    """Return model and recordings whose laws have the unknown stiffnesses times numbers (n,)."""
    pairs = zip(model.robot.drives or (), stiffness.tolist(), strict=True)
    laws = [replace(law.relative_to(k), relative=relative) for law, k in pairs]
    robot = model.robot.with_drives(laws)
    stated = Model.of_placements(robot, model.placements, library=model.library)
    return stated, [recording.with_drives(robot.drives or laws) for recording in recordings]


def identify_with_known_masses(
    model: Model, recordings: Sequence[Recording], masses: Mapping[str, float], **options: Any
) -> Fit:
    """Fit a model whose drives have an unknown common stiffness K, which known masses determine.

    The fit in units of K gives β/K; base parameters that consist of masses and first moments of
    links with stated centres of mass give β; K is their generalized least-squares ratio. The model
    is then fitted with K.
    """
    robot = model.robot
    if not robot.drives or not all(drive.relative for drive in robot.drives):
        raise IdentificationError(
            "known masses determine an unknown drive stiffness; expected drives without stiffness "
            "(--stiffness unknown)"
        )
    relative = identify(model, recordings, **options)
    stiffness, std, assumed = _stiffness(relative, masses)
    all_joints = np.full(robot.n, stiffness)
    fit = identify(*_stated(model, recordings, all_joints, relative=False), **options)
    note = RelativeTorqueWarning(
        f"the known masses give a drive stiffness of {stiffness:.4g} ± {std:.2g} N·m/rad "
        f"({100.0 * std / stiffness:.3g} %), one for all joints; all parameters share this error, "
        f"which their standard deviations do not contain{assumed}"
    )
    return replace(fit, warnings=(*fit.warnings, note))


def _stiffness(fit: Fit, masses: Mapping[str, float]) -> tuple[float, float, str]:
    """Return K, N·m/rad, its standard deviation, and what was assumed."""
    robot = fit.model.robot
    named = {_link(robot, name): mass for name, mass in masses.items()}
    values = np.full((robot.n, 10), np.nan)
    for j, joint in enumerate(robot.joints):
        if joint.link is not None:
            values[j] = joint.link
    for j, mass in named.items():
        if not np.isfinite(values[j]).all() or values[j, 0] <= 0.0:
            raise IdentificationError(
                f"known mass of {robot.joints[j].name}: robot {robot.name!r} states no centre of "
                "mass for this link; add its inertia to the description"
            )
        values[j] *= mass / values[j, 0]
    rows, assumed = _rows(fit, values, set(named))
    expected = fit.model.base.combination[rows][:, : 10 * robot.n] @ np.nan_to_num(values.ravel())
    weight = np.linalg.pinv(fit.covariance[np.ix_(rows, rows)], hermitian=True)
    information = float(expected @ weight @ expected)
    inverse = float(expected @ weight @ fit.values[rows]) / max(information, 1e-300)
    std = 1.0 / np.sqrt(max(information, 1e-300))
    if not inverse > 3.0 * std:
        raise IdentificationError(
            f"the known masses do not determine the drive stiffness: 1/K = {inverse:.3g} ± "
            f"{std:.2g} rad/(N·m); expected more motion of these links against gravity, or heavier "
            "links"
        )
    stiffness = 1.0 / inverse
    text = "" if not assumed else f"; the stated masses of {', '.join(assumed)} were assumed, too"
    return stiffness, std * stiffness**2, text


def _link(robot: Robot, name: str) -> int:
    """Return the number of a link (from 0) by its name, its joint's name, or ``linkN``."""
    for j, joint in enumerate(robot.joints):
        if name in (joint.link_name, joint.name, f"link{j + 1}"):
            return j
    names = ", ".join(joint.link_name or joint.name for joint in robot.joints)
    raise IdentificationError(f"known mass of {name!r}: no such link; expected one of {names}")


def _rows(fit: Fit, values: Array, named: set[int]) -> tuple[list[int], list[str]]:
    """Return base parameters that known masses determine, and the links assumed for them."""
    n = fit.model.n
    exact: list[int] = []
    wider: list[int] = []
    others: set[int] = set()
    for row, combination in enumerate(fit.model.base.combination):
        links = combination[: 10 * n].reshape(n, 10)
        if np.any(combination[10 * n :]) or np.any(links[:, GRAVITY_PARAMETERS:]):
            continue
        involved = set(np.flatnonzero(links.any(axis=1)).tolist())
        amount = np.sum(links[links != 0.0] * values[links != 0.0])
        if not involved & named or not np.isfinite(amount) or abs(amount) < SMALL:
            continue
        (exact if involved <= named else wider).append(row)
        others |= involved - named
    if exact:
        return exact, []
    if wider:
        return wider, [fit.model.robot.joints[j].name for j in sorted(others)]
    raise IdentificationError(
        "no base parameter consists of masses that are known: state the masses of further links "
        "(--known-mass LINK=KG …), those beyond the named ones first"
    )
