"""Physically consistent parameters on recordings of real arms."""

import numpy as np
import pytest
from real_arms import PANDA, TX40, UR10E, needs, ur10e_run

import lieid_casadi as lieid
from lieid_casadi.errors import NotDissipativeWarning
from lieid_casadi.recording import Processing, process

EFFECTS = "coulomb,viscous,offset,armature"
pytestmark = pytest.mark.real


def ur10e():
    *train, test = (ur10e_run(f"excitation_{name}") for name in ("30s", "50s", "14_harmonics"))
    robot = lieid.Robot.from_urdf(UR10E / "ur10e.urdf")
    return robot, train, [test], Processing(cutoff=7.0)


def tx40():
    robot = lieid.Robot.from_urdf(TX40 / "tx40.urdf")
    run = lieid.Recording.load(TX40 / "excitation.csv.gz")
    blocks = [run.cut(1.2 * k, 1.2 * (k + 1)) for k in range(6)]
    processing = Processing(cutoff=20.0, trim=0.1)
    return robot, blocks[:2] + blocks[3:5], [blocks[2], blocks[5]], processing


def panda():
    fingers = ("panda_finger_joint1", "panda_finger_joint2")
    robot = lieid.Robot.from_urdf(PANDA / "panda.urdf", lock=fingers)
    run = lieid.Recording.load(PANDA / "excitation.csv.gz")
    middle = run.t[0] + 0.65 * run.duration
    return robot, [run.cut(None, middle)], [run.cut(middle, None)], Processing(cutoff=3.0)


def rms_on(fit, recordings):
    segments = process(recordings, fit.processing)
    errors = [s.filter(s.tau) - fit.predict_processed(s) for s in segments]
    return np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0))


@pytest.mark.parametrize(
    ("arm", "limit", "each"),
    [
        pytest.param(ur10e, 1.05, True, marks=needs(UR10E / "ur10e.urdf")),
        pytest.param(tx40, 1.05, True, marks=needs(TX40 / "tx40.urdf")),
        # 16 s at 29 Hz: on joint 4 least squares gives friction that drives the arm. What feasible
        # bodies gain on joint 1 least squares gain, too: links are near their stated bodies.
        pytest.param(panda, 1.1, False, marks=needs(PANDA / "panda.urdf")),
    ],
)
def test_feasible_costs_little_on_new_data(arm, limit, each):
    """RMS over all joints, each in units of its own noise, and where ``each`` of every joint."""
    robot, train, test, processing = arm()
    model = lieid.Model(robot, EFFECTS)
    least = lieid.identify(model, train, processing=processing)
    fit = lieid.identify(model, train, method="feasible", processing=processing)
    assert fit.certificate.holds
    wls, feasible = (rms_on(f, test) / least.noise for f in (least, fit))
    assert np.sqrt(np.mean(feasible**2)) < limit * np.sqrt(np.mean(wls**2))
    if each:
        assert np.all(feasible < limit * wls)


@needs(PANDA / "panda.urdf")
def test_friction_that_would_drive_a_joint_is_reported():
    """Friction of the Panda's fourth joint falls with speed; up to 2.2 rad/s is permitted."""
    robot, train, _, processing = panda()
    model = lieid.Model(robot, "coulomb,viscous,offset")
    fit = lieid.identify(model, train, method="feasible", processing=processing)
    messages = [str(w) for w in fit.warnings if isinstance(w, NotDissipativeWarning)]
    assert any(text.startswith("joint 4:") for text in messages)
    assert all("it is constrained to dissipate" in text for text in messages)
    fast = dict(zip([c.label for c in model.columns], fit.effect_coefficients, strict=True))
    assert fast["coulomb.f_c:4"] + 2.175 * fast["viscous.f_v:4"] >= 0.0


@needs(PANDA / "panda.urdf")
def test_a_solution_to_rounding_is_accepted():
    """With these effects the solver stops at a relative gap of 1e-7, as rounding permits."""
    robot, *_ = panda()
    train = lieid.Recording.load(f"{PANDA / 'excitation.csv.gz'}@0:15.6")
    effects = "coulomb,viscous,offset,torque_lowpass/second_order:7,presliding:5"
    processing = Processing(cutoff=3.0, trim=0.5)
    model = lieid.Model(robot, effects)
    fit = lieid.identify(model, train, method="feasible", processing=processing)
    assert fit.certificate.holds
