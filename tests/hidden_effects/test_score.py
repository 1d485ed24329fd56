"""Score of the benchmark: which results count as right."""

import pytest
from hidden_effects.case_setup import Case
from hidden_effects.score import score_result


def result_with(*steps, unexplained=(), verdict="effect_found"):
    def step(label, rivals=()):
        name, _, joint = label.partition(":")
        name, _, signals = name.partition("/")
        found = {"effect": name, "joints": [int(joint)] if joint else [], "indistinguishable": [
            {**step(r), "kind": "data"} for r in rivals]}  # fmt: skip
        if name == "smooth":
            found |= {"status": "shape", "depends_on": signals.split(".")}
        return found

    return {
        "verdict": verdict,
        "steps": [step(*s) if isinstance(s, tuple) else step(s) for s in steps],
        "unexplained": [
            {"joint": j, "fraction": 0.5, "depends_on": list(d)} for j, *d in unexplained
        ],
    }


def truth_of(*effects, signals=(), accepted=(), allowed=()):
    return {
        "mode": "missing", "kind": "", "arm": "panda", "simulated": False,
        "allowed": [[name, list(joints)] for name, joints in allowed],
        "effects": [
            {"effect": name, "joints": [joint], "target": 5.0, "size": 5.0, "left_part": 1.0,
             "joint": joint, "signals": list(signals),
             "accepted": list(accepted), "nearest": "", "nearest_part": 0.0}
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
    assert not score_result(case, truth, result_with("payload:1"))["right"]
    assert not score_result(case, truth, result_with("payload:1", "payload:1"))["right_in_set"]


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
        (result_with("smooth/dq2.q3:2"), True),
        (result_with("smooth/dq.q3:2"), True),
        (result_with("smooth/dq.q3:1"), False),
        (result_with("smooth/dq:2", "smooth/dq.q3:2"), False),
        (result_with("smooth/dq.q3:2", "stribeck:1"), False),
        (result_with(("stribeck:2", ["coulomb:2"])), False),
    ],
)
def test_score_of_a_foreign_effect(result, right):
    truth = truth_of(("friction_by_other_angle", 2), signals=("dq2", "q3"))
    case = Case("foreign", 0, effect="friction_by_other_angle", size=5.0)
    assert score_result(case, truth, result)["right"] == right


def test_one_of_several_names_of_a_signal_suffices():
    truth = truth_of(("cross_talk", 2), signals=("load3|tau3",))
    case = Case("foreign", 100, effect="cross_talk", size=5.0)
    for signal, right in (("load3", True), ("tau3", True), ("load2", False)):
        assert score_result(case, truth, result_with(f"smooth/{signal}:2"))["right"] == right


@pytest.mark.parametrize(
    ("result", "right"),
    [
        (result_with(verdict="sufficient"), True),
        (result_with("smooth/q:1"), True),
        (result_with(unexplained=[(1, "q1")], verdict="unexplained"), True),
        (result_with("torque_ripple:2"), True),
        (result_with("torque_ripple:3"), False),
        (result_with("torque_ripple:2", "stribeck:2"), False),
        (result_with("time_shift"), True),
        (None, False),
    ],
)
def test_score_of_a_violated_assumption(result, right):
    truth = truth_of(allowed=[("torque_ripple", (2,)), ("time_shift", ())])
    assert score_result(Case("world", 0, effect="cogging"), truth, result)["right"] == right


@pytest.mark.parametrize(
    ("result", "right", "first"),
    [
        (result_with("stribeck:2"), True, True),
        (result_with(("viscous_polynomial:2", ["stribeck:2"])), True, False),
        (result_with("viscous_polynomial:2"), False, False),
        (result_with("stribeck:2", "stribeck:3"), False, True),
        (result_with(unexplained=[(2, "dq2")], verdict="unexplained"), True, False),
        (result_with(unexplained=[(3, "dq2")], verdict="unexplained"), False, False),
        (None, False, False),
    ],
)
def test_score_of_a_foreign_form(result, right, first):
    truth = truth_of(("stribeck_lorentzian", 2), signals=("dq2",), accepted=("stribeck",))
    score = score_result(Case("form", 0, effect="stribeck_lorentzian", size=5.0), truth, result)
    assert (score["right"], score["right_first"]) == (right, first)


@pytest.mark.parametrize(
    ("steps", "right_first"),
    [(["stribeck:2", "armature:1"], True), (["armature:1", "stribeck:2"], False), ([], False)],
)
def test_the_first_step_counts(steps, right_first):
    case = Case("single", 0, effect="stribeck", size=5.0)
    score = score_result(case, truth_of(("stribeck", 2)), result_with(*steps))
    assert score["right_first"] == right_first


@pytest.mark.parametrize(
    ("step", "status", "named_wrongly", "right_first_in_set"),
    [
        ("stribeck:2", "named", False, True),
        ("viscous:2", "named", True, False),
        (("viscous:2", ["stribeck:2"]), "one_of", False, True),
        (("viscous:2", ["stribeck:1"]), "one_of", False, False),
        ("smooth/dq:2", "shape", False, False),
    ],
)
def test_a_status_decides_whether_a_wrong_step_is_named_wrongly(
    step, status, named_wrongly, right_first_in_set
):
    result = result_with(step)
    for one in result["steps"]:
        one["status"] = status
    case = Case("single", 0, effect="stribeck", size=5.0)
    score = score_result(case, truth_of(("stribeck", 2)), result)
    assert score["named_wrongly"] == named_wrongly
    assert score["right_first_in_set"] == right_first_in_set
    empty = score_result(Case("correlated", 100, effect="0.2s"), truth_of(), result)
    assert empty["name_or_shape"]
    assert empty["named_wrongly"] == (status == "named")
