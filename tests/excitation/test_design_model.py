"""The effects of a model that a design evaluates."""

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi.errors import NotCountedWarning
from lieid_casadi.excitation import excite
from lieid_casadi.excitation.information import InformationMatrix, design_model
from lieid_casadi.excitation.trajectory import MotionSamples

ROBOT = lieid.robots.two_link()


@pytest.mark.parametrize(
    ("effects", "expected", "messages"),
    [
        ("coulomb,viscous", ["coulomb", "viscous"], []),
        ("presliding,viscous", ["coulomb", "viscous"], ["replaced by coulomb in the regressor"]),
        ("presliding/load:2", ["coulomb:2", "load_friction:2"], ["by coulomb and load_friction"]),
        ("coulomb,presliding:1", ["coulomb"], ["presliding:1"]),
        ("viscous,temperature_friction", ["viscous"], ["temperature_friction:1"]),
        ("temperature_friction/exponential", ["viscous"], ["by viscous"]),
        ("viscous,base_tilt,torque_delay:2", ["viscous"], ["base_tilt, torque_delay:2"]),
        ("warm_up", ["warm_up"], []),
    ],
)
def test_effects_of_the_design_model(effects, expected, messages):
    reduced, warnings = design_model(lieid.Model(ROBOT, effects=effects))
    assert reduced.effects == expected
    assert len(warnings) == len(messages)
    for warning, message in zip(warnings, messages, strict=True):
        assert isinstance(warning, NotCountedWarning)
        assert message in str(warning)


def test_columns_that_depend_on_time():
    """Columns of `warm_up` by their formula, and the gradient by differences."""
    model = lieid.Model(ROBOT, effects="coulomb,viscous,warm_up")
    information = InformationMatrix(model, sign_width=np.full(2, 0.05))
    rng = np.random.default_rng(2)
    t = np.linspace(0.0, 40.0, 12)
    motion = MotionSamples(t, *(rng.normal(size=(12, 2)) for _ in range(3)))
    rows = information.at(motion).rows.reshape(-1, 2, 12)
    names = [model.base.names[k] for k in model.base.kept]
    column = rows[names.index("warm_up.f_tv:2")]
    np.testing.assert_allclose(column[0], 0.0)
    np.testing.assert_allclose(column[1], (1.0 - np.exp(-t / 300.0)) * motion.dq[:, 1], rtol=1e-9)

    weights = rng.normal(size=(len(names), len(names)))
    weights = weights + weights.T
    gradient = information.gradient(information.at(motion), weights)
    step = 1e-6
    for j, k in ((0, 3), (1, 11)):
        values = []
        for sign in (1.0, -1.0):
            dq = motion.dq.copy()
            dq[k, j] += sign * step
            moved = information.at(MotionSamples(t, motion.q, dq, motion.ddq))
            values.append(np.sum(weights * moved.gram()))
        assert np.isclose(gradient[j, 1, k], (values[0] - values[1]) / (2 * step), rtol=1e-5)


def test_a_design_warns_of_effects_that_it_leaves_out():
    model = lieid.Model(ROBOT, effects="presliding,viscous,warm_up:1,temperature_friction:2")
    options = {"duration": 8.0, "starts": 1, "max_iterations": 40, "limits": ()}
    found = excite(model, **options)
    plain = excite(lieid.Model(ROBOT, effects="coulomb,viscous,warm_up:1"), **options)
    assert found.condition_number == pytest.approx(plain.condition_number)
    assert found.to_dict()["effects"] == ["coulomb", "viscous", "warm_up:1"]
    assert [w["name"] for w in found.to_dict()["warnings"]] == ["NotCountedWarning"] * 2
    assert "temperature_friction:2" in found.summary()
    assert plain.warnings == ()
