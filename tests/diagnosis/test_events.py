"""Contact, faults and joints at rest are recognised, reported and left out; the rest is judged."""

import sys
from dataclasses import dataclass, replace

import numpy as np
import pytest
from drives.commanded import LAWS, TWO_LINK
from plant.recordings import recorded

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.diagnosis.events import leave_out_events, with_brief_effects
from lieid_casadi.diagnosis.transients import (
    ResidualSignals,
    outstanding,
    returns_with_position,
    transient_events,
)
from lieid_casadi.identification.fit_warnings import held_joints
from lieid_casadi.recording import process

ROBOT = lieid.robots.panda()
MODEL = lieid.Model(ROBOT, "coulomb,viscous,offset")
FORCE = np.array([40.0, -25.0, 60.0])  # on the tool, N
POSE = np.array([0.3, -0.6, 0.2, -2.0, 0.4, 1.7, 0.5])


def recording(duration=12.0, seed=0, hidden=None, foreign=None):
    arm = plant.demo_arm(ROBOT, seed=0, hidden=None)
    if foreign is not None:
        arm = arm.with_effects(plant.ForeignTorque(5, foreign))
    if hidden is not None:
        arm = arm.with_effects(plant.hidden_effect(arm, *hidden[:2], strength=hidden[2]))
    return recorded(arm, seed, seconds=duration, name="run")


@pytest.fixture(scope="module")
def fit():
    return lieid.identify(MODEL, [recording(seed=1), recording(seed=2)])


@dataclass(frozen=True)
class Pose:
    """A reference that holds one pose."""

    duration: float = 10.0

    def at(self, t):
        still = np.zeros((len(t), len(POSE)))
        return POSE + still, still, still.copy()


def balancing(q):
    """Return the drives' torque (N, n) that balances the force at positions (N, n)."""
    return -np.einsum("kij,i->kj", lieid.compile(MODEL).jacobian(q)[:, 3:], FORCE)


def pushed_at_rest(start, end):
    """Simulate an arm under joint control that is pushed while it holds a pose."""
    torque = balancing(POSE[None])[0]

    def push(joint):
        def of(state):
            inside = np.clip((state.t - start) / 0.2, 0.0, 1.0) * np.clip(
                (end - state.t) / 0.2, 0.0, 1.0
            )
            return torque[joint] * inside

        return plant.ForeignTorque(joint, of)

    arm = plant.demo_arm(ROBOT, seed=0, hidden=None)
    arm = arm.with_effects(*(push(j) for j in range(ROBOT.n)))
    sensors = plant.demo_sensors(ROBOT)
    return plant.simulate(arm, Pose(), rate=500.0, sensors=sensors, name="at rest")


def pushed(run, start, end):
    """Add the force to a recording in motion."""
    inside = (run.t > start) & (run.t < end)
    tau = run.tau.copy()
    tau[inside] += balancing(run.q[inside])
    return replace(run, tau=tau)


def test_an_arm_at_rest_that_is_pushed_has_an_event_and_no_change(fit):
    found = lieid.diagnose(fit, pushed_at_rest(4.9, 6.0))
    contact, standstill = found.events
    assert found.steps == ()
    assert found.verdict != "sufficient"
    assert (contact.kind, standstill.kind) == ("contact", "standstill")
    assert contact.start == pytest.approx(4.9, abs=0.25)
    assert contact.end == pytest.approx(6.0, abs=0.25)
    assert standstill.joints == tuple(range(7))
    assert found.to_dict()["events"][0] == {
        "kind": "contact", "recording": "at rest", "from": contact.start, "to": contact.end,
        "joints": [j + 1 for j in contact.joints], "peak": contact.peak,
        "sentence": contact.sentence,
    }  # fmt: skip
    assert contact.sentence in found.sentence
    assert np.isnan(found.baseline["rms_test_moving"]).all()
    assert "Dropout" not in str([type(warning).__name__ for warning in found.warnings])


def test_a_push_in_motion_is_left_out(fit):
    run = recording(seed=3)
    (kept,), (event,) = leave_out_events(fit, [pushed(run, 5.0, 5.8)])
    assert event.kind == "contact"
    assert 4.7 < event.start < event.end < 6.1
    outside = (run.t < event.start - 0.1) | (run.t > event.end + 0.1)
    np.testing.assert_array_equal(kept.tau, run.tau[outside])


@pytest.mark.parametrize("joint", [1, 3])
def test_a_short_push_in_a_state_that_few_passes_have_is_left_out(fit, joint):
    run = recording(duration=20.0, seed=4)
    tau = run.tau.copy()
    tau[:, joint] += 30.0 * np.sin(np.pi * np.clip((run.t - 9.0) / 0.4, 0.0, 1.0))
    _, (event,) = leave_out_events(fit, [replace(run, tau=tau)])
    assert (event.kind, event.joints) == ("contact", (joint,))
    assert 8.7 < event.start < event.end < 9.7


@pytest.mark.slow
def test_nothing_has_changed_on_an_arm_that_is_pushed_in_motion(fit):
    found = lieid.diagnose(fit, pushed(recording(seed=3), 5.0, 5.8))
    assert (found.verdict, found.steps) == ("sufficient", ())
    assert [event.kind for event in found.events] == ["contact"]


@pytest.mark.slow
def test_a_push_while_training_does_not_hide_what_is_missing():
    hidden = ("load_friction", 1, 1.0)
    train = pushed(recording(seed=1, hidden=hidden), 5.0, 5.8)
    found = lieid.diagnose(MODEL, [train, recording(seed=2, hidden=hidden)])
    assert [event.kind for event in found.events] == ["contact"]
    assert [step.label for step in found.steps] == ["load_friction:2"]


def with_hidden(names, joint, strength):
    arm = plant.demo_arm(ROBOT, seed=0, hidden=None)
    effects = (plant.hidden_effect(arm, name, joint, strength=strength) for name in names)
    return arm.with_effects(*effects)


@pytest.mark.slow
@pytest.mark.parametrize("brief", [True, False])
def test_what_the_missing_effects_explain_is_no_event_in_the_end(monkeypatch, brief):
    """Beside the plain model friction that is larger at first looks like contact."""
    run = recorded(with_hidden(["stribeck", "warm_up"], 0, 40.0), 31, seconds=12.0, name="run")
    plain = lieid.identify(MODEL, run)
    assert transient_events(plain, [run])
    if brief:
        assert not transient_events(with_brief_effects(plain, [run], "wls"), [run])
    else:
        module = sys.modules["lieid_casadi.diagnosis.diagnose"]
        monkeypatch.setattr(module, "with_brief_effects", lambda fit, *_: fit)
    found = lieid.diagnose(MODEL, run)
    assert found.events == ()
    assert [step.label for step in found.steps] == ["stribeck:1"]


@pytest.mark.slow
def test_what_the_missing_effects_explain_is_no_event_in_a_test():
    arm = with_hidden(["position_friction", "viscous_asymmetric"], 4, 12.0)
    train, test = (recorded(arm, seed, seconds=10.0, name="run") for seed in (7, 27))
    assert transient_events(lieid.identify(MODEL, train), [test])
    found = lieid.diagnose(MODEL, train, test)
    assert found.events == ()
    assert found.unexplained == ()


def test_a_torque_that_changes_fast_is_no_fault():
    """Up to three samples before or after a change are no spike."""
    arm = plant.demo_arm(ROBOT, seed=0, hidden=None)
    ripples = [plant.hidden_effect(arm, "torque_ripple", j, strength=6.0) for j in (1, 3, 5)]
    run = recorded(arm.with_effects(*ripples), 2, seconds=12.0, name="run")
    assert transient_events(lieid.identify(MODEL, run), [run]) == ()


@pytest.mark.parametrize("fault", ["frozen", "spike"])
def test_a_fault_of_the_recorder_is_named(fit, fault):
    run = recording(seed=3)
    tau = run.tau.copy()
    rows = np.flatnonzero((run.t > 6.0) & (run.t < 6.3))
    if fault == "frozen":
        tau[rows] = tau[rows[0]]
    else:
        tau[rows[:2], 1] += 2000.0
    _, (event,) = leave_out_events(fit, [replace(run, tau=tau)])
    assert event.kind == "fault"
    assert 5.7 < event.start < event.end < 6.6


@pytest.mark.parametrize("hidden", [("load_friction", 1, 2.0), ("presliding", 3, 2.0)])
def test_an_effect_of_the_arm_is_no_event(fit, hidden):
    run = recording(seed=3, hidden=hidden)
    assert leave_out_events(fit, [run]) == ([run], ())


@pytest.mark.parametrize("name", ["torque_delay", "torque_lowpass"])
def test_a_late_torque_signal_is_not_transient(fit, name):
    """Its error is large for a short time at every reversal, where dry friction changes."""
    run = recording(seed=3, hidden=(name, 1, 3.0))
    found = ResidualSignals.of(fit, process([run], fit.processing)[0])
    error, transient = (np.abs(x[:, 1]).max() for x in (found.error, found.transient))
    assert transient < 0.3 * error


def test_torque_of_the_columns_is_no_event_where_the_fit_has_no_error(fit):
    """As shortly after a joint was stuck at its reversal."""
    own = ResidualSignals.of(fit, process([recording(2.0)], fit.processing)[0])
    error = np.full_like(own.error, 0.01)
    error[-1] = 2.0
    ones, still = np.ones_like(error), np.zeros_like(own.still)
    own = replace(own, error=error, transient=ones, slack=0.0 * ones, still=still)
    assert own.excess[:-1] == pytest.approx(0.01)
    assert own.excess[-1] == pytest.approx(1.0)


@pytest.mark.parametrize(
    "torque",
    [
        lambda s: 5.0 / (1.0 + ((s.q[..., 5] - 1.87) / 0.03) ** 2),
        lambda s: 5.0 / (1.0 + ((s.q[..., 5] - 1.87) / 0.03) ** 2) * s.sign[..., 5],
    ],
    ids=["bump", "rough spot"],
)
def test_an_error_at_one_position_is_no_contact(fit, torque):
    run = recording(duration=30.0, seed=3, foreign=torque)
    assert leave_out_events(fit, [run])[1] == ()


@pytest.mark.parametrize("returns", [True, False])
def test_an_error_returns_with_a_position_that_is_passed_once_more(fit, returns):
    """As at an end stop, which few motions reach often."""
    own = ResidualSignals.of(fit, process([recording(6.0)], fit.processing)[0])
    there_and_back = 1.0 - np.abs(np.linspace(-1.0, 1.0, len(own.time)))
    error = 5.0 * np.exp(-(((there_and_back - 0.5) / 0.02) ** 2))
    (first,) = np.nonzero(error[: len(error) // 2] > 0.5)
    if not returns:
        error[len(error) // 2 :] = 0.0
    alone = np.zeros_like(own.error), np.zeros_like(own.place)
    for values, of_joint in zip(alone, (error, there_and_back), strict=True):
        values[:, 5] = of_joint
    nothing = {"slack": np.zeros_like(own.slack), "still": np.zeros_like(own.still)}
    own = replace(own, error=alone[0], transient=alone[0], place=alone[1], **nothing)
    assert returns_with_position(own, slice(first[0], first[-1] + 1), 5) is returns


@pytest.mark.parametrize("returns", [True, False])
def test_an_error_returns_with_a_state_that_is_passed_several_times(fit, returns):
    """As where play is crossed; each of these errors was compared with all times but the others."""
    own = ResidualSignals.of(fit, process([recording()], fit.processing)[0])
    phase = 2.0 * np.pi * np.arange(len(own.time)) / len(own.time) * 4.0  # four rounds
    error = 5.0 * np.exp(-(((phase % (2.0 * np.pi) - 2.0) / 0.1) ** 2))
    if not returns:
        error[phase > 2.0 * np.pi] = 0.0
    state, values = np.zeros_like(own.state), np.zeros_like(own.error)
    state[:, 5, 0], state[:, 5, 1], values[:, 5] = np.cos(phase), np.sin(phase), error
    nothing = {"slack": np.zeros_like(own.slack), "still": np.zeros_like(own.still)}
    own = replace(own, error=values, transient=values, state=state, place=0.0 * values, **nothing)
    assert len(outstanding(own, own.excess / 0.01, 5)) == (0 if returns else 1)


def test_effects_on_joints_that_hardly_move_are_no_candidates(fit):
    run = recording(seed=3)
    q, dq = run.q.copy(), run.dq.copy()
    q[:, 4] = 0.4 + 1e-3 * np.sin(run.t)
    dq[:, 4] = 1e-3 * np.cos(run.t)
    _, (event,) = leave_out_events(fit, [replace(run, q=q, dq=dq)])
    assert (event.kind, event.joints) == ("standstill", (4,))


COMMANDED = replace(TWO_LINK, gravity=np.zeros(3)).with_drives(LAWS)


def held_run(held):
    """Return a recording in which joint 2 moves, then rests with a position error, rad."""
    t = np.arange(0.0, 12.0, 0.01)
    inertia = 2.0 * np.cos(2.0 * t) * (t < 9.42)
    q = np.column_stack([np.sin(1.3 * t), np.where(t < 9.42, np.sin(2.0 * t), np.sin(18.84))])
    dq = np.column_stack([1.3 * np.cos(1.3 * t), inertia])
    fit_torque = lieid.compile(COMMANDED).inverse_dynamics(
        q, dq, np.gradient(dq, t, axis=0), COMMANDED.link_parameters
    )
    friction = [0.4, 0.3] * np.sign(dq)
    stiffness, damping = ([getattr(law, name) for law in LAWS] for name in ("stiffness", "damping"))
    error = (fit_torque + friction + damping * dq) / stiffness
    error[t > 9.6, 1] += held
    noise = 1e-5 * np.random.default_rng(0).normal(size=q.shape)
    return lieid.Recording.from_arrays(t, q + noise, command=q + error).with_drives(LAWS)


@pytest.mark.parametrize("held", [0.0, 0.1])
def test_a_joint_that_is_held(held):
    recording = held_run(held)
    fit = lieid.identify(lieid.Model(COMMANDED, "coulomb,viscous"), recording)
    found = [str(warning) for warning in held_joints(fit, [recording])]
    if not held:
        assert found == []
        return
    (message,) = found
    assert message.startswith("joint 2 rests for ")
    peak = float(message.split("up to ")[1].split()[0])
    assert peak == pytest.approx(LAWS[1].stiffness * held, rel=0.1)


def test_measured_torque_is_not_judged():
    recording = held_run(0.1)
    fit = lieid.identify(lieid.Model(COMMANDED, "coulomb,viscous"), recording)
    assert held_joints(fit, [replace(recording, command=None)]) == []
