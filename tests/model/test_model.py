"""Models: placement of effects, columns, batches of samples."""

import pickle

import casadi as ca
import numpy as np
import pytest
from robot.random_arms import random_arm
from scipy.special import erf

import lieid_casadi as lieid
from lieid_casadi.effects import LIBRARY, Effect, make
from lieid_casadi.effects.effect import Signals
from lieid_casadi.effects.registry import REGISTER, EffectVariant
from lieid_casadi.errors import EffectError


def test_placements_follow_the_order_of_the_text():
    model = lieid.Model(lieid.robots.panda(), "viscous:7+2,coulomb,transmission_coupling:5<6")
    labels = [p.label for p in model.placements]
    assert labels[:2] == ["viscous:7", "viscous:2"]
    assert labels[-1] == "transmission_coupling:5<6"
    assert model.effects == ["viscous:7+2", "coulomb", "transmission_coupling:5<6"]
    more = model.with_effect("stribeck", joints=[3])  # Python counts from 0
    assert more.effects[-1] == "stribeck:4"
    assert [s.joint for s in more.shapes] == [3]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("coulom", "unknown effect 'coulom'"),
        ("coulomb:9", "no joint 9"),
        ("coulomb:x", "'x' is not a joint"),
        ("coulomb:0", "no joint 0"),
        ("transmission_coupling", "couples two joints"),
        ("coulomb:1<2", "acts on one joint"),
        ("coulomb,coulomb:2", "given twice"),
        ("stribeck/wide", "unknown effect 'stribeck/wide'"),
        ("presliding/gms", "unknown effect"),
        ("smooth/x:1", "expected one or two of q, dq"),
        ("smooth/q.q:1", "no option"),
        ("smooth/q9:1", "no joint 9"),
        ("smooth/q2:2", "leave out the number 2"),
    ],
)
def test_bad_effects_are_named(text, message):
    with pytest.raises(EffectError, match=message):
        lieid.Model(lieid.robots.two_link(), text)


def test_base_regressor_is_full_regressor_times_parameters():
    rng = np.random.default_rng(5)
    for robot in (lieid.robots.panda(), random_arm(rng, 5)):
        model = lieid.Model(robot, "coulomb,viscous,offset,armature,stribeck,load_friction/paper")
        arm = lieid.compile(model)
        q, dq, ddq, load = rng.normal(size=(4, 20, robot.n))
        full = np.concatenate(
            [arm.regressor(q, dq, ddq), arm.effect_columns(q, dq, ddq, load=load)], axis=2
        )
        parameters = rng.normal(size=full.shape[2])
        base = arm.base_regressor(q, dq, ddq, load=load)
        torque = full @ parameters
        error = base @ (model.base.combination @ parameters) - torque
        assert np.abs(error).max() <= 1e-10 * np.abs(torque).max()


def test_the_sign_is_zero_at_rest_and_ramps_over_the_dead_zone():
    arm = lieid.compile(lieid.Model(lieid.robots.two_link(), "coulomb,viscous"))
    dq = np.array([[0.0, 0.01], [0.2, -0.2], [-0.01, np.nan]])
    ramped = arm.effect_columns(dq * 0, dq, dq * 0, dead_zone=[0.05, 0.05])[:, [0, 1], [0, 1]]
    expected = erf(3.0 * 0.2 / np.sqrt(2.0))  # the mean sign beside noise of a third of the zone
    np.testing.assert_allclose(
        ramped, [[0.0, expected], [1.0, -1.0], [-expected, np.nan]], atol=0.04
    )
    sharp = arm.effect_columns(dq * 0, dq, dq * 0)[:, [0, 1], [0, 1]]
    np.testing.assert_array_equal(sharp, [[0.0, 1.0], [1.0, -1.0], [-1.0, np.nan]])


@pytest.mark.parametrize("name", sorted(REGISTER))
def test_an_effect_states_what_it_uses(name):
    """The stated signals are exactly those that the columns depend on."""
    effect = make(name)
    names = ["q", "dq", "ddq", "sign", "load", "temperature", "time", "command_error"]
    own = {k: ca.SX.sym(k) for k in names}
    other = {k: ca.SX.sym(f"other_{k}") for k in names}
    partner = Signals(**other) if effect.couples else None
    shape = {s.name: ca.SX.sym(s.name) for s in effect.shapes}
    state = {s.name: ca.SX.sym(s.name) for s in effect.states}
    now = Signals(**own, other=partner, state=state)
    columns = ca.vertcat(*effect.columns(now, shape))
    assert columns.shape[0] == len(effect.coefficients)
    if state:
        past = Signals(**{k: ca.SX.sym(f"past_{k}") for k in names}, state=state)
        columns = ca.vertcat(columns, *effect.advance(past, now, shape))
    used = {k for k in names if ca.depends_on(columns, ca.vertcat(own[k], other[k]))}
    assert used == set(effect.signals) - {"other"}


def test_user_effect_with_the_decorator():
    @lieid.effect("test_cogging", formula="a·sin(6q)", coefficients={"a": "N·m"}, signals=["q"])
    def cogging(s, shape):
        return [ca.sin(6 * s.q)]

    arm = lieid.compile(lieid.Model(lieid.robots.two_link(), "test_cogging:2"))
    q = np.array([[0.1, 0.2]])
    columns = arm.effect_columns(q, q, q)
    np.testing.assert_allclose(columns[0, :, 0], [0.0, np.sin(1.2)])
    with pytest.raises(EffectError, match="taken"):
        lieid.effect("coulomb", formula="", coefficients={})(lambda s, shape: [])


def test_an_effect_whose_code_raises_is_named_and_left_out_of_a_search():
    """The library of a model is what was registered when it was made."""
    robot = lieid.robots.two_link()
    before = lieid.Model(robot)

    @lieid.effect("test_broken", formula="?", coefficients={"a": "N·m"})
    def broken(s, shape):
        return [missing_name * s.q]  # noqa: F821

    try:
        after = lieid.Model(robot)
    finally:
        del REGISTER["test_broken"]
    assert before.unusable_effects == []
    (warning,) = after.unusable_effects
    assert str(warning).startswith("effect test_broken: its code raises NameError")
    t = np.arange(0.0, 5.0, 0.02)[:, None]
    q, dq, ddq = np.sin([1, 2] * t), [1, 2] * np.cos([1, 2] * t), [-1, -4] * np.sin([1, 2] * t)
    tau = lieid.compile(before).inverse_dynamics(q, dq, ddq, robot.link_parameters)
    tau = tau + 0.01 * np.random.default_rng(0).normal(size=tau.shape)
    recording = lieid.Recording.from_arrays(t[:, 0], q, dq, tau)
    found = lieid.diagnose(after.with_effect("viscous"), recording)
    assert str(warning) in [str(w) for w in found.warnings]


def test_sliding_joints_have_newtons():
    robot = random_arm(np.random.default_rng(2), 3)
    model = lieid.Model(robot, "viscous,coulomb")
    for column in model.columns:
        revolute = robot.joints[column.joint].revolute
        assert ("N·m" in column.unit) == revolute


def test_a_model_is_pickled_without_effects_that_cannot_be_imported():
    class Local(Effect):
        name = "local_effect"

    library = {**REGISTER, "local_effect": EffectVariant(Local, "")}
    model = lieid.Model(lieid.robots.two_link(), "viscous", library=library)
    again = pickle.loads(pickle.dumps(model))
    assert "local_effect" not in again.library
    assert "stribeck" in again.library
    assert again.effects == model.effects
    assert "local_effect" in model.library


@pytest.mark.parametrize("kind", LIBRARY, ids=lambda kind: kind.name)
def test_the_library_is_documented_by_data(kind):
    """The effect atlas and `lieid effects` are generated from these attributes."""
    names = {other.name for other in LIBRARY}
    assert kind.__doc__
    assert kind.revealed_by
    assert kind.typical
    assert set(kind.confused_with) <= names - {kind.name}
    for option in ("", *kind.options):
        effect = make(f"{kind.name}/{option}" if option else kind.name)
        assert effect.formula
        assert all(c.unit for c in effect.coefficients)
        assert all(s.lower <= s.initial <= s.upper < np.inf for s in effect.shapes)
        assert all(item.meaning for item in (*effect.coefficients, *effect.shapes))
        assert set(effect.replaces + effect.counted_as + effect.accompanied_by) <= names


def test_every_module_of_the_library_is_registered():
    """Adding an effect is adding one file: no list has to be edited."""
    from pathlib import Path

    from lieid_casadi import effects

    folder = Path(effects.__file__).parent
    defined = {path.stem for path in folder.glob("*.py") if "\n@register\n" in path.read_text()}
    assert {kind.__module__.rpartition(".")[2] for kind in LIBRARY} == defined
