"""Identified payloads against those that the plant simulates, and ``lieid payload``."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from payload.loaded_plant import CUTOFF, MASS, PANDA, PAYLOAD, TRUTH, fitted, measured
from report.test_reports import FETCHING, Page
from robot.random_arms import random_arm, random_link

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.cli.main import main
from lieid_casadi.errors import (
    FrictionChangedWarning,
    IdentificationError,
    NegativeMassWarning,
    SameRecordingWarning,
)
from lieid_casadi.payload.estimate import (
    NAMES,
    identifiable_quantities,
    physical_jacobian,
    physical_quantities,
)
from lieid_casadi.robot.inertia import body_inertia

ARM = plant.demo_arm(PANDA, seed=1, hidden=None)
LOADED = ARM.with_effects(PAYLOAD)
SIX = ([0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2])  # xx, xy, yy, xz, yz, zz


@pytest.fixture(scope="module")
def fit():
    return fitted(ARM, name="monday.csv")


@pytest.fixture(scope="module")
def payload(fit):
    return lieid.identify_payload(fit, measured(LOADED, motion=7, seed=5))


def standardized_error(payload):
    """Return the error of each quantity in standard deviations."""
    return (payload.values - TRUTH) / payload.std


def test_all_ten_quantities_within_three_standard_deviations(payload):
    assert np.all(np.abs(standardized_error(payload)) < 3.0)
    assert payload.mass_std < 0.005
    assert np.all(payload.com_std < 0.5e-3)
    assert payload.warnings == ()
    assert payload.explained


@settings(max_examples=2, deadline=None)
@given(seed=st.integers(0, 1000), mass=st.floats(0.3, 5.0))
@example(seed=287, mass=1.0)  # its base parameters are sums of link parameters times up to 1e5
def test_exact_for_any_arm_without_noise(seed, mass):
    """Random geometries, prismatic joints and tool frames, any body, against Pinocchio."""
    rng = np.random.default_rng(seed)
    robot = random_arm(rng, 5)
    body = random_link(rng)
    body *= mass / body[0]
    still = plant.JointFriction.none(robot.n)
    arm = plant.Arm(robot, robot.link_parameters, still)
    loaded = replace(arm, parameters=plant.with_payload(robot, arm.parameters, body))
    ideal = plant.Sensors(rate=200.0)
    fit = lieid.identify(lieid.Model(robot), measured(arm, sensors=ideal), processing=CUTOFF)
    found = lieid.identify_payload(fit, measured(loaded, motion=9, sensors=ideal))
    identified = np.isfinite(found.values)
    assert identified[0]
    truth = body_inertia(body)
    expected = np.array([truth.mass, *truth.com, *truth.inertia[SIX]])
    assert np.allclose(found.values[identified], expected[identified], rtol=2e-3, atol=1e-3 * mass)


def test_uncertainty_of_the_fit_is_included(fit):
    """A fit from a shorter training increases the standard deviations of the same loaded run."""
    loaded = measured(LOADED, motion=7, seed=5)
    known = replace(fit, covariance=np.zeros_like(fit.covariance))
    short = fitted(ARM, seconds=6.0, motion=3)
    exact, usual, poor = (lieid.identify_payload(f, loaded) for f in (known, fit, short))
    assert np.all(usual.std > exact.std)
    assert poor.mass_std > 1.5 * usual.mass_std
    assert np.all(np.abs(standardized_error(poor)) < 3.5)


@pytest.mark.slow
def test_intervals_cover_the_truth():
    """16 fits and loaded runs with different motions and noise: 90-99 % of 160 quantities."""
    errors = []
    for seed in range(16):
        fit = fitted(ARM, motion=10 * seed + 4, seed=seed)
        loaded = measured(LOADED, motion=10 * seed + 7, seed=1000 + seed)
        errors.append(np.abs(standardized_error(lieid.identify_payload(fit, loaded))))
    z = np.array(errors)
    inside = z < 1.96
    assert 0.9 <= inside.mean() <= 0.99
    assert np.mean(z > 3.0) <= 0.02


def test_friction_that_has_changed_is_identified_again(fit):
    friction = replace(ARM.friction, coulomb=1.3 * ARM.friction.coulomb)
    warm = replace(ARM, friction=friction).with_effects(PAYLOAD)
    loaded = measured(warm, motion=7, seed=5)
    found = lieid.identify_payload(fit, loaded)
    (warning,) = [w for w in found.warnings if isinstance(w, FrictionChangedWarning)]
    assert f"→ {1.3 * ARM.friction.coulomb[1]:.2g}" in str(warning)
    assert np.all(np.abs(standardized_error(found)) < 3.0)
    assert np.all(found.rms_after < 1.2 * found.rms_fit)


@pytest.mark.slow
def test_negative_mass_is_reported():
    fit = fitted(LOADED)
    found = lieid.identify_payload(fit, measured(ARM, motion=7, seed=5))
    assert found.mass == pytest.approx(-MASS, abs=4 * found.mass_std)
    assert any(isinstance(w, NegativeMassWarning) for w in found.warnings)
    assert "less than the fit includes" in found.sentence


def test_a_planar_arm_identifies_four_quantities():
    robot = lieid.robots.two_link()
    arm = plant.demo_arm(robot, seed=2, hidden=None)
    body = plant.Payload(mass=1.5, com=(0.1, 0.05, 0.0), radius=0.1)
    found = lieid.identify_payload(fitted(arm), measured(arm.with_effects(body), motion=7, seed=5))
    known = {name for name, value in zip(NAMES, found.values, strict=True) if np.isfinite(value)}
    assert known == {"mass", "com_x", "com_y", "Izz"}
    assert found.mass == pytest.approx(1.5, abs=3 * found.mass_std)
    reasons = {part.name: part.reason for part in found.not_identified}
    assert "does not depend on" in reasons["com_z"]


def test_a_training_recording_is_reported(fit):
    found = lieid.identify_payload(fit, measured(ARM, name="monday.csv"))
    assert any(isinstance(w, SameRecordingWarning) for w in found.warnings)


@pytest.mark.parametrize("factor", [1.0, pytest.param(2.0, marks=pytest.mark.slow)])
def test_another_arm_is_reported(fit, factor):
    """An arm with inertias within 20 %, or twice as large: not explained by a payload."""
    other = plant.demo_arm(PANDA, seed=50, hidden=None)
    other = replace(other, parameters=factor * other.parameters)
    found = lieid.identify_payload(fit, measured(other, motion=7))
    assert not found.explained
    assert found.sentence.startswith("A payload does not explain this run")


def test_two_payloads_in_one_recording_are_refused(fit):
    run = measured(LOADED, motion=7)
    labels = ["none"] * (len(run) // 2) + ["2 kg"] * (len(run) - len(run) // 2)
    with pytest.raises(
        IdentificationError, match=r"column load contains 2 payloads \(none, 2 kg\)"
    ):
        lieid.identify_payload(fit, replace(run, payload_label=tuple(labels)))


def test_motion_about_the_vertical_does_not_identify_mass(fit):
    """Joint 1 alone is loaded only by the moment of inertia about its own axis."""
    t = np.arange(0.0, 20.0, 0.001)
    q, dq, ddq = np.tile([0, 0.5, 0, -1.5, 0, 1.8, 0.3], (len(t), 1)), *np.zeros((2, len(t), 7))
    rate = 2 * np.pi * 0.3
    q[:, 0], dq[:, 0] = np.sin(rate * t), rate * np.cos(rate * t)
    ddq[:, 0] = -(rate**2) * np.sin(rate * t)
    turning = plant.measure_along(LOADED, t, q, dq, ddq, sensors=plant.demo_sensors(PANDA))
    found = lieid.identify_payload(fit, turning)
    assert {part.name for part in found.not_identified} == set(NAMES)
    assert np.isnan(found.values).all()
    assert found.to_dict()["mass"] is None
    assert found.sentence == "The mass of the payload cannot be identified from this motion."


numbers = st.floats(-1.0, 1.0, allow_subnormal=False)
bodies = st.tuples(
    st.floats(0.1, 20.0), st.tuples(numbers, numbers, numbers), st.tuples(*[numbers] * 6)
).map(lambda parts: np.array([parts[0], *parts[1], *parts[2]]))


@given(bodies)
def test_jacobian_against_central_differences(parameters):
    step = 1e-6
    numeric = [
        (
            physical_quantities(parameters + step * unit)
            - physical_quantities(parameters - step * unit)
        )
        / (2 * step)
        for unit in np.eye(10)
    ]
    size = 1.0 + np.abs(physical_jacobian(parameters)).max()
    assert np.allclose(physical_jacobian(parameters), np.transpose(numeric), atol=1e-6 * size)


def test_a_hidden_first_moment_hides_five_quantities():
    hidden = {
        name
        for name, visible in zip(NAMES, identifiable_quantities(np.eye(10)[2:3]), strict=True)
        if not visible
    }
    assert hidden == {"com_y", "Ixx", "Ixy", "Iyz", "Izz"}


ROBOT = lieid.robots.two_link()
TWO_LINK_ARM = plant.demo_arm(ROBOT, seed=2, hidden=None)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("payload")
    fitted(TWO_LINK_ARM).save(folder / "fit.json")
    measured(TWO_LINK_ARM.with_effects(PAYLOAD), motion=7, seed=5).save(folder / "loaded.csv")
    return folder


def lieid_payload(*words):
    return main(["payload", *map(str, words)])


def test_table_json_and_report(files, tmp_path, capsys):
    out, page = tmp_path / "p.json", tmp_path / "p.html"
    words = [files / "fit.json", files / "loaded.csv"]
    words += ["--json", out, "--html", page]
    assert lieid_payload(*words) == 0
    shown = capsys.readouterr().out
    sentence = next(line for line in shown.splitlines() if line.startswith("Payload "))
    assert sentence.startswith(("Payload 1.99", "Payload 2.00"))
    assert "not identified: com_z" in shown
    content = json.loads(out.read_text())
    assert content["mass"] == pytest.approx(2.0, abs=4 * content["std"]["mass"])
    assert content["com"][2] is None
    assert content["std"]["com"][2] is None
    assert len(content["inertia"]) == len(content["std"]["inertia"]) == 6
    low, high = content["interval_95"]["mass"]
    assert low < content["mass"] < high
    assert {part["name"] for part in content["not_identified"]} >= {"com_z", "Ixx"}
    assert len(content["rms_before"]) == len(content["rms_after"]) == ROBOT.n
    assert content["warnings"] == []
    html = Page(page.read_text())
    assert sentence[:20] in "".join(html.text)
    assert not [v for n in FETCHING for v in html.values(n) if not v.startswith(("data:", "#"))]


def test_currents_with_torque_constants(files, tmp_path):
    run = lieid.Recording.load(files / "loaded.csv")
    constants = np.array([11.0, 9.0])
    amperes = lieid.Recording.from_arrays(run.t, run.q, run.dq, current=run.tau / constants)
    amperes.save(tmp_path / "amperes.csv")
    found = []
    for words in ([files / "loaded.csv"], [tmp_path / "amperes.csv", "--torque-constants=11,9"]):
        assert lieid_payload(files / "fit.json", *words, "--json", tmp_path / "p.json") == 0
        found.append(json.loads((tmp_path / "p.json").read_text())["mass"])
    assert found[0] == pytest.approx(found[1], rel=1e-9)
