"""Missing effects of real arms: by what the search alone does not find."""

import pytest
from real_arms import FINGERS, PANDA, UR10E, needs

import lieid_casadi as lieid
from lieid_casadi.recording import Processing


def diagnosis_of_16_s(cutoff):
    """Return the diagnosis of the first 16 s of a UR10e, tested on 50 s of other motion."""
    robot = lieid.Robot.from_urdf(UR10E / "ur10e.urdf")
    model = lieid.Model(robot, "coulomb,viscous,offset,armature")
    train, test = (
        lieid.Recording.load(f"{UR10E}/{name}")
        for name in ("excitation_30s.csv.gz@0:16", "excitation_50s.csv.gz")
    )
    return lieid.diagnose(model, train, test, processing=Processing(cutoff=cutoff))


@pytest.mark.slow
@needs(UR10E / "ur10e.urdf")
def test_presliding_of_most_joints_is_found_on_the_wrist_of_a_short_recording():
    """Among all candidates, delays and polynomials of joint 6 share its torque."""
    diagnosis = diagnosis_of_16_s(7.0)
    joints = {step.joint for step in diagnosis.steps if step.effect == "presliding"}
    assert {1, 2, 3, 4, 5} <= joints
    (wrist,) = [s for s in diagnosis.steps if (s.effect, s.joint) == ("presliding", 5)]
    assert wrist.confirmed
    assert wrist.fall.test > 0.04  # N·m


@pytest.mark.slow
@needs(UR10E / "ur10e.urdf")
@pytest.mark.filterwarnings("ignore::lieid_casadi.errors.LieidWarning")  # 16 s are short
def test_an_effect_returns_where_the_form_in_its_place_leaves_the_model():
    """`stribeck/exponent` takes its place, and is not determined in the final model."""
    diagnosis = diagnosis_of_16_s(4.9)
    assert "stribeck/exponent:1" in dict(diagnosis.rejected)
    (base,) = [step for step in diagnosis.steps if step.joint == 0]
    assert base.effect == "viscous_polynomial"
    assert base.fall.test > 0.2 * diagnosis.baseline["rms_test_moving"][0]


@pytest.mark.slow
@needs(PANDA / "panda.urdf")
@pytest.mark.filterwarnings("ignore::lieid_casadi.errors.LieidWarning")  # 13 s are short
def test_hysteresis_that_resembles_a_filter_is_found_by_the_fit():
    robot = lieid.Robot.from_urdf(PANDA / "panda.urdf", lock=FINGERS)
    train, test = (
        lieid.Recording.load(f"{PANDA}/excitation.csv.gz@{part}") for part in ("0:13", "15.6:")
    )
    model = lieid.Model(robot, "coulomb,viscous,offset")
    diagnosis = lieid.diagnose(model, train, test, processing=Processing(cutoff=3.0))
    (wrist,) = [step for step in diagnosis.steps if step.joint == 6]
    assert (wrist.effect, wrist.status) == ("presliding", "one_of")
    assert "torque_lowpass" in {rival.effect for rival in wrist.rivals}
    assert wrist.fall.test > 0.15 * diagnosis.baseline["rms_test_moving"][6]
