"""Checks of the input of drive gain identification."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from lieid_casadi.arrays import Array
from lieid_casadi.errors import EffectError, IdentificationError, ModelError
from lieid_casadi.gains.regression import BODY
from lieid_casadi.model import Model
from lieid_casadi.recording import Recording

LARGEST_MASS, LARGEST_DISTANCE = 1e5, 100.0  # kg, m: larger payloads are errors of unit


def known_payload(mass: float, com: ArrayLike | None) -> Array:
    """Return the payload's parameters (10,), NaN where unknown.

    Raises `IdentificationError`: the mass or the centre of mass is not plausible.
    """
    if not 0.0 < mass <= LARGEST_MASS:
        raise IdentificationError(
            f"mass of the payload is {mass:g} kg, expected more than 0 and at most "
            f"{LARGEST_MASS:g} kg"
        )
    known = np.full(BODY, np.nan)
    known[0] = mass
    if com is not None:
        centre = np.asarray(com, dtype=float)
        if centre.shape != (3,) or not np.all(np.abs(centre) <= LARGEST_DISTANCE):
            raise IdentificationError(
                f"com is {com}, expected three numbers of at most {LARGEST_DISTANCE:g} m"
            )
        known[1:4] = mass * centre
    return known


def with_drive_signal(
    empty: Sequence[Recording], full: Sequence[Recording]
) -> tuple[list[Recording], list[Recording], str]:
    """Return the recordings with the signal of the drives as currents, and its unit.

    It is the position error q_cmd − q, in rad, if no recording has currents and all have commands.

    ``empty``, ``full``: recordings without and with the payload.
    """
    every = (*empty, *full)
    if not every or any(r.current is not None or r.command is None for r in every):
        return list(empty), list(full), "A"
    moved = [replace(r, current=r.command - r.q) for r in every if r.command is not None]
    return moved[: len(empty)], moved[len(empty) :], "rad"


def check_input(model: Model, empty: Sequence[Recording], full: Sequence[Recording]) -> None:
    """Raise if effects or recordings are not suitable.

    ``empty``, ``full``: recordings without and with the payload.
    Raises `EffectError`: an effect has shape parameters. Raises `IdentificationError`: a recording
    is missing, constant, or given as both. Raises `ModelError`: a recording has another number of
    joints or no currents.
    """
    if model.shapes:
        raise EffectError(
            f"{model.shapes[0].label}: effects with shape parameters cannot be fitted with drive "
            "gains; expected linear ones such as coulomb, viscous, offset, load_friction"
        )
    for part, recordings in (("unloaded", empty), ("loaded", full)):
        if not recordings:
            raise IdentificationError(f"no {part} recording given; expected at least one")
    for recording in (*empty, *full):
        name = recording.name or "recording"
        if recording.n != model.n:
            raise ModelError(
                f"{name}: {recording.n} joints; robot {model.robot.name!r} has {model.n}"
            )
        if recording.current is None:
            raise ModelError(
                f"{name}: no motor currents; expected columns i1…i{model.n}, or in all recordings "
                f"commanded positions qcmd1…qcmd{model.n}"
            )
        still = np.flatnonzero(np.ptp(recording.current, axis=0) == 0.0)
        if len(still):
            raise IdentificationError(
                f"{name}: the current i{still[0] + 1} is the same in every row "
                f"({recording.current[0, still[0]]:g} A); expected the measured motor current"
            )
    for one in empty:
        for other in full:
            if _overlap(one, other):
                raise IdentificationError(
                    f"{other.name or 'recording'}: given as unloaded and as loaded; expected "
                    "different recordings"
                )


def _overlap(one: Recording, other: Recording) -> bool:
    """Return whether two recordings share rows of one file."""
    same = bool(one.source_hash) and one.source_hash == other.source_hash
    return bool(same and one.t[0] <= other.t[-1] and other.t[0] <= one.t[-1])
