"""Unexplained residual: its shape, a formula, and the code of a user-defined effect."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.cli.main import main
from lieid_casadi.diagnosis import DiagnosisOptions, own_effects
from lieid_casadi.diagnosis.residual.function_dictionary import (
    FUNCTIONS,
    Term,
)
from lieid_casadi.diagnosis.residual.symbolic_formula import Formula
from lieid_casadi.diagnosis.residual.test_results import TrainAndTest, with_test_results
from lieid_casadi.diagnosis.residual.unexplained import Unexplained
from lieid_casadi.diagnosis.screening.context import ScreeningContext
from lieid_casadi.effects.registry import REGISTER
from lieid_casadi.recording import process
from lieid_casadi.report import diagnosis_report

ROBOT = lieid.robots.two_link()
MODEL = lieid.Model(ROBOT, "coulomb,viscous,offset")
SIZE = plant.torque_scale(ROBOT)


@cache
def run(arm, seed, name=""):
    trajectory = plant.FourierTrajectory(ROBOT, base_frequency=1 / 15, seed=seed)
    t = np.arange(0.0, 15.0, 0.001)
    sensors = plant.demo_sensors(ROBOT)
    return plant.measure_along(arm, t, *trajectory.at(t), sensors=sensors, seed=seed, name=name)


@cache
def plain_arm():
    return plant.demo_arm(ROBOT, hidden=None)


@cache
def runs(joint, torque):
    hidden = plain_arm().with_effects(plant.ForeignTorque(joint, torque))
    return run(hidden, 1, "train"), run(hidden, 2, "test")


def viscous_by_angle(s):
    return 0.15 * SIZE[1] * np.sin(2.0 * s.q[..., 1] + 0.5) * s.dq[..., 1]


def bump(s):
    return 0.3 * SIZE[1] / (1.0 + ((s.q[..., 1] - 0.3) / 0.15) ** 2)


def drag_of_other(s):
    return 0.1 * SIZE[0] * np.abs(s.dq[..., 1])


def load_behind_play(s):
    load, width = s.load[..., 0], 0.12 * np.ptp(s.load[..., 0])
    behind = np.array(load)
    for k in range(1, len(load)):
        behind[k] = min(max(behind[k - 1], load[k] - width), load[k] + width)
    return 0.3 * (load - behind)


@pytest.fixture(autouse=True)
def register_as_before():
    """Remove the effects that a test registers."""
    registered = dict(REGISTER)
    yield
    REGISTER.clear()
    REGISTER.update(registered)


@pytest.fixture(scope="module")
def by_angle():
    train, test = runs(1, viscous_by_angle)
    return lieid.diagnose(MODEL, train, test), train, test


@pytest.fixture(scope="module")
def with_bump():
    train, test = runs(1, bump)
    return lieid.diagnose(MODEL, train, test), train, test


def with_user_effect(diagnosis, train, test):
    """Return the code, the fit with the effect that it registers, and the error on the test."""
    own = own_effects(diagnosis.unexplained)
    exec(compile(own.code, "own.py", "exec"), {})
    wanted = lieid.Model(ROBOT, [*diagnosis.fit.model.effects, *own.labels])
    fit = lieid.identify(wanted, train, processing=diagnosis.fit.processing)
    return own, fit, lieid.compare(fit, test).rms


@cache
def noise(seed=2):
    """Return the error on the test of a complete model."""
    arm = plain_arm()
    return lieid.compare(lieid.identify(MODEL, run(arm, 1)), run(arm, seed)).rms


def test_the_formula_is_found(by_angle):
    (part,) = by_angle[0].unexplained
    formula = part.formula
    estimates = zip(formula.terms, formula.values, formula.std, strict=True)
    found = {term.text: (value, std) for term, value, std in estimates}
    assert set(found) == {"sin(2 q2)·dq2", "cos(2 q2)·dq2"}
    for term, truth in (("sin(2 q2)·dq2", np.cos(0.5)), ("cos(2 q2)·dq2", np.sin(0.5))):
        value, std = found[term]
        assert value == pytest.approx(0.15 * SIZE[1] * truth, abs=4.0 * std)
        assert std < 0.1 * abs(value)
    assert part.formula.units == ("N·m·s/rad", "N·m·s/rad")
    assert part.formula.part > 0.9
    assert "sin(2 q2)·dq2" in by_angle[0].sentence


def test_with_the_user_effect_the_error_falls_to_the_noise(by_angle):
    diagnosis, train, test = by_angle
    own, fit, after = with_user_effect(diagnosis, train, test)
    assert own.labels == ("own_2:2",)
    assert len(own.code.split("\n\n\n")[1].splitlines()) <= 10
    assert after[1] < 1.2 * noise()[1] < 0.1 * diagnosis.baseline_test[1]
    named = [row for row in fit.parameter_table() if row["name"].startswith("own_2.")]
    assert [row["value"] for row in named] == pytest.approx(
        diagnosis.unexplained[0].formula.values, rel=0.05
    )
    again = lieid.diagnose(fit.model, train, test, processing=diagnosis.fit.processing)
    assert again.verdict == "sufficient"


def test_the_map_is_the_hidden_torque(by_angle):
    (part,) = by_angle[0].unexplained
    shape = part.shapes[0]
    assert set(shape.signals) == {"q2", "dq2"}
    assert set(shape.units) == {"rad", "rad/s"}
    q, dq = np.meshgrid(*shape.grid, indexing="ij")
    if shape.signals[0] == "dq2":
        q, dq = dq, q
    truth = 0.15 * SIZE[1] * np.sin(2.0 * q + 0.5) * dq
    seen = np.isfinite(shape.value)
    assert 0.2 < seen.mean() < 1.0
    # the model has viscous friction, so that its part is not determined
    columns = np.column_stack([dq[seen], np.sign(dq[seen])])
    left = truth[seen] - shape.value[seen]
    left = left - columns @ np.linalg.lstsq(columns, left, rcond=None)[0]
    assert np.sqrt(np.mean(left**2)) < 0.2 * np.sqrt(np.mean(truth[seen] ** 2))
    assert (shape.low[seen] <= shape.value[seen]).all()
    assert (shape.value[seen] <= shape.high[seen]).all()


def test_a_bump_is_a_curve_without_a_formula(with_bump):
    diagnosis, train, test = with_bump
    part = diagnosis.unexplained[0]
    assert part.depends_on[0] == "q2"
    assert part.formula is None
    (q,), value = part.shapes[0].grid, part.shapes[0].value
    assert q[np.argmax(value)] == pytest.approx(0.3, abs=0.1)
    truth = 0.3 * SIZE[1] / (1.0 + ((q - 0.3) / 0.15) ** 2)
    assert (
        np.corrcoef(truth, value)[0, 1] > 0.9
    )  # the bump is narrower than the smooth functions resolve
    own, _, after = with_user_effect(diagnosis, train, test)
    assert own.labels == ("own_2:2",)
    assert after[1] < 0.5 * diagnosis.baseline_test[1]


def test_a_torque_that_depends_on_another_joint_is_a_coupling():
    train, test = runs(0, drag_of_other)
    diagnosis = lieid.diagnose(MODEL, train, test)
    own, _, after = with_user_effect(diagnosis, train, test)
    assert own.labels == ("own_1_2:1<2",)
    assert "ca.fabs(s.other.dq)" in own.code
    assert after[0] < 1.2 * noise()[0] < 0.1 * diagnosis.baseline_test[0]
    shape = diagnosis.unexplained[0].shapes[0]
    assert shape.signals == ("dq2",)
    inside = within(shape, 0.1 * SIZE[0] * np.abs(shape.grid[0]))
    assert inside.mean() > 0.9


def within(shape, truth):
    return (shape.low <= truth) & (truth <= shape.high)


@pytest.mark.parametrize("seed", [3, 7])
def test_the_band_contains_the_curve(seed):
    """A function of another joint's angle, apart from the constant that ``offset`` absorbs."""
    arm = plant.demo_arm(ROBOT, hidden=None, seed=seed)
    size = 0.2 * SIZE[0]
    wave = plant.ForeignTorque(0, lambda s: size * np.sin(3.0 * s.q[..., 1] + 1.0))
    (part,) = lieid.diagnose(MODEL, run(arm.with_effects(wave), 10 + seed)).unexplained
    (shape,) = part.shapes
    assert shape.signals == ("q2",)
    truth = size * np.sin(3.0 * shape.grid[0] + 1.0)
    truth += np.mean(shape.value - truth)
    assert within(shape, truth).mean() > 0.9
    assert np.abs(shape.value - truth).max() < 0.05 * size
    assert np.median(shape.high - shape.low) < 0.5 * size


def test_a_change_that_is_no_effect_has_a_formula():
    arm = plain_arm()
    fit = lieid.identify(MODEL, [run(arm, 1), run(arm, 2)])
    after = run(arm.with_effects(plant.ForeignTorque(1, viscous_by_angle)), 3)
    diagnosis = lieid.diagnose(fit, after)
    assert diagnosis.verdict == "unexplained"
    (part,) = diagnosis.unexplained
    assert {t.text for t in part.formula.terms} == {"sin(2 q2)·dq2", "cos(2 q2)·dq2"}
    assert part.shapes
    assert "--effects " not in diagnosis_report(diagnosis)
    exec(compile(part.as_effect_code(), "own.py", "exec"), {})
    again = lieid.diagnose(fit, after)
    assert [step.label for step in again.steps] == ["own_2:2"]
    assert again.verdict == "effect_found"


def test_json_of_unexplained_parts(by_angle, with_bump):
    for diagnosis, *_ in (by_angle, with_bump):
        for part in diagnosis.to_dict()["unexplained"]:
            json.dumps(part, allow_nan=False)
            assert {
                "joint",
                "fraction",
                "depends_on",
                "hysteresis",
                "form",
                "shape",
                "confirmed",
                "candidates",
                "contained_in",
                "carries_over",
                "error_ratio",
            } == set(part)
            assert part["joint"] == 2
            for shape in part["shape"]:
                assert np.shape(shape["value"]) == tuple(len(g) for g in shape["grid"])
    form = by_angle[0].to_dict()["unexplained"][0]["form"]
    assert form["text"] == by_angle[0].unexplained[0].formula.text
    assert len(form["terms"]) == 2


def test_the_report_shows_shape_and_code(by_angle, with_bump):
    for diagnosis, *_ in (by_angle, with_bump):
        page = diagnosis_report(diagnosis)
        assert "Unexplained residual" in page
        assert "@lieid.effect(" in page
        assert "--effects-file F.py --effects &#39;coulomb,viscous,offset,own_2:2&#39;" in page
        figure = diagnosis.plot_unexplained()
        assert len(figure.axes) >= 1


def test_the_report_of_a_sufficient_model_has_no_such_section():
    arm = plain_arm()
    page = diagnosis_report(lieid.diagnose(MODEL, run(arm, 1), run(arm, 2)))
    assert "Unexplained residual" not in page


def test_the_printed_code_completes_the_model(tmp_path, capsys):
    """Saved in a file and used in the next run, the printed code leaves nothing to find."""
    train, test = runs(1, viscous_by_angle)
    train.save(tmp_path / "a.csv")
    test.save(tmp_path / "b.csv")
    command = ["diagnose", "two_link", "--train", str(tmp_path / "a.csv"),
               "--test", str(tmp_path / "b.csv")]  # fmt: skip
    assert main(command) == 0
    printed = capsys.readouterr().out
    first, last = printed.index("    import casadi"), printed.index("    return [")
    lines = printed[first : printed.index("\n", last)].splitlines()
    (tmp_path / "own.py").write_text("\n".join(line[4:] for line in lines) + "\n")
    own = ["--effects-file", str(tmp_path / "own.py")]
    assert main([*command, *own, "--effects", "coulomb,viscous,offset,own_2:2"]) == 0
    assert "No effect of the library improves the model significantly." in capsys.readouterr().out


def test_the_test_confirms_a_formula_or_contradicts_it(by_angle):
    diagnosis, train, test = by_angle
    clean = run(plain_arm(), 2)
    (part,), fit = diagnosis.unexplained, diagnosis.fit
    own, same, other = (ScreeningContext.of(
            fit, process([r], fit.processing), DiagnosisOptions(), with_candidates=False
        )
                        for r in (train, test, clean))  # fmt: skip
    noise = own.white_noise
    assert part.confirmed
    for described in (part, replace(part, formula=None)):  # formula, smooth functions
        results = [with_test_results([described], TrainAndTest(own, test, noise))[0].confirmed
                   for test in (same, other)]  # fmt: skip
        assert results == [True, False]


def test_the_test_recordings_choose_neither_parts_nor_formulas(by_angle):
    """A test without the effect contradicts the part, which is reported and changes nothing."""
    diagnosis, train, _ = by_angle
    against = lieid.diagnose(MODEL, train, run(plain_arm(), 2))
    alone = lieid.diagnose(MODEL, train)
    (part,) = diagnosis.unexplained
    for other, confirmed in ((against, False), (alone, None)):
        (same,) = other.unexplained
        assert set(same.formula.terms) == set(part.formula.terms)
        assert (same.joint, same.terms) == (part.joint, part.terms)
        assert same.confirmed is confirmed


@pytest.mark.parametrize(
    ("joint", "torque"),
    [
        (1, lambda s: 0.05 * SIZE[1] * np.maximum(s.q[..., 0] - 0.1, 0.0) ** 2),
        (0, lambda s: 0.1 * SIZE[0] * np.sin(s.q[..., 1] + 0.3) * s.sign[..., 0]),
        (1, lambda s: 0.3 * SIZE[1] * np.exp(-(((s.q[..., 1] + 0.5) / 0.3) ** 2))),
        (1, lambda s: 0.05 * SIZE[1] * s.dq[..., 0] * s.dq[..., 1]),
    ],
)
def test_printed_code_reduces_the_error_of_an_unseen_recording(joint, torque):
    arm = plain_arm().with_effects(plant.ForeignTorque(joint, torque))
    train, unseen = run(arm, 1), run(arm, 4)
    diagnosis = lieid.diagnose(MODEL, train)
    own, _, after = with_user_effect(diagnosis, train, unseen)
    assert own.labels[0].startswith(f"own_{joint + 1}")
    before = lieid.compare(diagnosis.fit, unseen).rms[joint]
    assert after[joint] < 0.7 * before
    assert (after < 1.05 * lieid.compare(diagnosis.fit, unseen).rms).all()


def test_code_that_does_not_hold_for_another_training_recording_is_not_printed():
    pushed = plain_arm().with_effects(plant.ForeignTorque(1, bump))
    diagnosis = lieid.diagnose(MODEL, [run(pushed, 1, "a"), run(plain_arm(), 4, "b")])
    assert own_effects(diagnosis.unexplained).labels == ()


def test_functions_of_time_are_not_suggested_as_effects():
    hum = plain_arm().with_effects(
        plant.ForeignTorque(1, lambda s: 0.2 * SIZE[1] * np.sin(0.7 * s.t) + 0.0 * s.q[..., 1])
    )
    diagnosis = lieid.diagnose(MODEL, run(hum, 1))
    (part,) = diagnosis.unexplained
    assert part.depends_on == ("t",)
    assert part.to_dict()["carries_over"] is False
    assert own_effects(diagnosis.unexplained).code == ""
    assert "changes over the recording" in diagnosis.sentence
    assert "@lieid.effect" not in diagnosis_report(diagnosis)


def test_products_of_two_other_joints_are_a_comment_in_the_code():
    line = FUNCTIONS["dq"][1]
    term = Term((("dq1", line), ("dq3", line)))
    formula = Formula((term,), (1.0,), (0.1,), ("N·m·s²/rad²",), 1.0)
    own = own_effects([Unexplained(1, 0.5, ("dq1", "dq3"), formula=formula)])
    assert own.labels == ()
    assert own.code.startswith("# joint 2, dq1·dq3: depends on two other joints")


def test_a_play_in_the_load_is_hysteresis_and_no_code_is_suggested_for_it():
    trained = plain_arm().with_effects(plant.ForeignTorque(0, load_behind_play))
    diagnosis = lieid.diagnose(MODEL, run(trained, 1))
    assert diagnosis.steps == ()
    part = diagnosis.unexplained[0]
    assert (part.joint, part.depends_on, part.hysteresis) == (0, ("load1",), ("load1",))
    assert part.to_dict()["hysteresis"] == ["load1"]
    assert "depends on load1 (with hysteresis)" in diagnosis.sentence
    own = own_effects(diagnosis.unexplained)
    assert own.labels == ()
    assert own.code.startswith("# joint 1, hysteresis over load1")


def test_registered_names_are_not_used_again(by_angle):
    for name in ("own_2", "own_2b", "own_2c"):
        own = own_effects(by_angle[0].unexplained)
        assert own.labels == (f"{name}:2",)
        exec(compile(own.code, "own.py", "exec"), {})


def test_a_torque_that_is_the_same_in_all_recordings_is_no_difference_between_them():
    arm = plain_arm().with_effects(
        plant.ForeignTorque(1, lambda s: 0.05 * SIZE[1] * np.maximum(s.q[..., 0] - 0.1, 0.0) ** 2)
    )
    diagnosis = lieid.diagnose(MODEL, [run(arm, 1, "a"), run(arm, 2, "b")])
    assert diagnosis.steps == diagnosis.differing == ()
    assert [(part.joint, part.depends_on) for part in diagnosis.unexplained] == [(1, ("q1",))]
