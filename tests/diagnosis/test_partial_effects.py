"""Effects that smooth functions could imitate: named if they explain as much, else listed."""

from functools import cache

import numpy as np

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.diagnosis import DiagnosisOptions
from lieid_casadi.diagnosis.screening.held_out import HeldOut

ROBOT = lieid.robots.two_link()
MODEL = lieid.Model(ROBOT, "coulomb,viscous,offset")
ARM = plant.demo_arm(ROBOT, hidden=None)
COULOMB, SCALE = ARM.friction.coulomb[1], plant.torque_scale(ROBOT)[1]


def two_harmonics(s, second=0.2):
    q = s.q[..., 1]
    return COULOMB * (0.9 * np.sin(q + 0.4) + second * np.sin(4.0 * q)) * s.sign[..., 1]


def larger_second_harmonic(s):
    return two_harmonics(s, 0.4)


def settling(s):
    return 0.1 * SCALE * (1.0 - np.exp(-s.t / 10.0)) * np.ones(s.q.shape[:-1])


def bump(s):
    return 0.3 * SCALE / (1.0 + ((s.q[..., 1] - 0.3) / 0.15) ** 2)


@cache
def run(torque, seed, duration):
    arm = ARM.with_effects(plant.ForeignTorque(1, torque))
    motion = plant.FourierTrajectory(ROBOT, base_frequency=1.0 / duration, seed=seed)
    t = np.arange(0.0, duration, 0.002)
    return plant.measure_along(arm, t, *motion.at(t), sensors=plant.demo_sensors(ROBOT), seed=seed)


def test_an_effect_that_explains_nearly_as_much_as_smooth_functions_is_named():
    train, label = run(two_harmonics, 1, 40.0), "position_friction:2"
    assert [s.label for s in lieid.diagnose(MODEL, train).steps] == [label]
    strict = lieid.diagnose(MODEL, train, options=DiagnosisOptions(least_part_of_smooth=np.inf))
    assert strict.steps == ()
    reasons = dict(strict.rejected)
    assert "of what smooth functions of" in reasons[label]
    (part,) = strict.unexplained
    (candidate,) = [c for c in part.candidates if c.label == label]
    assert candidate.part > 0.7
    assert candidate.reason == reasons[label]


def test_an_effect_that_leaves_a_third_of_the_error_of_its_own_signals_is_not_named():
    """The first harmonic explains 84 % of the variance that smooth functions explain."""
    diagnosis = lieid.diagnose(MODEL, run(larger_second_harmonic, 1, 40.0))
    assert diagnosis.steps == ()
    part = diagnosis.unexplained[0]
    assert part.joint == 1
    assert set(part.depends_on[:2]) == {"q2", "dq2"}
    (candidate,) = [c for c in part.candidates if c.label == "position_friction:2"]
    assert 0.7 < candidate.part < 0.9


def stribeck_and_bump(s):
    dq = s.dq[..., 1]
    return 3.0 * COULOMB * np.exp(-((dq / 0.1) ** 2)) * s.sign[..., 1] + 0.3 * bump(s)


def test_an_effect_beside_a_torque_of_its_joint_needs_held_out_data_that_can_judge_it(monkeypatch):
    train, label = run(stribeck_and_bump, 1, 20.0), "stribeck:2"
    found = lieid.diagnose(MODEL, train)
    assert [s.label for s in found.steps] == [label]
    assert found.unexplained[0].depends_on[0] == "q2"
    monkeypatch.setattr(HeldOut, "is_confirmed", property(lambda self: False))
    refused = lieid.diagnose(MODEL, train)
    assert refused.steps == ()
    assert "nothing that held-out data confirm in addition" in dict(refused.rejected)[label]


def test_a_torque_that_settles_changes_over_the_recording():
    """It is neither a drift at a constant rate, nor a function of the joints' motion."""
    diagnosis = lieid.diagnose(MODEL, run(settling, 1, 60.0))
    assert diagnosis.steps == ()
    (part,) = diagnosis.unexplained
    assert (part.joint, part.depends_on) == (1, ("t",))
    assert part.formula is None


def test_a_torque_on_one_joint_is_not_unexplained_on_the_others():
    """The inertias that both joints share move with it."""
    diagnosis = lieid.diagnose(MODEL, run(bump, 1, 20.0))
    (part,) = diagnosis.unexplained
    assert (part.joint, part.depends_on) == (1, ("q2",))
    listed = diagnosis.to_dict()["unexplained"][0]["candidates"]
    assert [c["joints"] for c in listed] == [[2]] * len(listed)
    assert all(0.0 < c["part"] <= 1.0 and c["reason"] for c in listed)
