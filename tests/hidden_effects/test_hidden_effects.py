"""A small part of the benchmark: the first cases of its fixed order, without a controller.

The whole benchmark is ``python tests/hidden_effects/run.py``. The number of correct results that
slow tests require is reached in 97.5 % of draws by a program that meets the goals exactly; the few
cases of the others must all be right.
"""

import warnings
from functools import cache

import pytest
from hidden_effects.case_setup import Case
from hidden_effects.generator import draw
from hidden_effects.schedule import chosen
from hidden_effects.score import run_case
from scipy.stats import binom

STRONG = (
    "missing-single-armature-5x-0",
    "missing-single-base_tilt-5x-2",
)
CHANGED, UNCHANGED = "changed-single-payload-2x-0", "changed-none-28"


@cache
def scored(name, by_command=False):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # some recordings of the benchmark have warnings
        return run_case(Case.parse(name), true_model=False, by_command=by_command)


def assert_enough(names, rate):
    rows = [scored(name) for name in names]
    wrong = {r["case"]: (r["verdict"], r["steps"], r.get("error")) for r in rows if not r["right"]}
    assert sum(r["right"] for r in rows) >= binom.ppf(0.025, len(rows), rate), wrong


def test_the_small_part_is_the_first_of_the_order():
    first = chosen(modes=["missing"], kinds=["single"], sizes=[5.0], series=[1], count=len(STRONG))
    assert tuple(case.name for case in first) == STRONG
    assert not draw(first[0]).truth["simulated"]


@pytest.mark.parametrize("name", [*STRONG, CHANGED, UNCHANGED])
def test_strong_effects_are_named_and_no_others(name):
    assert_enough([name], 1.0)


@pytest.mark.slow
def test_no_effects_are_added_that_cancel_each_other():
    """Two of them fit a peak of friction by 30 times the joint's torque, at trained speeds only."""
    case = Case.parse("missing-foreign-friction_peak-5x-100")
    assert run_case(case, true_model=True)["plain_ratio"] < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("number", [314, 316])
def test_a_function_is_not_in_place_of_effects_for_one_part_or_one_function_more(number):
    """Friction by temperature beside a function that was not needed, and two effects of friction.

    Of the latter one held-out part, to which the others do not extend, had nearly all the error.
    """
    assert_enough([f"missing-six-{number}"], 1.0)


@pytest.mark.slow
def test_what_raises_the_error_in_a_fit_leaves_and_not_what_it_spoils():
    """A payload moved the load of which the torque is a function; both were refused in the end.

    Of the function alone a combination of coefficients is not determined, so that the variances
    of the others are rounding.
    """
    assert run_case(Case.parse("missing-foreign-load_backlash-2x-135"))["plain_ratio"] < 0.2


@pytest.mark.slow
def test_a_base_that_is_tilted_in_one_recording_gives_no_effect_of_the_arm():
    assert scored("missing-world-tilted_run-0")["steps"] == []


@pytest.mark.slow
@pytest.mark.parametrize("size", ["5x", "1x"])
def test_a_delay_is_told_from_a_filter_by_the_fit(size):
    """On the grids of a search a filter resembles it more; of 1x the search finds both."""
    (step,) = scored(f"missing-single-time_shift-{size}-100")["steps"]
    assert step["effect"] == "time_shift"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "label"),
    [("torque_delay-2x-100", "torque_delay"), ("torque_lowpass-2x-108", "torque_lowpass")],
)
def test_a_changed_delay_is_told_from_a_filter_by_consistent_columns(name, label):
    """A filter of another time constant than the one with which it is multiplied fits better."""
    (step,) = scored(f"changed-single-{name}")["steps"]
    assert step["effect"] == label


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["torque_delay", "torque_lowpass"])
def test_a_changed_delay_is_no_late_friction(effect):
    """A joint that sticks for a moment at its reversals did so when the fit was made."""
    (step,) = scored(f"changed-single-{effect}-5x-252")["steps"]
    assert step["effect"] == effect


@pytest.mark.slow
def test_drifts_with_another_rate_in_each_recording_are_one_effect():
    assert_enough(["missing-single-bias_drift-2x-256", "missing-pair-156"], 1.0)


@pytest.mark.slow
def test_a_ripple_beside_a_function_of_the_angle_is_a_piece_of_its_form():
    (step,) = scored("changed-foreign-bump-2x-0")["steps"]
    assert (step["effect"], step["depends_on"]) == ("smooth", ["q6"])


@pytest.mark.slow
def test_a_change_whose_best_shape_is_refused_is_none():
    """Narrower and narrower hysteresis of two joints explains more: it is none."""
    found = scored("changed-single-viscous_polynomial-5x-100")
    assert [(s["effect"], s["joints"]) for s in found["steps"]] == [("viscous_polynomial", [6])]


@pytest.mark.slow
def test_a_change_in_whose_place_uncertain_parameters_move_is_found():
    """Six times the expected error; 22 s in noise that is correlated over 0.7 s."""
    found = scored("changed-single-offset-5x-102")
    assert [(s["effect"], s["joints"]) for s in found["steps"]] == [("offset", [4])]


@pytest.mark.slow
def test_parameters_of_joints_that_moved_in_one_direction_are_no_changes():
    """Dry friction and offset of three joints are weak in the fit, and off by many deviations."""
    assert scored("changed-correlated-0.5s-114")["steps"] == []


@pytest.mark.slow
def test_command_line_and_python_agree():
    name = STRONG[0]
    by_python, by_command = scored(name), scored(name, by_command=True)
    for key in ("steps", "verdict", "right", "unexplained"):
        assert by_command[key] == by_python[key]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rate", "wanted", "limit"),
    [
        (0.95, {"modes": ["missing"], "kinds": ["single"], "sizes": [5.0, 2.0, 1.0]}, 6),
        (0.85, {"modes": ["missing"], "kinds": ["pair"]}, 3),
        (0.95, {"modes": ["missing"], "kinds": ["none"]}, 5),
        (0.90, {"modes": ["missing"], "kinds": ["foreign"]}, 3),
        (0.90, {"kinds": ["form"]}, 3),
        (0.95, {"kinds": ["world"]}, 4),
        (0.95, {"modes": ["changed"], "kinds": ["single"], "sizes": [5.0, 2.0, 1.0]}, 3),
        (0.95, {"modes": ["changed"], "kinds": ["none"]}, 3),
    ],
    ids=["single", "pair", "none", "foreign", "form", "world", "changed", "unchanged"],
)
def test_more_of_the_benchmark(rate, wanted, limit):
    assert_enough([case.name for case in chosen(**wanted, series=[1], count=limit)], rate)
