"""Friction and torque that change in the course of a recording, which no effect of an arm does."""

import numpy as np
import pytest
from plant.recordings import recorded

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.tables import std_text, value_text

ROBOT = lieid.robots.two_link()
MODEL = lieid.Model(ROBOT, "coulomb,viscous,offset")
SERIES = {"seconds": 20.0, "step": 0.004}
INSTANT = 8.3  # s
PERIOD, AMPLITUDE = 9.0, 0.3  # s, N·m


def measured(torque=None, *, joint=1, seed=1, name="a.csv", **series):
    """Return 20 s of an arm with a further torque on one joint."""
    arm = plant.demo_arm(ROBOT, hidden=None)
    if torque is not None:
        arm = arm.with_effects(plant.ForeignTorque(joint, function=torque))
    return recorded(arm, seed, **SERIES | series, name=name)


def more_friction(size):
    return lambda s: np.where(s.t >= INSTANT, size, 0.0) * s.sign[..., 1]


def wave(s):
    return AMPLITUDE * np.sin(2.0 * np.pi * s.t / PERIOD + 1.0) * np.ones(s.q.shape[:-1])


@pytest.mark.parametrize("size", [0.6, -0.6])
def test_friction_that_changes_at_an_instant_is_stated_and_no_effect_takes_its_place(size):
    diagnosis = lieid.diagnose(MODEL, measured(more_friction(size), seed=3))
    assert not diagnosis.steps
    assert diagnosis.verdict == "unexplained"
    (found,) = diagnosis.differing
    assert (found.label, found.recording, found.of_model) == ("coulomb:2", "a.csv", True)
    assert found.since == pytest.approx(INSTANT, abs=0.1)
    assert found.parameters["f_c"] == pytest.approx(size, rel=0.1)
    (part,) = diagnosis.unexplained
    assert (part.joint, part.depends_on, part.differs) == (1, ("t", "dq2"), True)
    assert "nor a smooth function lowers it" not in diagnosis.sentence
    written = diagnosis.to_dict()
    (stated,) = written["differs_between_recordings"]
    assert (stated["from"], stated["period"]) == (found.since, None)
    assert written["unexplained"][0]["depends_on"] == ["t", "dq2"]
    assert "Something changed during a.csv" in diagnosis.sentence
    value, std = found.parameters["f_c"], found.std["f_c"]
    assert abs(value - size) < 4.0 * std
    shown = f"f_c differs by {value_text(value, std)} ± {std_text(std)} N·m".replace("-", "−")
    assert shown in diagnosis.sentence


def later(recording, begin):
    """Return a recording whose clock begins at a time, s."""
    q, dq, tau = recording.q, recording.dq, recording.tau
    return lieid.Recording.from_arrays(recording.t + begin, q, dq, tau, name=recording.name)


@pytest.mark.parametrize("begin", [0.0, 1.7e9])  # as of a log that counts from 1970
def test_friction_that_changes_in_each_recording_is_one_change(begin):
    train = [measured(more_friction(0.3), seed=k, name=f"{k}.csv") for k in (1, 2)]
    diagnosis = lieid.diagnose(MODEL, [later(r, begin * k) for k, r in enumerate(train, start=1)])
    assert not diagnosis.steps
    (found,) = diagnosis.differing
    assert (found.label, found.recording) == ("coulomb:2", "each recording")
    assert found.since == pytest.approx(INSTANT, abs=0.1)


def test_an_instant_of_one_recording_is_that_of_its_clock():
    (found,) = lieid.diagnose(MODEL, later(measured(more_friction(0.6), seed=3), 500.0)).differing
    assert found.since == pytest.approx(500.0 + INSTANT, abs=0.1)


def test_what_differs_between_recordings_after_a_fit_is_no_change_of_the_arm():
    fit = lieid.identify(MODEL, measured(seed=2, name="before.csv"))
    more = measured(lambda s: 0.6 * s.sign[..., 1], seed=3, name="b.csv")
    diagnosis = lieid.diagnose(fit, [measured(seed=4, name="a.csv"), more])
    assert not diagnosis.steps
    (found,) = diagnosis.differing
    assert (found.label, found.recording, found.since) == ("coulomb:2", "b.csv", None)
    assert found.parameters["f_c"] == pytest.approx(0.6, rel=0.05)


def test_friction_that_changes_after_a_fit_is_a_change_of_that_recording_from_an_instant_on():
    fit = lieid.identify(MODEL, measured(seed=2, name="before.csv"))
    diagnosis = lieid.diagnose(fit, measured(more_friction(0.6), seed=3))
    assert not diagnosis.steps
    assert diagnosis.verdict == "unexplained"
    (found,) = diagnosis.differing
    assert (found.label, found.recording, found.of_model) == ("coulomb:2", "a.csv", True)
    assert found.since == pytest.approx(INSTANT, abs=0.1)
    assert found.parameters["f_c"] == pytest.approx(0.6, rel=0.05)
    assert [(part.joint, part.depends_on) for part in diagnosis.unexplained] == [(1, ("t", "dq2"))]


def test_a_torque_that_oscillates_with_time_is_stated_with_period_and_size():
    diagnosis = lieid.diagnose(MODEL, measured(wave, joint=0))
    assert not diagnosis.steps
    (found,) = diagnosis.differing
    assert (found.label, found.since) == ("offset:1", None)
    assert found.period == pytest.approx(PERIOD, rel=0.02)
    assert found.parameters["f_b"] == pytest.approx(AMPLITUDE, rel=0.1)
    assert [(part.joint, part.depends_on) for part in diagnosis.unexplained] == [(0, ("t",))]
    assert "oscillates with time" in diagnosis.sentence


def test_a_slow_wave_is_one_in_short_and_long_recordings():
    """It is slower than five half waves in the short one alone."""
    train = [measured(wave, seed=1, seconds=18.0), measured(wave, seed=2, seconds=36.0)]
    diagnosis = lieid.diagnose(MODEL, train)
    assert not diagnosis.steps
    (found,) = diagnosis.differing
    assert (found.label, found.recording) == ("offset:2", "each recording")
    assert found.period == pytest.approx(PERIOD, rel=0.02)
    assert found.parameters["f_b"] == pytest.approx(AMPLITUDE, rel=0.1)


def test_warming_up_is_no_sudden_change():
    arm = plant.demo_arm(ROBOT, hidden=None)
    arm = arm.with_effects(plant.hidden_effect(arm, "warm_up", 1, strength=1.0))
    diagnosis = lieid.diagnose(MODEL, recorded(arm, 1, **SERIES))
    assert [step.label for step in diagnosis.steps] == ["warm_up:2"]
    assert not diagnosis.differing
