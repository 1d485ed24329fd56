"""The closed loop on a simulated arm with a hidden effect."""

import json
from dataclasses import replace

import numpy as np
import pytest
from experiments.arms import QUICK, ROBOT, arm, measured, recorder, sines

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.diagnosis import Difference, Rival
from lieid_casadi.diagnosis.step import Unexplained
from lieid_casadi.effects import REGISTER
from lieid_casadi.errors import NoSolution, OutputError, PremiseError
from lieid_casadi.experiments import motion
from lieid_casadi.experiments.motion import MotionDesign
from lieid_casadi.experiments.purpose import Purpose, growth, open_groups, purposes, remaining
from lieid_casadi.report import experiment_report


@pytest.fixture(scope="module")
def given():
    return sines(arm())


@pytest.fixture(scope="module")
def done(given, tmp_path_factory):
    """Return an experiment from sines that leave two effects open, and its motions."""
    record, motions = recorder(arm())
    folder = tmp_path_factory.mktemp("experiment") / "out"
    return lieid.experiment(ROBOT, given, record=record, folder=folder, **QUICK), motions


def test_names_the_hidden_effect(done):
    result, _ = done
    before, after = result.rounds
    assert before.open[0] == ("stribeck:1", "viscous_polynomial:1")
    assert result.stopped == "all_named"
    assert after.named == ("stribeck:1",)
    assert len(result.diagnosis.train) == 2  # the given recording stays
    hidden = arm().effects[0]
    (step,) = result.diagnosis.steps
    assert step.parameters["f_s-f_c"] == pytest.approx(hidden.extra, rel=0.1)
    assert step.parameters["v_s"] == pytest.approx(hidden.velocity, rel=0.1)
    assert after.error[0] < 0.5 * after.unseen[0]
    # the short motion, 5 s after 3 s of probe, shows more per second than one of 10 s
    assert result.seconds == pytest.approx(8.0)


def test_motions_are_within_limits_and_begin_with_the_probe(done):
    _, (motion,) = done
    s = motion.samples
    assert np.all(np.abs(s.q) <= ROBOT.limit("position_upper"))
    assert np.all(np.abs(s.dq) <= 0.8 * ROBOT.limit("velocity") + 1e-9)
    nominal = plant.Arm(ROBOT, ROBOT.link_parameters, plant.JointFriction.none(2))
    torque = plant.measure_along(nominal, s.t, s.q, s.dq, s.ddq).tau
    assert np.all(np.abs(torque) <= 0.8 * ROBOT.limit("torque"))
    numeric = np.gradient(s.q, s.t, axis=0)
    assert np.abs(numeric - s.dq).max() < 0.01
    end_of_probe = np.searchsorted(s.t, motion.probe)
    for row in (0, end_of_probe, -1):
        assert np.allclose(s.q[row], s.q[0], atol=1e-9)
        assert np.allclose(s.dq[row], 0.0, atol=1e-9)
    assert any("torque" in text for text in motion.checked)
    assert any("surroundings" in text for text in motion.unchecked)


def test_folder_holds_every_round(done):
    result, (motion,) = done
    content = json.loads((result.folder / "experiment.json").read_text())
    assert content.pop("schema") == 1
    assert content.pop("identity")["robot"] == "two_link"
    assert content == json.loads(json.dumps(result.to_dict()))
    names = {path.name for path in (result.folder / "round-1").iterdir()}
    assert names == {"trajectory.csv", "recording.csv", "diagnosis.json", "fit.json"}
    assert {path.name for path in result.folder.iterdir()} == {"experiment.json", "round-1"}
    lines = (result.folder / content["rounds"][1]["trajectory"]).read_text().splitlines()
    assert f"# not checked: {motion.unchecked[-1]}" in lines
    fit = lieid.Fit.load(result.folder / "round-1" / "fit.json")
    assert "stribeck:1" in fit.model.effects


def test_views(done):
    result, _ = done
    page = experiment_report(result)
    plan = "8 s of motion; a fixed plan of 1 standard excitation of 13 s takes 13 s."
    assert plan in page
    assert plan in result.sentences[0]
    assert result.to_dict()["fixed_plan_seconds"] == 13.0
    assert replace(result, rounds=result.rounds[:1]).sentences[0] == result.reason
    assert "stribeck:1 or viscous_polynomial:1" in page
    assert "surroundings other than the stated ones" in page
    assert result.plot().axes[0].get_xlabel() == "round"
    assert "all_named" in repr(result)
    assert "<table>" in result._repr_html_()


def test_a_second_call_resumes(done, given):
    result, _ = done

    def record(motion):
        raise AssertionError("nothing is left to be recorded")

    again = lieid.experiment(ROBOT, given, record=record, folder=result.folder, **QUICK)
    assert again.to_dict() == result.to_dict()
    with pytest.raises(OutputError, match="another probe"):
        lieid.experiment(ROBOT, given, record=record, folder=result.folder, seed=3, **QUICK)


def test_what_no_motion_separates_ends_with_the_reason(given, tmp_path, monkeypatch):
    def none(self, *arguments, **options):
        raise NoSolution("the best motion would have to run for 900 s")

    monkeypatch.setattr(MotionDesign, "next", none)
    record, motions = recorder(arm())
    result = lieid.experiment(ROBOT, given, record=record, folder=tmp_path, **QUICK)
    assert (result.stopped, motions) == ("not_separable", [])
    assert "stribeck:1 or viscous_polynomial:1: not separated." in result.reason
    assert "have to run for 900 s" in result.reason
    assert json.loads((tmp_path / "experiment.json").read_text())["reason"] == result.reason


@pytest.mark.slow
def test_a_recording_of_another_unit_is_refused(given, tmp_path):
    record, _ = recorder(arm())

    def degrees(motion):
        recording = record(motion)
        return replace(recording, q=np.degrees(recording.q), dq=np.degrees(recording.dq))

    with pytest.raises(PremiseError, match="do not belong together"):
        lieid.experiment(ROBOT, given, record=degrees, folder=tmp_path, **QUICK)
    assert not (tmp_path / "round-1" / "recording.csv").exists()


def test_a_joint_at_rest_has_no_error(tmp_path):
    """A given recording in which joint 2 is held."""
    given, still = sines(arm()), np.array([1.0, 0.0])
    t, q = given.t, np.array([0.6, 0.5]) + still * (given.q - np.array([0.6, 0.5]))
    held = measured(arm(), t, q, still * given.dq, still * np.gradient(given.dq, t, axis=0))
    record, _ = recorder(arm())
    result = lieid.experiment(ROBOT, held, record=record, most=0, folder=tmp_path, **QUICK)
    assert (result.stopped, result.rounds[0].error[1]) == ("most", 0.0)
    assert "(joint 1)" in str(result.table())
    assert result.plot().axes


def test_folder_of_something_else_is_refused(given, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    record, _ = recorder(arm())
    with pytest.raises(OutputError, match="not empty"):
        lieid.experiment(ROBOT, given, record=record, folder=tmp_path, **QUICK)


@pytest.fixture(scope="module")
def ambiguous(given):
    """Return a diagnosis that does not separate two effects."""
    found = lieid.diagnose(lieid.Model(ROBOT, "coulomb,viscous,offset"), given)
    step = next(step for step in found.steps if step.label == "stribeck:1")
    rival = Rival("viscous_polynomial:1", "viscous_polynomial", (0,), "data")
    only = replace(step, status="one_of", rivals=(rival,))
    return replace(found, steps=(only,), unexplained=(), undecided=())


def test_purposes(ambiguous):
    groups = (("stribeck:1", "viscous_polynomial:1"),)
    excitation, rivals, further = purposes(ambiguous, [])
    assert (excitation.kind, rivals.kind, rivals.groups) == ("excitation", "rivals", groups)
    assert (further.kind, further.groups) == ("evidence", (("stribeck:1",),))  # without a motion
    assert purposes(ambiguous, [excitation]) == [rivals, further]
    # two motions did not decide, nor did a further excitation
    assert purposes(ambiguous, [excitation, rivals, rivals, further]) == []
    assert remaining(ambiguous) == ["stribeck:1 or viscous_polynomial:1: not separated."]
    (step,) = ambiguous.steps
    same = replace(step, rivals=(Rival("armature:1", "armature", (0,), "exact"),))
    exact = replace(ambiguous, steps=(same,))
    assert [p.kind for p in purposes(exact, [])] == ["excitation"]
    assert open_groups(exact) == [("stribeck:1", "armature:1")]
    assert remaining(exact) == ["No data can separate stribeck:1 from armature:1."]
    alone = replace(ambiguous, steps=(replace(step, rivals=()),))  # not found in all parts
    assert [p.kind for p in purposes(alone, [excitation])] == ["evidence"]
    assert remaining(alone) == [f"{step.label}: its name is not certain."]
    apart = Difference(
        "offset:1", "offset", (0,), "b", {"f_b": 1.0}, {"f_b": 0.1}, {"f_b": "N·m"}, True
    )
    assert len(remaining(replace(ambiguous, steps=(), differing=(apart,)))) == 1
    shape = replace(step, label="smooth/dq:1", status="shape", depends_on=("dq1",), rivals=())
    unknown = replace(ambiguous, steps=(shape,))
    (wider,) = purposes(unknown, [excitation])
    assert (wider.kind, wider.groups, wider.signals) == ("range", (("joint 1",),), ("dq1",))
    # a part of the data does not show the shape: it is not certain that no effect describes it
    doubtful = replace(shape, evidence=replace(step.evidence, selected_with_rivals=0.9))
    (further,) = purposes(replace(ambiguous, steps=(doubtful,)), [excitation])
    assert (further.kind, further.groups) == ("evidence", (("smooth/dq:1",),))
    # or an effect of the library takes its place there: it is the one to be shown
    rival = Rival("load_friction:1", "load_friction", (0,), "data")
    selected = replace(step.evidence, selected=0.3, selected_with_rivals=1.0)
    imitated = replace(shape, effect="smooth", rivals=(rival,), evidence=selected)
    (further,) = purposes(replace(ambiguous, steps=(imitated,)), [excitation])
    assert (further.kind, further.groups) == ("evidence", (("load_friction:1",),))
    lead = replace(step, doubt="lead", rivals=())
    assert purposes(replace(ambiguous, steps=(lead,)), [excitation]) == []  # no motion decides


def test_an_effect_of_the_model_s_own_library_is_open_like_any_other(ambiguous):
    own = lieid.Model(ROBOT, library={"gust": REGISTER["stribeck"]})
    fit = replace(ambiguous.fit, model=own)
    near = replace(ambiguous, fit=fit, steps=(), undecided=(("gust:1", 1.6),))
    (need,) = purposes(near, [Purpose("excitation")], recorded=10.0, left=30.0)
    assert (need.kind, need.groups) == ("evidence", (("gust:1",),))


@pytest.fixture(scope="module")
def design():
    model = lieid.Model(ROBOT, "coulomb,viscous,offset")
    made = MotionDesign(model, None, lieid.default_limits(ROBOT), None, 0.8, 19.0, 200.0, 0)
    return replace(made, probe=made.probe_motion(2.0, None))


def test_an_effect_that_the_held_out_parts_do_not_decide_is_open(ambiguous):
    """The gain of 10 s is 1.6 of its standard errors: 15.6 s should show two, 35.2 s three."""
    near = replace(ambiguous, steps=(), undecided=(("torque_lowpass:1", 1.6),))
    excitation = Purpose("excitation")
    (need,) = purposes(near, [excitation], recorded=10.0, left=6.0)  # enough to add it
    assert (need.kind, need.groups) == ("evidence", (("torque_lowpass:1",),))
    assert need.growth == pytest.approx((2.515625,))  # enough to name it
    assert purposes(near, [excitation], recorded=10.0, left=5.0) == []  # not in the time left
    assert purposes(near, [excitation, need], recorded=10.0, left=6.0) == []


def test_what_depends_on_temperature_gets_one_long_motion_twice(ambiguous):
    """No motion sets a temperature: the reason states how to record the difference."""
    (step,) = ambiguous.steps
    warm = replace(step, label="warm_up:1", effect="warm_up")
    error = Unexplained(1, 0.5, 2.0, ("t", "dq2"))
    found = replace(ambiguous, steps=(warm,), unexplained=(error,))
    needs = purposes(found, [Purpose("excitation")], recorded=10.0, left=40.0)
    need = needs[0]
    assert need.kind == "temperature"
    assert need.groups == (("warm_up:1",), ("joint 2",))
    assert purposes(found, [Purpose("excitation"), need], left=20.0)[0].kind == "temperature"
    assert purposes(found, [Purpose("excitation"), need, need])[0].kind == "rivals"
    assert any("arm cold and again" in sentence for sentence in remaining(found))
    assert not any("arm cold and again" in sentence for sentence in remaining(ambiguous))


def planned(design, purpose, fit, recordings, folder):
    return design.next(
        purpose, folder, fit, recordings, number=1, most=3, progress=lambda stage, done: None
    )


def test_one_length_without_a_motion_leaves_the_others(
    design, ambiguous, given, tmp_path, monkeypatch
):
    """A long excitation has no solution within the limits; the short ones have."""

    def short_ones(*arguments, duration, **options):
        if duration > 10.0:
            raise NoSolution("no trajectory within all limits was found")
        return lieid.excite(*arguments, duration=duration, max_iterations=20, **options)

    monkeypatch.setattr(motion, "excite", short_ones)
    made = planned(design, Purpose("excitation"), ambiguous.fit, [given], tmp_path)
    assert np.isclose(made.duration - made.probe, [17.0 / 2, 17.0 / 4], atol=0.01).any()


def test_a_motion_for_rivals_separates_them(design, ambiguous, given, tmp_path):
    purpose = Purpose("rivals", (("stribeck:1", "viscous_polynomial:1"),))
    motion = planned(design, purpose, ambiguous.fit, [given], tmp_path)
    assert motion.duration <= 19.0
    record, _ = recorder(arm())
    found = lieid.diagnose(design.model, [given, record(motion)])
    assert [(step.label, step.status) for step in found.steps] == [("stribeck:1", "named")]


def test_a_motion_for_a_shape_covers_speeds(design, ambiguous, tmp_path):
    t = np.arange(0.0, 10.0, 0.005)
    fourier = plant.FourierTrajectory(ROBOT, base_frequency=0.1, seed=1)
    purpose = Purpose("range", (("joint 1",),), ("dq1",))
    recording = measured(arm(), t, *fourier.at(t))
    motion = planned(design, purpose, ambiguous.fit, [recording], tmp_path)
    speed = np.abs(motion.samples.dq[motion.samples.t > motion.probe])
    assert speed[:, 1].max() == 0.0
    for part in (0.03, 0.15, 0.6):
        steady = np.isclose(speed[:, 0], part * design.range.velocity[0], rtol=1e-6)
        assert steady.sum() > 80  # at 200 Hz


def test_a_motion_for_one_effect_shows_friction_near_standstill(design, tmp_path):
    """Stribeck friction of 0.012 rad/s: excitations pass it in a few samples of 5 ms."""
    plain = plant.demo_arm(ROBOT, seed=3, hidden=None)
    extra = float(plain.friction.coulomb[0])
    robot = plain.with_effects(plant.Stribeck(0, extra=extra, velocity=0.012))

    def recorded(motion, seed):
        s, sensors = motion.samples, plant.demo_sensors(ROBOT, rate=200.0)
        return plant.measure_along(robot, s.t, s.q, s.dq, s.ddq, sensors=sensors, seed=seed)

    first = recorded(planned(design, Purpose("excitation"), None, [], tmp_path), 1)
    before = lieid.diagnose(design.model, first)
    assert before.steps == ()
    wanted = growth(3.0, dict(before.undecided)["stribeck:1"])
    purpose = Purpose("evidence", (("stribeck:1",),), growth=(10.0 * wanted,))
    motion = planned(design, purpose, before.fit, [first], tmp_path)
    assert "% of what is needed" in motion.promise
    short = planned(design, replace(purpose, growth=(0.1,)), before.fit, [first], tmp_path)
    assert short.promise == "This motion should suffice to be certain of stribeck:1."
    assert short.duration < motion.duration - 10.0
    after = lieid.diagnose(design.model, [first, recorded(motion, 2)])
    assert [(step.label, step.status) for step in after.steps] == [("stribeck:1", "named")]


@pytest.mark.slow
def test_drift_is_reported(given, tmp_path):
    """The offset of the second recording is not that of the first along the probe."""
    unknown = plant.ForeignTorque(
        0, function=lambda s: np.sin(3.0 * s.q[..., 1]) * np.sign(s.dq[..., 0])
    )
    record, motions = recorder(arm(None).with_effects(unknown))

    def drifts(motion):
        recording = record(motion)
        return replace(recording, tau=recording.tau + np.array([0.6, 0.0]) * (motion.number - 1))

    result = lieid.experiment(ROBOT, record=drifts, most=2, folder=tmp_path, **QUICK)
    assert len(motions) == 2
    assert np.allclose(*(m.samples.q[: 3 * 200] for m in motions))
    (warning,) = result.rounds[1].warnings
    assert "joint 1 along the probe motion differs" in warning
