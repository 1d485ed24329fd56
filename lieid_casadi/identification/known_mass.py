"""Identification with an unknown drive stiffness, made absolute by links of known mass."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import IdentificationError, RelativeTorqueWarning
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.identify import identify
from lieid_casadi.model import Model
from lieid_casadi.recording import Recording
from lieid_casadi.robot import Robot

GRAVITY_PARAMETERS = 4  # m, m·cx, m·cy, m·cz: the first of a link's ten parameters
SMALL = 1e-9  # kg·m: smaller known parameters do not determine a scale


def identify_with_known_masses(
    model: Model,
    recordings: Sequence[Recording],
    masses: Mapping[str, float],
    **options: Any,
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
    known = robot.with_drives([drive.scaled(stiffness) for drive in robot.drives])
    laws = known.drives
    assert laws is not None
    fit = identify(
        Model.of_placements(known, model.placements, library=model.library),
        [recording.with_drives(laws) for recording in recordings],
        **options,
    )
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
        if involved <= named:
            exact.append(row)
        else:
            wider.append(row)
            others |= involved - named
    if exact:
        return exact, []
    if wider:
        return wider, [fit.model.robot.joints[j].name for j in sorted(others)]
    raise IdentificationError(
        "no base parameter consists of masses that are known: state the masses of further links "
        "(--known-mass LINK=KG …), those beyond the named ones first"
    )
