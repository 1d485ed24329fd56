"""Whether robot and recording belong together, tested before any physics is inferred."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lieid_casadi.blas_threads import blas_on_one_thread
from lieid_casadi.errors import LieidError
from lieid_casadi.identification import Fit
from lieid_casadi.identification.recording_checks import check_recordings
from lieid_casadi.messages import joints_text
from lieid_casadi.model import Model
from lieid_casadi.premises import joints, match, mounting, samples, timing, torque_signal
from lieid_casadi.premises.correction import Correction
from lieid_casadi.premises.findings import (
    SHOWS,
    Finding,
    PremiseCheck,
    Wrong,
    findings_of,
    mean_ratio,
    most_shown,
    rounded,
)
from lieid_casadi.premises.joints import ALIKE
from lieid_casadi.premises.plain_fit import Samples, samples_of
from lieid_casadi.premises.screen import Alternative, Errors, RigidArm, Screen
from lieid_casadi.recording import Recording
from lieid_casadi.recording.conversion import is_torque_of_laws
from lieid_casadi.recording.recording import listed
from lieid_casadi.recording.repairs import repaired
from lieid_casadi.robot import Robot

Progress = Callable[[str, float], None]
#: Steps of correction, at most. Three wrong premises are found in up to five: an order or mounting
#: that is found while others are wrong may have to be corrected again.
DEPTH = 5
#: Ratio of errors, with the correction to without, at and below which a premise is wrong.
WRONG = 1.0 / 3.0
#: With stated inertias, which are never exact, the error falls by this multiple of what centres of
#: mass beside the stated ones explain.
BEYOND = 2.0
#: A finding needs a joint that shows it, and this decrease of the score.
LEAST_SCORE = -0.6
#: The same for delays of slow motion, whose errors are small: also a doubt at most.
SHOWS_OF_SLOW, LEAST_OF_SLOW = 0.6, -2.0
#: Least error without the correction on one of these joints, as part of its torque: less is the
#: size of effects of drives, such as friction under load.
LEAST_BEFORE = 0.04
#: Largest motion of a joint, rad or m, of an arm at rest; least time, s, without the filter's
#: edges, whose held-out parts show anything.
AT_REST, SHORTEST = 0.02, 4.0
#: Part of the instants at which a joint moves, from which its friction counts.
LEAST_MOVING = 0.1
#: Factor by which a correction may increase the error of a joint and still be certain.
WORSE = 1.5
#: Instants with which hypotheses are compared, and with which the best one is confirmed.
COMPARED, CONFIRMED = 200, 1500
#: Least decrease of the score on the compared instants for a hypothesis to be confirmed, and the
#: number of hypotheses for which that is tried.
WORTH_CONFIRMING, CONFIRMATIONS = -0.1, 4
PREMISES = (
    "gravity_direction", "joint_order", "joint_sign", "torque_sign", "joint_zero",
    "joint_coupling", "position_unit", "time_unit", "torque_unit", "torque_gravity_compensated",
    "torque_from_model", "time_offset", "velocity_signal", "angle_wrapped", "spikes",
    "held_samples", "clipped", "robot_mismatch", "same_motion",
)  # fmt: skip
#: Those that are tested without any fit.
SAMPLES_ALONE = ("time_unit", "angle_wrapped", "spikes", "held_samples", "clipped")


@blas_on_one_thread
def check(
    robot: Robot | Model | Fit,
    recordings: Recording | Iterable[Recording],
    *,
    test: Recording | Iterable[Recording] = (),
    progress: Progress | None = None,
) -> PremiseCheck:
    """Return whether robot and recording belong together.

    A plain model (rigid body, rotor inertia, Coulomb and viscous friction, offset) is fitted under
    every alternative to what the robot and the recording state: another mounting, order, sign,
    zero or unit, torque without gravity, late or exchanged. An alternative is a finding if it
    lowers the error in motion on held-out parts of the recording, and makes the verdict ``wrong``
    if it lowers it to a third or less. The strongest finding is corrected and the test repeated,
    at most five times.

    Parameters
    ----------
    robot : Robot, Model or Fit
        The arm as the user describes it.
    recordings : Recording or iterable of Recording
        With torque, of one arm under the same conditions.
    test : Recording or iterable of Recording
        Recordings that are to test a fit: reported if they repeat the motion of ``recordings``.
    progress : callable, optional
        Called with the premise that is being tested and the fraction done.

    Returns
    -------
    PremiseCheck
        Verdict, findings with the option that corrects each, and what could not be checked.

    Raises
    ------
    ModelError, IdentificationError, RecordingError
        Another number of joints, no torque, no recording that is long enough.
    """
    model = robot.model if isinstance(robot, Fit) else robot
    arm = model if isinstance(model, Robot) else model.robot
    given, tests = listed(recordings), listed(test)
    check_recordings(Model(arm), given)
    report = progress or (lambda stage, fraction: None)
    report("samples", 0.0)
    state = _State.of(arm, given)
    findings = list(state.findings)
    constant = samples.constant_torque(state.recordings)
    reason = "a torque is constant" if constant is not None else _nothing_to_fit(state.samples)
    if reason is not None:
        findings += [] if constant is None else [constant]
        why = tuple((p, reason) for p in PREMISES if p not in SAMPLES_ALONE)
        return PremiseCheck(tuple(findings), SAMPLES_ALONE, why)
    report("velocity", 0.1)
    jump = timing.jump(state.samples)
    if jump is not None:
        findings.append(jump[0])
        state = replace(state, samples=state.samples.at(np.flatnonzero(jump[1])))
    findings += _velocity(state)
    given_errors = state.confirmed.base
    corrected: list[Wrong] = []
    for depth in range(DEPTH):
        found = _reversed(state, every=True) or _strongest(state, report, depth)
        found = found or _reversed(state, every=False)
        if found is None:
            break
        corrected.append(found)
        state = state.corrected(found.alternative.correction)
    corrections = findings_of(corrected, given[0])
    known = any(finding.certain for finding in [*findings, *corrections])
    mismatch = _mismatch(given_errors, state.confirmed.base, certain=not known)
    if mismatch is None or not mismatch.certain:  # corrections of another arm are none
        findings += corrections
    if any(finding.premise == "position_unit" for finding in findings):
        findings = [f for f in findings if f.premise != "velocity_signal"]  # judged in that unit
    findings.sort(key=lambda f: (not f.certain, 1.0 if f.ratio is None else f.ratio))
    findings = findings if mismatch is None else [mismatch, *findings]
    if torque_signal.from_model(state.confirmed):
        findings.append(FROM_MODEL)
    findings += match.same_motions(given, tests)
    untested = _not_checkable(state, {f.premise for f in findings}, bool(tests))
    report("done", 1.0)
    names = dict(untested)
    unseen = () if any(finding.certain for finding in findings) else _unseen(state)
    checked = tuple(p for p in PREMISES if p not in names)
    return PremiseCheck(tuple(findings), checked, (*untested, *unseen))


FROM_MODEL = Finding(
    "torque_from_model",
    (),
    {},
    "The torque has neither friction nor noise: it is probably computed by a model, not measured. "
    "Effects of the drives are not in it.",
    "record the measured torque or current of the joints",
)


def check_where_possible(
    robot: Robot | Model | Fit,
    recordings: Sequence[Recording],
    *,
    test: Sequence[Recording] = (),
    progress: Progress | None = None,
) -> PremiseCheck:
    """Return the check that precedes inference, without findings where it does not apply.

    It does not apply to recordings that are too short, nor to torques of drive laws, which are
    assumptions themselves.
    """
    if all(r.tau is not None and r.command is None for r in recordings):
        with suppress(LieidError):  # the inference says what it lacks
            return check(robot, recordings, test=test, progress=progress)
    return PremiseCheck((), ())


def _nothing_to_fit(s: Samples) -> str | None:
    """Return why no fit of these samples compares hypotheses, or None."""
    if np.ptp(s.q, axis=0).max() < AT_REST:
        return "no joint moves"
    if len(s.t) * float(np.median(np.diff(s.t))) < SHORTEST:
        return f"the recordings are shorter than {SHORTEST + 1.0:g} s"
    return None


@dataclass(frozen=True, eq=False)
class _State:
    """Robot and recordings with the corrections so far, and what reading them has shown."""

    robot: Robot
    recordings: tuple[Recording, ...]
    samples: Samples
    arm: RigidArm
    findings: tuple[Finding, ...] = ()
    weightless: bool = False

    @classmethod
    def of(cls, robot: Robot, given: Sequence[Recording]) -> _State:
        """Return the recordings repaired, with stamps in a plausible unit."""
        turning = np.array([joint.revolute for joint in robot.joints])
        made = [repaired(recording, turning) for recording in given]
        findings = [finding for recording in made for finding in samples.damages(recording)]
        for k, recording in enumerate(made):
            made[k], frozen = samples.without_frozen_torque(recording)
            findings += frozen
        found = timing.suspected_unit(made[0])
        if found is not None:
            made = [replace(r, t=r.t * found.value["factor"]) for r in made]
            findings.append(found)
        placeholder = torque_signal.weightless(robot)
        arm = RigidArm.of(robot)
        return cls(robot, tuple(made), samples_of(made), arm, tuple(findings), placeholder)

    @cached_property
    def commanded(self) -> bool:
        """Whether all torques are those of the drives' laws."""
        return all(r.drives and is_torque_of_laws(r, r.drives) for r in self.recordings)

    @cached_property
    def compared(self) -> Screen:
        """A quick comparison of many hypotheses from here."""
        return self._screen(COMPARED, parts=False)

    @cached_property
    def confirmed(self) -> Screen:
        """A comparison on more instants and held-out parts."""
        return self._screen(CONFIRMED, parts=True)

    def _screen(self, most: int, *, parts: bool) -> Screen:
        stated = not self.weightless
        return Screen(self.robot, self.samples, most, parts, stated, self.arm)

    def corrected(self, correction: Correction) -> _State:
        """Return the state after a correction."""
        recordings = tuple(correction.of_recording(r) for r in self.recordings)
        made = correction.of_samples(self.samples)
        if correction.time != 1.0:  # filters and rests depend on the unit of time
            made = samples_of(recordings)
        if correction.weight:
            whole = Screen(self.robot, made, len(made.t), known_arm=self.arm)
            made = replace(made, tau=made.tau + whole.weight)
        return replace(
            self, robot=correction.of_robot(self.robot), recordings=recordings, samples=made
        )


def _strongest(state: _State, report: Progress, depth: int) -> Wrong | None:
    """Return the premise whose correction lowers the errors most, or None if none does."""
    base, full = state.confirmed.base, state.confirmed
    most = np.sqrt(np.maximum(base.rms[-1] ** 2 - (WRONG * base.free.error) ** 2, 0.0))
    if np.all(base.relative[0] <= LEAST_BEFORE) and np.all(most <= BEYOND * full.displaced):
        return None  # no alternative could be confirmed
    screen = state.compared
    scored: list[tuple[float, Alternative]] = []
    tests = list(_alternatives(state, screen))
    for k, (name, make) in enumerate(tests):
        report(name, (0.1 + 0.85 * (depth + k / len(tests)) / DEPTH))
        made = list(make)
        scores = screen.scores([a.correction for a in made])
        scored += [(s + a.cost, a) for s, a in zip(scores, made, strict=True)]
    scored.sort(key=lambda pair: pair[0])
    for score, alternative in scored[:CONFIRMATIONS]:
        if score > WORTH_CONFIRMING:
            break
        found = _confirmed(state.confirmed, alternative)
        if found is not None:
            return found
    return None


def _alternatives(state: _State, screen: Screen) -> Iterator[tuple[str, Iterator[Alternative]]]:
    """Yield the alternatives of each premise with its name."""
    if screen.gravity.any():
        yield "gravity_direction", mounting.alternatives(screen)
        yield "torque_gravity_compensated", torque_signal.gravity_compensated(screen)
    yield "joint_order", joints.order(screen)
    yield "joint_order", joints.torque_order(screen)
    yield "joint_sign", joints.directions(screen)
    yield "joint_zero", joints.zeros(screen)
    yield "joint_coupling", joints.couplings(screen)
    yield "position_unit", joints.degrees(screen)
    yield "torque_unit", torque_signal.units(screen)
    if not state.commanded:
        yield "time_offset", timing.delays(screen)


def _confirmed(full: Screen, alternative: Alternative) -> Wrong | None:
    """Return an alternative with its errors if it lowers the held-out ones."""
    before, after = full.base, full.errors(alternative.correction)
    certain = _lower(full, before, after, alternative)
    if certain is None:
        return None
    kind = 1 if _by_stated(before, after) else 0
    return Wrong.of(alternative, before, after, kind, certain=certain)


def _by_stated(before: Errors, after: Errors) -> bool:
    """Return whether the stated fit shows a fall of the errors, and the free one does not."""
    ratios = after.relative / before.relative
    return mean_ratio(ratios[0]) > max(WRONG, mean_ratio(ratios[-1]))


def _lower(full: Screen, before: Errors, after: Errors, alternative: Alternative) -> bool | None:
    """Return whether it is certain that errors fall by an alternative; None if they hardly do."""
    score = after.score(before) + alternative.cost
    ratios = after.relative / before.relative
    if alternative.premise == "joint_coupling":  # it changes the torque that errors are relative to
        ratios = np.maximum(ratios, ratios * after.scale / before.scale)
        if ratios[0, alternative.joints[1]] > 1.0:
            return None  # a true position explains the torque of its own joint, too
    clear = score <= LEAST_SCORE
    shown_free = (ratios[0] < SHOWS) & (before.relative[0] > LEAST_BEFORE)
    unlike = (match.unexplained(before) or 0.0) > match.SOUND
    explained = after.relative[-1] < WORSE * after.relative[0]  # as by free inertias: no tool does
    squares = before.relative[-1] ** 2 - after.relative[-1] ** 2
    lowered = after.scale * np.sqrt(np.maximum(squares, 0.0))
    beyond = (ratios[-1] < SHOWS) & (lowered > BEYOND * full.displaced) & (unlike | explained)
    shown_stated = len(ratios) > 1 and bool(beyond.any())
    if not clear or not (shown_free.any() or shown_stated):
        slow = score <= LEAST_OF_SLOW and ratios.min() < SHOWS_OF_SLOW and not alternative.small
        return False if slow and alternative.premise == "time_offset" else None
    kind = 1 if shown_stated and _by_stated(before, after) else 0
    if not kind and not shown_free.any():
        return None
    certain = mean_ratio(ratios[kind]) <= WRONG and bool(np.all(ratios[kind] < WORSE))
    if kind:  # on one joint alone, less is within the errors of stated inertias
        plain = (before.relative[1] > match.SOUND) | ((before.driven < 0) & (after.driven > 0))
        certain &= beyond.sum() > 1 or bool(np.any(beyond & plain))
    return certain and not alternative.small


def _reversed(state: _State, *, every: bool) -> Wrong | None:
    """Return the opposite sign of the torque of joints that friction drives instead of braking.

    A free fit has the same error with either sign, and negative masses with the wrong one.
    """
    base = state.confirmed.base
    moving = np.mean(state.samples.moving, axis=0) > LEAST_MOVING
    driven = moving & (base.driven < 0)
    most = driven.sum() >= max(1, moving.sum() / 2) and not np.any(base.driven[moving] > 0)
    if not driven.any() or (every and not most):
        return None
    *single, together = joints.directions(state.compared)
    for alternative in [together] if every else [a for a in single if driven[a.joints[0]]]:
        after = state.confirmed.errors(alternative.correction)
        worse = np.sum(np.log(after.relative[-1] / base.relative[-1])) > (0.0 if every else -ALIKE)
        own = driven if every else np.arange(len(driven)) == alternative.joints[0]
        if not worse and not np.any(after.driven[own] < 0):
            wrong = Wrong.of(alternative, base, after, len(base.rms) - 1, certain=True)
            return replace(
                wrong,
                otherwise=f"{alternative.what.partition(': with')[0]}. Correct it with {{}}.",
                added=" With the recorded sign, friction would drive the "
                f"joint{'s' if every else ''}.",
            )
    return None


def _velocity(state: _State) -> list[Finding]:
    """Return what is wrong with the recorded velocity, judged by the free fit's error."""
    found = timing.velocity(state.samples)
    if found is None:
        return []
    recorded = replace(state, samples=timing.with_measured_velocity(state.samples))
    wrong = Wrong.of(found, recorded.confirmed.base, state.confirmed.base)
    otherwise = f"{found.what} the friction is that of the true velocity."
    wrong = replace(wrong, otherwise=otherwise, certain=mean_ratio(wrong.ratios) <= WRONG)
    return [wrong.finding(found.remedy)]


def _mismatch(given: Errors, last: Errors, *, certain: bool) -> Finding | None:
    """Return that the recording is of another arm, if no correction explains its torque.

    ``given`` are the errors without corrections, ``last`` those with all that were found. It is
    ``certain`` if they are large in both, too.
    """
    found = match.mismatch(last)
    if found is None:
        return None
    certain = found[0] or (certain and (match.unexplained(given) or 0.0) > match.OTHER)
    basis = "geometry" if last.stated is None else "geometry and inertias"
    what = f"of a load, or of other torques on joint {int(np.argmax(last.rms[-1])) + 1}"
    if certain:
        what = "or several premises are wrong at once and cannot be separated"
    return Finding(
        "robot_mismatch",
        most_shown(-last.rms[-1] / last.scale),
        {},
        f"This {'is' if certain else 'may be'} a recording of another arm, {what}: the stated "
        f"{basis} leave {100.0 * found[1]:.0f} % of the torque's rigid part unexplained, whatever "
        "order, sign, zero, unit or mounting is assumed.",
        "use the description of the arm that was recorded, or state what is known of its mounting "
        "and joints (--base-rpy, --joint-order, --joint-sign) and check again",
        certain=certain,
        error_before=rounded(given.rms[-1]),
    )


def _not_checkable(state: _State, found: set[str], tested: bool) -> tuple[tuple[str, str], ...]:
    """Return the premises that these recordings cannot test, and why."""
    screen = state.compared
    reasons = [
        ("gravity_direction", mounting.not_checkable(screen)),
        ("torque_unit", torque_signal.not_checkable(state.robot, state.weightless)),
        ("joint_order", joints.alike(screen)),
        ("velocity_signal", None if np.isfinite(state.samples.measured).all() else
         "the recording has no velocities"),
        ("time_offset", "the delay of commands is an effect of the model, command_delay"
         if state.commanded else None),
        ("same_motion", None if tested else "no test recording was given"),
    ]  # fmt: skip
    return tuple((p, why) for p, why in reasons if why is not None and p not in found)


def _unseen(state: _State) -> tuple[tuple[str, str], ...]:
    """Return the premises on single joints that could be wrong without a finding, and of which.

    If the recording were corrupted so, the errors would be those under the alternative.
    """
    screen, n = state.compared, state.robot.n
    signs = list(joints.directions(screen))
    turning = [joint.revolute for joint in state.robot.joints]

    def hidden(alternative: Alternative) -> bool:
        before = screen.errors(alternative.correction)
        return _lower(screen, before, screen.base, alternative) is None

    def zero(j: int, angle: float) -> Alternative:
        return replace(signs[0], joints=(j,), correction=joints.zero_of(n, j, angle), cost=0.5)

    braked = state.confirmed.base.driven > 0  # friction would drive them
    masks = {
        ("joint_sign", "the direction"): [hidden(a) for a in signs[0:-1:3]],
        ("torque_sign", "the sign of the torque"): [
            not b and hidden(a) for b, a in zip(braked, signs[1:-1:3], strict=True)
        ],
        **{
            ("joint_zero", f"a zero off by {angle}°"): [
                t and any(hidden(zero(j, s * np.radians(angle))) for s in (-1, 1))
                for j, t in enumerate(turning)
            ]
            for angle in (20, 90)
        },
    }
    return tuple(
        (
            premise,
            f"{what} of {joints_text(mask)} would change the error no more than inexact stated "
            "masses do",
        )
        for (premise, what), mask in masks.items()
        if any(mask)
    )
