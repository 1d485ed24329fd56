"""Rivals in the final model: which one is named, and how candidates are compared."""

from types import SimpleNamespace

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.compiled import compile
from lieid_casadi.diagnosis import DiagnosisOptions
from lieid_casadi.diagnosis.review.review import review
from lieid_casadi.diagnosis.screening.candidates import Candidate
from lieid_casadi.diagnosis.screening.context import ScreeningContext
from lieid_casadi.diagnosis.screening.effect_columns import SegmentSignals
from lieid_casadi.diagnosis.search import better_rivals
from lieid_casadi.diagnosis.search.block_bootstrap import Competition, Competitor
from lieid_casadi.diagnosis.search.missing_effects import MissingEffects
from lieid_casadi.effects import Placement, make
from lieid_casadi.identification.identify import identify_segments
from lieid_casadi.recording import process

ROBOT = lieid.robots.two_link()
MODEL = lieid.Model(ROBOT, "coulomb,viscous,offset")
OWN, RIVAL = 0, 1  # first columns of the two competitors


def filtered_recording():
    """Return 10 s of motion with a torque signal that is low-pass filtered on joint 1."""
    arm = plant.demo_arm(ROBOT, hidden=None)
    arm = arm.with_effects(plant.hidden_effect(arm, "torque_lowpass", 0, strength=0.5))
    motion = plant.FourierTrajectory(ROBOT, base_frequency=0.1, seed=1)
    t = np.arange(0.0, 10.0, 0.002)
    return plant.measure_along(arm, t, *motion.at(t), sensors=plant.demo_sensors(ROBOT), seed=1)


def candidate(name, joint=0):
    return Candidate(Placement(make(name), joint), np.zeros((1, 1)))


def better(monkeypatch, *, selected, errors, accepted=(), rivals=()):
    """Return what takes the place of `torque_delay:1`, of which `presliding:1` is a rival.

    Parameters
    ----------
    selected : (float, float)
        Fractions of the repetitions: the effect's and the rival's.
    errors : (float, float)
        Held-out errors with each of them.
    accepted : sequence of Candidate
        Further effects of the model.
    rivals : sequence of (Candidate, str)
    """
    own, rival = candidate("torque_delay"), candidate("presliding")
    effect = SimpleNamespace(candidate=own, joint=0, rivals=rivals, selected=selected[0])
    parts = object()

    def held_out(columns, without, *, blocks):
        error = errors[int(columns[0, 0])]
        return SimpleNamespace(
            parts=parts, holds=True, after=np.array([error]), gain=np.array([1.0 - error])
        )

    problem = SimpleNamespace(
        options=DiagnosisOptions(),
        held_out_rows=SimpleNamespace(errors=held_out),
        accepted=[effect, *(SimpleNamespace(candidate=c) for c in accepted)],
    )
    found = Competition(
        Competitor(own, np.full((1, 1), OWN), 0.0),
        (Competitor(rival, np.full((1, 1), RIVAL), 0.0),),
        selected[0],
        np.array(selected[1:]),
    )
    place = SimpleNamespace(without=None)
    monkeypatch.setattr(better_rivals, "alternatives", lambda effect, problem: place)
    monkeypatch.setattr(better_rivals, "competition", lambda place, problem: found)
    replacement = better_rivals.better_rival(problem, effect, set())
    labels = {"presliding:1", *(c.placement.label for c in accepted)}
    assert better_rivals.better_rival(problem, effect, {frozenset(labels)}) is None
    return replacement


def test_a_rival_that_is_selected_more_often_and_holds_as_well_takes_the_place(monkeypatch):
    found = better(monkeypatch, selected=(0.2, 0.8), errors=(0.5, 0.4))
    assert found.candidate.placement.label == "presliding:1"
    assert "80 % and 20 % of the repetitions" in found.reason


@pytest.mark.parametrize(
    ("selected", "errors"),
    [((0.2, 0.8), (0.4, 0.5)), ((0.8, 0.2), (0.5, 0.4)), ((0.44, 0.56), (0.5, 0.4))],
)
def test_a_rival_must_be_selected_more_often_and_hold_as_well(monkeypatch, selected, errors):
    assert better(monkeypatch, selected=selected, errors=errors) is None


def test_of_rivals_an_effect_of_several_other_joints_is_named(monkeypatch):
    case = {"selected": (0.8, 0.2), "errors": (0.4, 0.5)}
    rivals = ((candidate("presliding"), "data"),)
    others = [candidate("presliding", joint) for joint in (1, 2)]
    found = better(monkeypatch, **case, accepted=others, rivals=rivals)
    assert "presliding is an effect of other joints too" in found.reason
    assert better(monkeypatch, **case, accepted=others) is None  # the data separate the two
    assert better(monkeypatch, **case, accepted=others[:1], rivals=rivals) is None
    delays = [*others, candidate("torque_delay", 1)]
    assert better(monkeypatch, **case, accepted=delays, rivals=rivals) is None


def test_an_effect_of_several_other_joints_is_not_exchanged(monkeypatch):
    delays = [candidate("torque_delay", joint) for joint in (1, 2)]
    case = {"selected": (0.2, 0.8), "errors": (0.5, 0.4)}
    assert better(monkeypatch, **case, accepted=delays) is None


def test_candidates_act_on_the_torque_without_the_effects_on_the_torque_signal():
    """A delay in place of a filter would otherwise delay a torque that is filtered already."""
    recording = filtered_recording()
    fit = lieid.identify(MODEL.with_effect("torque_lowpass", joints=[1]), recording)
    (segment,) = process([recording], fit.processing)
    arm = SegmentSignals.of(fit, segment).arm
    filtered = [column.name.startswith("torque_lowpass") for column in fit.model.columns]
    assert sum(filtered) == 1
    assert not arm.joint_columns[:, :, filtered].any()


def test_an_effect_is_exchanged_for_a_better_rival_of_the_final_model():
    """A filter is passed over in the first step, so that a delay is accepted in its place."""
    recording = filtered_recording()
    first = lieid.identify(MODEL, recording)
    segments = process([recording], first.processing)
    context = ScreeningContext.of(first, segments, DiagnosisOptions())

    def refit(larger, start, *, uncertainty=False):
        return identify_segments(
            compile(larger), segments, method="wls", start=start, uncertainty=uncertainty,
            temperature_mean=first.temperature_mean, provenance=first.provenance,
        )  # fmt: skip

    problem = MissingEffects(context, refit, seed=0, ask=None)
    owners = context.candidates.owners
    (lowpass,) = [c for c in owners if c.placement.label == "torque_lowpass:1"]
    problem.reject(lowpass, "passed over")
    problem.run(lambda step, fraction: None)
    assert [a.candidate.placement.label for a in problem.accepted] == ["torque_delay:1"]
    review(problem)
    (found,) = problem.accepted
    assert found.candidate.placement.label == "torque_lowpass:1"
    assert found.selected >= DiagnosisOptions().least_selected
    (reason,) = [r.reason for r in problem.rejected if r.candidate.name == "torque_delay"]
    assert "torque_lowpass:1 is selected more often in its place" in reason
