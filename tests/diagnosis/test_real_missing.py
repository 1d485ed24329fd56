"""Missing effects of real arms: by what the search alone does not find."""

import pytest
from real_arms import FINGERS, PANDA, UR10E, needs

import lieid_casadi as lieid
from lieid_casadi.recording import Processing


def diagnosis_of_first(seconds, cutoff):
    """Return the diagnosis of the first seconds of a UR10e, tested on 50 s of other motion."""
    return diagnosis_of(f"excitation_30s.csv.gz@0:{seconds}", cutoff)


def diagnosis_of(part, cutoff):
    robot = lieid.Robot.from_urdf(UR10E / "ur10e.urdf")
    model = lieid.Model(robot, "coulomb,viscous,offset,armature")
    train, test = (
        lieid.Recording.load(f"{UR10E}/{name}") for name in (part, "excitation_50s.csv.gz")
    )
    return lieid.diagnose(model, train, test, processing=Processing(cutoff=cutoff))


@pytest.mark.slow
@needs(UR10E / "ur10e.urdf")
@pytest.mark.parametrize(("seconds", "cutoff"), [(16, 9.8), (20, 7.0)])
def test_presliding_of_most_joints_is_found_on_all_joints_of_short_recordings(seconds, cutoff):
    """Among all candidates, delays and polynomials of joint 6 share its torque.

    On the first joint the rows near reversals show it, which count less where friction there is not
    known from other joints.
    """
    diagnosis = diagnosis_of_first(seconds, cutoff)
    steps = {step.joint: step for step in diagnosis.steps if step.effect == "presliding"}
    assert set(steps) == set(range(6))
    assert steps[0].confirmed
    assert steps[5].confirmed
    assert steps[0].fall.test > 0.05  # N·m
    assert steps[5].fall.test > 0.04


@pytest.mark.slow
@needs(UR10E / "ur10e.urdf")
@pytest.mark.filterwarnings("ignore::lieid_casadi.errors.LieidWarning")  # 16 s are short
@pytest.mark.parametrize("cutoff", [4.0, 6.0])
def test_a_rival_stands_for_an_effect_whose_shape_the_motion_does_not_resolve(cutoff):
    """In the next round it is not certain alone: joint 1 had no friction over speed."""
    diagnosis = diagnosis_of_first(16, cutoff)
    assert dict(diagnosis.rejected)["stribeck:1"].startswith("v_s = ")  # at an end of its range
    (base,) = [s for s in diagnosis.steps if (s.effect, s.joint) == ("viscous_polynomial", 0)]
    assert base.status == "one_of"
    assert base.fall.test > 0.2 * diagnosis.baseline["rms_test_moving"][0]


@pytest.mark.slow
@needs(UR10E / "ur10e.urdf")
@pytest.mark.filterwarnings("ignore::lieid_casadi.errors.LieidWarning")  # 20 s are short
def test_a_filter_that_is_not_supported_does_not_keep_presliding_out_of_the_model():
    """One filter of all torques gains most at first, and no more than late friction."""
    diagnosis = diagnosis_of("excitation_14_harmonics.csv.gz@27:47", 7.0)
    effects = [step.effect for step in diagnosis.steps]
    assert effects.count("presliding") >= 4
    assert not {"torque_lowpass", "torque_delay", "time_shift"} & set(effects)
    fall = (
        1.0 - diagnosis.steps[-1].errors["rms_test_moving"] / diagnosis.baseline["rms_test_moving"]
    )
    assert (fall[1:] > 0.2).all()  # joint 1 has friction over speed that this part hardly shows
    assert fall[0] > 0.0


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
