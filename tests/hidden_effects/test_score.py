"""Score of the benchmark: which results count as right."""

import pytest
from hidden_effects.case_setup import Case
from hidden_effects.score import score_result


def result_with(*steps, unexplained=(), verdict="effect_found"):
    def step(label, rivals=()):
        name, _, joint = label.partition(":")
        return {"effect": name, "joints": [int(joint)] if joint else [], "indistinguishable": [
            {**step(r), "kind": "data"} for r in rivals]}  # fmt: skip

    return {
        "verdict": verdict,
        "steps": [step(*s) if isinstance(s, tuple) else step(s) for s in steps],
        "unexplained": [
            {"joint": j, "fraction": 0.5, "depends_on": list(d)} for j, *d in unexplained
        ],
    }


def truth_of(*effects, signals=()):
    return {
        "mode": "missing", "kind": "", "arm": "panda", "simulated": False,
        "effects": [
            {"effect": name, "joints": [joint], "target": 5.0, "size": 5.0, "left_part": 1.0,
             "joint": joint, "signals": list(signals), "nearest": "", "nearest_part": 0.0}
            for name, joint in effects
        ],
    }  # fmt: skip


@pytest.mark.parametrize(
    ("result", "right", "in_set"),
    [
        (result_with("stribeck:2"), True, True),
        (result_with("stribeck:3"), False, False),
        (result_with("stribeck:2", "viscous_asymmetric:1"), False, False),
        (result_with(("presliding:2", ["stribeck:2"])), False, True),
        (result_with(("presliding:2", ["stribeck:3"])), False, False),
        (result_with(verdict="sufficient"), False, False),
        (None, False, False),
    ],
)
def test_score_of_a_single(result, right, in_set):
    score = score_result(
        Case("single", 0, effect="stribeck", size=5.0), truth_of(("stribeck", 2)), result
    )
    assert (score["right"], score["right_in_set"]) == (right, in_set)


def test_score_of_a_pair():
    truth = truth_of(("stribeck", 2), ("payload", 1))
    case = Case("pair", 0)
    assert score_result(case, truth, result_with("payload:1", "stribeck:2"))["right"]
    half = score_result(case, truth, result_with("payload:1"))
    assert not half["right"]
    assert half["missed"] == [["stribeck", (2,)]]


@pytest.mark.parametrize(
    ("result", "right"),
    [
        (result_with(verdict="sufficient"), True),
        (result_with("stribeck:1"), False),
        (result_with(verdict="unexplained", unexplained=[(1, "q1")]), False),
        (None, False),
    ],
)
def test_score_without_hidden_effects(result, right):
    assert score_result(Case("none", 0), truth_of(), result)["right"] == right


@pytest.mark.parametrize(
    ("result", "right"),
    [
        (result_with(unexplained=[(2, "q3", "dq2")], verdict="unexplained"), True),
        (result_with(unexplained=[(2, "dq2", "q3", "t")], verdict="unexplained"), True),
        (result_with(unexplained=[(2, "dq2")], verdict="unexplained"), False),
        (result_with(unexplained=[(1, "dq2", "q3")], verdict="unexplained"), False),
        (result_with("stribeck:1", unexplained=[(2, "dq2", "q3")], verdict="unexplained"), False),
    ],
)
def test_score_of_a_foreign_effect(result, right):
    truth = truth_of(("friction_by_other_angle", 2), signals=("dq2", "q3"))
    case = Case("foreign", 0, effect="friction_by_other_angle", size=5.0)
    assert score_result(case, truth, result)["right"] == right
