"""What corrects a premise, composed and from options; masses far from those that are stated."""

from dataclasses import replace

import numpy as np
import pytest
from hidden_effects.arms import load_arm
from plant.recordings import recorded
from scipy.interpolate import CubicSpline

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.errors import StatedMassWarning
from lieid_casadi.premises.correction import base_rpy, correction_of, gravity_of
from lieid_casadi.premises.findings import Wrong, findings_of
from lieid_casadi.premises.plain_fit import samples_of
from lieid_casadi.premises.screen import Alternative, RigidArm
from lieid_casadi.robot.inertia import pose

RANDOM = np.random.default_rng(3)
OPTIONS = (
    "--torque-sign 1 -1 1",
    "--joint-order 3 1 2",
    "--joint-sign 1 1 -1",
    "--joint-coupling 3+2",
    "--joint-zero 0.1 0 -1.5",
)


def recording(n=3, rows=400):
    t = np.arange(rows) / 100.0
    phase = np.outer(t, 1.0 + 0.3 * np.arange(n))
    return lieid.Recording.from_arrays(t, np.sin(phase), tau=10.0 * np.cos(2.0 * phase))


@pytest.mark.parametrize("name", ["panda", "rail"])
def test_columns_are_those_of_the_compiled_regressor(name):
    robot = load_arm(name)
    moved = pose([0.1, -0.2, 0.3], [0.5, 1.0, -0.7])  # axes beside the origins of link frames
    joints = tuple(replace(joint, home=joint.home @ moved) for joint in robot.joints)
    robot = replace(robot, joints=joints, source=None)
    q, dq, ddq = RANDOM.standard_normal((3, 40, robot.n))
    gravity = np.array([1.0, -2.0, 9.0])
    arm = RigidArm.of(robot)
    own = arm.columns(q, dq, ddq, gravity).transpose(2, 0, 1)
    turned = lieid.compile(lieid.Robot(robot.name, robot.joints, gravity))
    whole = turned.regressor(q, dq, ddq)
    np.testing.assert_allclose(own, whole[:, :, arm.kept], atol=1e-12)
    np.testing.assert_allclose(own @ arm.combination, whole, atol=1e-9)


@pytest.mark.parametrize("rpy", RANDOM.uniform(-1.4, 1.4, (5, 3)))
def test_gravity_of_a_mounting(rpy):
    down = pose([0, 0, 0], rpy)[:3, :3].T @ [0.0, 0.0, -9.81]
    np.testing.assert_allclose(gravity_of(tuple(rpy)), down, atol=1e-12)
    np.testing.assert_allclose(gravity_of(base_rpy(down)), down, atol=1e-12)


def test_options_one_after_the_other_and_together():
    given = recording()
    together = correction_of(OPTIONS[::-1], 3).of_recording(given)
    for text in OPTIONS:
        given = correction_of([text], 3).of_recording(given)
    np.testing.assert_allclose(together.q, given.q, atol=1e-12)
    np.testing.assert_allclose(together.tau, given.tau, atol=1e-12)
    assert together.corrections == given.corrections == OPTIONS


def test_recordings_and_samples_are_corrected_alike():
    correction = correction_of([*OPTIONS, "--time-offset 0.02"], 3)
    samples = correction.of_samples(samples_of([recording()]))
    corrected = samples_of([correction.of_recording(recording())])
    inside = (samples.t > corrected.t[3]) & (samples.t < corrected.t[-4])
    for name, tolerance in (("q", 0.02), ("tau", 0.3)):
        expected = CubicSpline(corrected.t, getattr(corrected, name))(samples.t[inside])
        np.testing.assert_allclose(getattr(samples, name)[inside], expected, atol=tolerance)


def wrong(premise, option, value=None):
    """What is wrong, in three joints whose errors fall to half, and the option that corrects it."""
    what, again = (f"{text} with {{}}" for text in ("Found", "In another order"))
    correction = correction_of([option], 3)
    alternative = Alternative(premise, (), value or {}, what, correction, again=again)
    return Wrong(alternative, np.ones(3), np.full(3, 0.5), np.full(3, 0.5))


@pytest.mark.parametrize(
    "texts",
    [
        ("--joint-order 3 1 2", "--torque-sign 1 -1 1"),
        ("--joint-order 3 1 2", "--joint-sign 1 -1 1", "--joint-zero 0 0.5 0"),
        ("--joint-sign 1 -1 1", "--joint-order 2 1 3", "--joint-coupling 3+2"),
        ("--joint-coupling 3-2", "--joint-order 3 2 1", "--joint-sign -1 1 1"),
        ("--joint-zero 0 0.5 0", "--joint-order 3 1 2", "--time-offset 0.02"),
        ("--joint-sign 1 -1 1", "--joint-sign 1 1 -1"),
        ("--torque-sign 1 1 -1", "--joint-order 1 3 2", "--torque-sign 1 1 -1"),
    ],
)
def test_remedies_of_findings_one_after_the_other_hold_together(texts):
    given = recording()
    found = [wrong(f"{k}", text) for k, text in enumerate(texts)]
    made = findings_of(found, given)
    words = " ".join(finding.remedy for finding in made).split("--")[1:]
    together = correction_of({f"--{word.strip()}" for word in words}, 3).of_recording(given)
    for text in texts:
        given = correction_of([text], 3).of_recording(given)
    np.testing.assert_allclose(together.q, given.q, atol=1e-9)
    np.testing.assert_allclose(together.tau, given.tau, atol=1e-6)
    assert all(finding.remedy in finding.sentence for finding in made)


def test_an_order_found_in_two_steps_is_one_finding_and_what_is_taken_back_is_none():
    texts = (
        "--joint-order 2 1 3",
        "--joint-sign 1 1 -1",
        "--joint-order 3 2 1",
        "--joint-sign -1 1 1",
    )
    found = [
        wrong(text.split()[0], text, {"signals": "all", "order": []} if "order" in text else {})
        for text in texts
    ]
    (made,) = findings_of(found, recording())
    assert made.remedy == "--joint-order 3 1 2"
    assert made.value["order"] == [3, 1, 2]
    assert made.joints == (0, 1, 2)
    assert made.sentence == (
        "In another order with --joint-order 3 1 2 the error of joints 1–3 falls from 1 1 1 to "
        "0.5 0.5 0.5 N·m."
    )


def test_power_stays_the_same():
    given = recording()
    speed = np.gradient(given.q, given.t, axis=0)
    made = correction_of(OPTIONS[1:], 3).of_recording(given)
    corrected = np.gradient(made.q, made.t, axis=0)
    np.testing.assert_allclose(
        np.sum(made.tau * corrected, axis=1), np.sum(given.tau * speed, axis=1), atol=1e-9
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("--joint-order 1 1 3", "numbers 1 to 3"),
        ("--joint-order 1 2", "numbers 1 to 3"),
        ("--joint-sign 1 2 1", "3 times 1 or -1"),
        ("--joint-zero 0 0 nan", "3 angles"),
        ("--joint-coupling 3*2", "couplings such as"),
        ("--joint-coupling 9+2", "couplings such as"),
        ("--time-offset x", "late, s"),
        ("--base-rpy 0 0", "roll, pitch and yaw"),
        ("--upside-down", "unknown correction"),
    ],
)
def test_values_that_an_option_does_not_take(text, expected):
    with pytest.raises(lieid.LieidError, match=expected):
        correction_of([text], 3)


ROBOT = lieid.robots.two_link()


@pytest.fixture(scope="module")
def run():
    sensors = plant.demo_sensors(ROBOT, rate=100.0)
    return recorded(plant.demo_arm(ROBOT, hidden=None), 1, step=0.01, sensors=sensors, name="run")


@pytest.mark.parametrize(("factor", "far"), [(1.0, False), (8.0, True)])
def test_masses_far_from_the_stated_ones_are_a_warning(run, factor, far):
    scaled = replace(run, tau=factor * run.tau)
    fit = lieid.identify(lieid.Model(ROBOT), scaled, method="feasible", regularization=1e-4)
    found = [w for w in fit.warnings if isinstance(w, StatedMassWarning)]
    assert len(found) == far
    assert not far or "3 kg by the description" in str(found[0])
    stated = ROBOT.link_parameters
    g = 9.81 * stated[11] * np.cos(run.q.sum(axis=1))  # of link 2 on joint 2, about its axis
    load = np.sqrt(np.mean(g**2))
    np.testing.assert_allclose(fit.certificate.stated_gravity[1], load, rtol=0.05)
    np.testing.assert_allclose(fit.certificate.gravity[1], factor * load, rtol=0.3)
    assert "Gravity load that the recordings showed" in fit.certificate.summary()
