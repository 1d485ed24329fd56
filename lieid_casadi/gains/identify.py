"""Identify drive gains from currents with and without a payload of known mass."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieid_casadi.arrays import Array
from lieid_casadi.blas_threads import blas_on_one_thread
from lieid_casadi.compiled import compile
from lieid_casadi.effects import Effect
from lieid_casadi.errors import (
    ConvergenceWarning,
    IdentificationError,
    LieidWarning,
    unique_warnings,
)
from lieid_casadi.gains.estimate import DriveGains, GainNotIdentified
from lieid_casadi.gains.input_checks import check_input, known_payload, with_drive_signal
from lieid_casadi.gains.regression import GainProblem, GainSolution
from lieid_casadi.identification.prediction import center_temperature
from lieid_casadi.identification.recording_checks import Source
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.identification.regression.fixed_point import Progress
from lieid_casadi.model import Model
from lieid_casadi.payload.identify import require_one_load
from lieid_casadi.recording import Processing, Recording, check, process
from lieid_casadi.recording.recording import listed
from lieid_casadi.robot import Robot

WEAK = 0.1  # relative standard deviation above which a gain is reported as not identified
NO_PAYLOAD = 0.3  # the same of every gain: the payload has no visible effect
ANOTHER_ARM = 0.3  # residual over the torque's standard deviation, on more than half of the joints
ZERO = 1e-6  # part of a hidden direction that counts as zero


@blas_on_one_thread
def drive_gains(
    robot: Robot,
    unloaded: Recording | Sequence[Recording],
    loaded: Recording | Sequence[Recording],
    *,
    mass: float,
    com: ArrayLike | None = None,
    effects: str | Iterable[str | Effect] = "coulomb,viscous,offset",
    processing: Processing | None = None,
    progress: Progress | None = None,
) -> DriveGains:
    """Identify the gain of every drive in N·m/A (N·m/rad) from a payload of known mass.

    Gains, base parameters of the arm, friction and the unknown parameters of the payload are
    identified together by total least squares; the known mass determines the scale (Gautier,
    Briot, "Global identification of joint drive gains and dynamic parameters of robots", 2014).

    Parameters
    ----------
    robot : Robot
        Only its geometry is used; inertias are not needed.
    unloaded, loaded : Recording or sequence of Recording
        Recordings with motor currents, without and with the payload; the same exciting motions
        in both are best. Of recordings with commanded positions and no currents, the gains are the
        stiffnesses of the position controllers, N·m/rad.
    mass : float
        Mass of the payload, kg.
    com : (3,), optional
        Centre of mass of the payload in the tool frame, m; identified if not given.
    effects : str or sequence of str or Effect
        Friction effects of the joints, without shape parameters.
    processing : Processing, optional
        Filter options; by default the cut-off is chosen from the data.
    progress : callable, optional
        Called with the name of a stage and the completed fraction (0 to 1).

    Returns
    -------
    DriveGains

    Raises
    ------
    IdentificationError
        The mass is not positive; a recording is given as unloaded and as loaded; the payload has
        no visible effect; or the recordings are of another arm.
    ModelError, RecordingError, EffectError
        Currents are missing, the number of joints differs, or an effect has shape parameters.
    """
    empty, full, per = with_drive_signal(listed(unloaded), listed(loaded))
    known = known_payload(mass, com)
    model = Model(robot, effects)
    report = progress or (lambda stage, fraction: None)
    check_input(model, empty, full)
    report("check", 0.0)
    currents = [_in_amperes(r) for r in (*empty, *full)]
    found: list[LieidWarning] = [w for r in (*empty, *full) for w in check(r, robot)]
    report("process", 0.2)
    options = process(currents, processing)[0].options
    compiled = compile(model)
    before, after = (process(part, options) for part in _split(currents, len(empty)))
    require_one_load(before)
    require_one_load(after)
    segments, _ = center_temperature([*before, *after])
    found += [w for segment in segments for w in segment.warnings]
    report("regress", 0.4)
    split = len(before)
    designs = (Design(compiled, segments[:split]), Design(compiled, segments[split:]))
    solution = GainProblem(*designs, known).solve()
    _require_motion(solution)
    if not solution.converged:
        found.append(
            ConvergenceWarning(
                "gains and load did not converge; use effects without load_friction, or longer "
                "recordings"
            )
        )
    result = replace(_result(model, solution, mass, known, options, (empty, full)), per=per)
    report("done", 1.0)
    return replace(result, warnings=unique_warnings(found))


def _split(recordings: Sequence[Recording], count: int) -> tuple[list[Recording], list[Recording]]:
    return list(recordings[:count]), list(recordings[count:])


def _in_amperes(recording: Recording) -> Recording:
    """Return the recording with the current in A as its torque."""
    return recording.with_torque_constants(np.ones(recording.n))


def _require_motion(solution: GainSolution) -> None:
    if not any(len(e) for e in solution.residuals):
        raise IdentificationError("no joint moves; expected a motion that excites all joints")


def _result(
    model: Model,
    solution: GainSolution,
    mass: float,
    known: Array,
    options: Processing,
    recordings: tuple[Sequence[Recording], Sequence[Recording]],
) -> DriveGains:
    n = model.n
    gains = solution.gains
    std = np.sqrt(np.diag(solution.covariance)[:n])
    rms = np.array([np.sqrt(np.mean(e**2)) if len(e) else np.nan for e in solution.residuals])
    spread = np.abs(gains) * np.array([np.std(i) if len(i) else np.nan for i in solution.currents])
    relative = rms / np.where(spread > 0.0, spread, np.nan)
    moves = np.array([len(i) > 0 for i in solution.currents])
    identifiable = _identifiable(solution, n) & moves
    _require_load(gains, std, identifiable, mass)
    _require_arm(model, relative, recordings)
    com, com_std = _centre(model, solution, mass, known)
    return DriveGains(
        robot=model.robot,
        effects=tuple(model.effects),
        gains=np.where(identifiable, gains, np.nan),
        std=np.where(identifiable, std, np.nan),
        covariance=solution.covariance[:n, :n],
        not_identified=_not_identified(gains, std, moves, identifiable),
        mass=float(mass),
        com=com,
        com_std=com_std,
        rms=rms,
        rms_current=rms / np.where(moves, np.abs(gains), np.nan),
        relative_rms=relative,
        cutoff=float(options.cutoff or np.nan),
        unloaded=tuple(Source.of(r) for r in recordings[0]),
        loaded=tuple(Source.of(r) for r in recordings[1]),
        warnings=(),
    )


def _not_identified(
    gains: Array, std: Array, moves: NDArray[np.bool_], identifiable: NDArray[np.bool_]
) -> tuple[GainNotIdentified, ...]:
    """Return the joints without a gain, or with a weak one, and the reasons."""
    parts = []
    for j in range(len(gains)):
        if not moves[j]:
            parts.append(GainNotIdentified(j, "the joint never moves"))
        elif not identifiable[j]:
            parts.append(GainNotIdentified(j, "its torque is not related to that of the payload"))
        elif not std[j] <= WEAK * abs(gains[j]):
            parts.append(
                GainNotIdentified(
                    j,
                    f"standard deviation {100 * std[j] / abs(gains[j]):.0f} % of the gain: the "
                    "payload loads this joint too little in this motion",
                )
            )
    return tuple(parts)


def _identifiable(solution: GainSolution, n: int) -> NDArray[np.bool_]:
    """Mark the gains (n,) that no hidden direction involves."""
    identifiable = np.ones(n, dtype=bool)
    scale = np.maximum(np.abs(solution.gains), 1e-300)
    for direction in solution.hidden:
        part = np.abs(direction[:n]) / scale
        largest = float(np.max(np.abs(direction), initial=0.0))
        identifiable &= part * scale <= ZERO * largest
    return identifiable


def _centre(model: Model, solution: GainSolution, mass: float, known: Array) -> tuple[Array, Array]:
    """Return centre of mass and standard deviations (3,), NaN where not identifiable."""
    com = solution.body[1:4] / mass
    if not np.isnan(known[1]):
        return com, np.zeros(3)
    first = model.n + model.base.count
    std = np.sqrt(np.diag(solution.covariance)[first : first + 3]) / mass
    lost = np.zeros(3, dtype=bool)
    for direction in solution.hidden:
        lost |= np.abs(direction[first : first + 3]) > ZERO * np.max(np.abs(direction))
    return np.where(lost, np.nan, com), np.where(lost, np.nan, std)


def _require_load(gains: Array, std: Array, identifiable: NDArray[np.bool_], mass: float) -> None:
    """Raise if the payload has no visible effect, or if the runs are exchanged."""
    relative = std[identifiable] / np.abs(gains[identifiable])
    if not len(relative) or np.min(relative) > NO_PAYLOAD:
        raise IdentificationError(
            f"the loaded recordings do not show a payload of {mass:g} kg in comparison with the "
            "unloaded ones (the standard deviation of every gain exceeds 30 %); expected more "
            "motion, or recordings with that payload"
        )
    known = identifiable & (std <= NO_PAYLOAD * np.abs(gains))
    if np.all(gains[known] < 0.0):
        raise IdentificationError(
            "all drive gains are negative: the unloaded and the loaded recordings may be "
            "exchanged, or the signs of the currents reversed"
        )


def _require_arm(
    model: Model, relative: Array, recordings: tuple[Sequence[Recording], Sequence[Recording]]
) -> None:
    """Raise if the model explains too little of the currents."""
    bad = np.nan_to_num(relative) > ANOTHER_ARM
    if bad.sum() > len(bad) // 2:
        j = int(np.argmax(np.nan_to_num(relative)))
        names = ", ".join(r.name or "recording" for part in recordings for r in part)
        raise IdentificationError(
            f"{names}: the arm {model.robot.name!r} with one payload does not explain the "
            f"currents (on joint {j + 1} the residual is {100 * relative[j]:.0f} % of the torque's "
            "standard deviation); expected runs of that arm, all loaded ones with the same payload"
        )
