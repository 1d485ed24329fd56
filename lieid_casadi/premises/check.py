"""Whether robot and recording belong together, tested before any physics is inferred."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.blas_threads import blas_on_one_thread
from lieid_casadi.errors import ModelError
from lieid_casadi.identification import Fit
from lieid_casadi.model import Model
from lieid_casadi.premises import joints, match, mounting, samples, timing, torque_signal
from lieid_casadi.premises.correction import Correction
from lieid_casadi.premises.findings import Finding, PremiseCheck
from lieid_casadi.premises.plain_fit import Samples, samples_of
from lieid_casadi.premises.screen import Alternative, Errors, Screen
from lieid_casadi.recording import Recording
from lieid_casadi.recording.recording import listed
from lieid_casadi.robot import Robot

Progress = Callable[[str, float], None]
#: Corrections that are combined, at most.
DEPTH = 3
#: Ratio of errors, with the correction to without, at and below which a premise is wrong.
WRONG = 1.0 / 3.0
#: A joint shows a premise if the correction lowers its error to this part.
SHOWS = 0.7
#: The same for stated inertias, and the least part of the arm's rigid torque that they leave
#: unexplained without the correction: they are never exact, and a tool that they do not contain
#: changes the torque of the last joints.
SHOWS_STATED, LEAST_UNEXPLAINED = 0.4, 0.3
#: A finding needs a joint that shows it, and this decrease of the score.
LEAST_SCORE = -0.6
#: Least error without the correction on one of these joints, as part of its torque: less is the
#: size of effects of drives, such as friction under load.
LEAST_BEFORE = 0.04
#: Factor by which a correction may increase the error of a joint and still be certain.
WORSE = 1.5
#: Instants with which hypotheses are compared, and with which the best one is confirmed.
COMPARED, CONFIRMED = 300, 1500
#: Least decrease of the score on the compared instants for a hypothesis to be confirmed.
WORTH_CONFIRMING = -0.3
PREMISES = (
    "gravity_direction", "joint_order", "joint_sign", "torque_sign", "joint_zero",
    "joint_coupling", "position_unit", "time_unit", "torque_unit", "torque_gravity_compensated",
    "torque_from_model", "time_offset", "velocity_signal", "angle_wrapped", "spikes",
    "held_samples", "clipped", "robot_mismatch", "same_motion",
)  # fmt: skip


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
    at most three times.

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
    ModelError
        Another number of joints, or no torque.
    RecordingError
        No recording is long enough.
    """
    model = robot.model if isinstance(robot, Fit) else robot
    arm = model if isinstance(model, Robot) else model.robot
    given = listed(recordings)
    _require(arm, given)
    report = progress or (lambda stage, fraction: None)
    report("samples", 0.0)
    state = _State.of(arm, given)
    findings = list(state.findings)
    report("velocity", 0.1)
    findings += _velocity(state)
    for depth in range(DEPTH):
        found = _strongest(state, report, depth)
        if found is None:
            break
        finding, state = found
        findings.append(finding)
    findings.sort(key=lambda f: (not f.certain, 1.0 if f.ratio is None else f.ratio))
    if not any(f.certain and f.ratio is not None for f in findings):
        findings = [*_mismatch(state), *findings]
    if torque_signal.from_model(state.confirmed):
        findings.append(_from_model())
    findings += _same_motion(given, listed(test))
    untested = _not_checkable(state, {f.premise for f in findings}, bool(listed(test)))
    report("done", 1.0)
    names = dict(untested)
    return PremiseCheck(tuple(findings), tuple(p for p in PREMISES if p not in names), untested)


def _require(robot: Robot, given: Sequence[Recording]) -> None:
    if not given:
        raise ModelError("no recordings given; expected at least one")
    for recording in given:
        if recording.n != robot.n:
            raise ModelError(
                f"{recording.title}: {recording.n} joints; robot {robot.name!r} has {robot.n}"
            )
        if recording.tau is None:
            raise ModelError(
                f"{recording.title}: no torque; expected columns tau1…tau{robot.n}, or currents "
                "with torque constants"
            )


@dataclass(frozen=True, eq=False)
class _State:
    """Robot and recordings with the corrections so far, and what reading them has shown."""

    robot: Robot
    recordings: tuple[Recording, ...]
    samples: Samples
    findings: tuple[Finding, ...] = ()
    weightless: bool = False

    @classmethod
    def of(cls, robot: Robot, given: Sequence[Recording]) -> _State:
        """Return the recordings repaired, with stamps in a plausible unit."""
        made = [samples.repaired_recording(r, robot) for r in given]
        findings = [
            Finding(
                d.premise, d.joints, {"samples": d.samples}, None, None, None, False, d.sentence,
                d.remedy,
            )
            for recording in made
            for d in samples.damages(recording)
        ]  # fmt: skip
        found = timing.suspected_unit(made[0])
        if found is not None:
            made = [replace(r, t=r.t * found.factor) for r in made]
            findings.append(
                Finding(
                    "time_unit", (), {"factor": found.factor, "unit": found.unit}, None, None,
                    None, found.certain,
                    f"The time stamps are in {found.unit}, not in seconds ({found.why}): with "
                    f"--units {found.unit}.", f"--units {found.unit}",
                )
            )  # fmt: skip
        placeholder = torque_signal.weightless(robot)
        return cls(robot, tuple(made), samples_of(made), tuple(findings), placeholder)

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
        return Screen(self.robot, self.samples, most=most, parts=parts, stated_torque=stated)

    def corrected(self, correction: Correction) -> _State:
        """Return the state after a correction."""
        recordings = tuple(correction.of_recording(r) for r in self.recordings)
        made = correction.of_samples(self.samples)
        if correction.time != 1.0:  # filters and rests depend on the unit of time
            made = samples_of(recordings)
        return replace(
            self, robot=correction.of_robot(self.robot), recordings=recordings, samples=made
        )


def _strongest(state: _State, report: Progress, depth: int) -> tuple[Finding, _State] | None:
    """Return the strongest finding and the corrected state, or None if nothing is found."""
    screen = state.compared
    scored: list[tuple[float, Alternative]] = []
    tests = list(_alternatives(screen))
    for k, (name, make) in enumerate(tests):
        report(name, (0.1 + 0.85 * (depth + k / len(tests)) / DEPTH))
        scored += [(screen.score(a.correction) + a.cost, a) for a in make]
    scored.sort(key=lambda pair: pair[0])
    full = state.confirmed
    for score, alternative in scored[:2]:
        if score > WORTH_CONFIRMING:
            break
        finding = _confirmed(full, alternative)
        if finding is not None:
            return finding, state.corrected(alternative.correction)
    return None


def _alternatives(screen: Screen) -> Iterator[tuple[str, Iterator[Alternative]]]:
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
    yield "time_offset", timing.delays(screen)


def _confirmed(full: Screen, alternative: Alternative) -> Finding | None:
    """Return an alternative as a finding if it lowers the held-out errors."""
    before, after = full.base, full.errors(alternative.correction)
    if after.score(before) + alternative.cost > LEAST_SCORE:
        return None
    ratios = after.relative / before.relative
    shown_free = (ratios[0] < SHOWS) & (before.relative[0] > LEAST_BEFORE)
    unexplained = match.unexplained(before) or 0.0
    shown_stated = unexplained > LEAST_UNEXPLAINED and bool(np.any(ratios[1:] < SHOWS_STATED))
    if not shown_free.any() and not shown_stated:
        return None
    by_stated = shown_stated and _ratio(ratios[0]) > max(WRONG, _ratio(ratios[-1]))
    kind = 1 if by_stated else 0
    ratio = _ratio(ratios[kind])
    certain = ratio <= WRONG and bool(np.all(ratios[kind] < WORSE))
    certain = certain and not alternative.small
    errors = [_of_kind(e, kind) for e in (before, after)]
    shown = np.flatnonzero(ratios[kind] < SHOWS)
    return Finding(
        alternative.premise, alternative.joints or _most(ratios[kind]), alternative.value,
        _rounded(errors[0]), _rounded(errors[1]), float(f"{ratio:.3g}"), certain,
        f"{alternative.what} the error of {_joints(shown)} falls from {_numbers(errors[0][shown])} "
        f"to {_numbers(errors[1][shown])} N·m{' (with the stated inertias)' if kind else ''}.",
        alternative.remedy,
    )  # fmt: skip


def _of_kind(errors: Errors, kind: int) -> Array:
    if kind == 0 or errors.stated is None:
        return errors.free.held_out
    return errors.stated.error


def _ratio(ratios: Array) -> float:
    """Return the mean ratio on the joints that show a premise; 1 if none does."""
    shown = ratios[ratios < SHOWS]
    return float(np.exp(np.mean(np.log(shown)))) if shown.size else 1.0


def _most(ratios: Array) -> tuple[int, ...]:
    """Return up to three joints on which the error falls most."""
    return tuple(sorted(int(j) for j in np.argsort(ratios)[:3] if ratios[j] < SHOWS))


def _joints(shown: np.typing.NDArray[np.intp]) -> str:
    numbers = [str(j + 1) for j in shown]
    if len(numbers) > 2 and shown[-1] - shown[0] == len(shown) - 1:
        return f"joints {numbers[0]}–{numbers[-1]}"
    return f"joint{'s' if len(numbers) > 1 else ''} {', '.join(numbers)}"


def _rounded(values: Array) -> tuple[float, ...]:
    return tuple(float(f"{x:.4g}") for x in values)


def _numbers(values: Array) -> str:
    return " ".join(f"{x:.3g}" for x in values)


def _velocity(state: _State) -> list[Finding]:
    """Return what is wrong with the recorded velocity, judged by the free fit's error."""
    found = timing.velocity(state.samples)
    if found is None:
        return []
    good = state.confirmed
    measured = timing.with_measured_velocity(state.samples)
    bad = replace(state, samples=measured).confirmed
    before, after = bad.base.free.held_out, good.base.free.held_out
    ratios = after / before
    ratio = _ratio(ratios)
    shown = np.flatnonzero(ratios < SHOWS)
    falls = (
        f" the error of {_joints(shown)} falls from {_numbers(before[shown])} to "
        f"{_numbers(after[shown])} N·m"
        if shown.size
        else " the friction is that of the true velocity"
    )
    return [
        Finding(
            found.premise, found.joints, found.value,
            _rounded(before), _rounded(after), float(f"{ratio:.3g}"), ratio <= WRONG,
            f"{found.what}{falls}.", found.remedy,
        )
    ]  # fmt: skip


def _mismatch(state: _State) -> list[Finding]:
    errors = state.confirmed.base
    found = match.mismatch(errors)
    if found is None:
        return []
    certain, part = found
    before = errors.free.held_out if errors.stated is None else errors.stated.error
    basis = "geometry" if errors.stated is None else "geometry and inertias"
    return [
        Finding(
            "robot_mismatch", _most(-before / errors.scale), {},
            _rounded(before), None, None, certain,
            f"This is probably a recording of another arm: the stated {basis} leave "
            f"{100.0 * part:.0f} % of the torque's rigid part unexplained, and no correction of "
            "order, sign, zero, unit or mounting lowers it.",
            "use the description of the arm that was recorded",
        )
    ]  # fmt: skip


def _from_model() -> Finding:
    return Finding(
        "torque_from_model", (), {}, None, None, None, False,
        "The torque has neither friction nor noise: it is probably computed by a model, not "
        "measured. Effects of the drives are not in it.",
        "record the measured torque or current of the joints",
    )  # fmt: skip


def _same_motion(train: Sequence[Recording], tests: Sequence[Recording]) -> list[Finding]:
    findings = []
    for test in tests:
        part = match.same_motion(train, test)
        if part > match.LEAST_PART:
            findings.append(
                Finding(
                    "same_motion", (), {"fraction": round(part, 3)}, None, None, None, False,
                    f"{test.title} repeats the motion of the training in {100.0 * part:.0f} % of "
                    "its samples: its error is no test of the model. Test on another motion.",
                    "test on another motion, or leave --test out",
                )
            )  # fmt: skip
    return findings


def _not_checkable(state: _State, found: set[str], tested: bool) -> tuple[tuple[str, str], ...]:
    """Return the premises that these recordings cannot test, and why."""
    screen = state.compared
    reasons = [
        ("gravity_direction", mounting.not_checkable(screen)),
        ("torque_unit", torque_signal.not_checkable(state.robot, state.weightless)),
        ("joint_order", joints.alike(screen)),
        ("velocity_signal", None if np.isfinite(state.samples.measured).all() else
         "the recording has no velocities"),
        ("same_motion", None if tested else "no test recording was given"),
    ]  # fmt: skip
    return tuple((p, why) for p, why in reasons if why is not None and p not in found)
