"""Friction models of the literature as sets of effects."""

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi.effects.friction_models import FRICTION_MODELS, friction_model
from lieid_casadi.errors import EffectError

COUNTS = {  # coefficients and shapes per joint, as published (or as the note says)
    "coulomb_viscous": 3, "stribeck": 4, "tustin": 5, "eq7": 7, "paper": 10, "simplified": 5,
    "gao2017": 6, "gao2017_constant_temperature": 5, "he2021": 7, "madsen2020": 6,
    "panda_sigmoid": 3, "load_constant": 2, "load_absolute": 3, "load_square": 3, "hamon2010": 5,
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(FRICTION_MODELS))
def test_each_set_is_a_model_with_finite_columns(name):
    published = friction_model(name)
    model = lieid.Model(lieid.robots.two_link(), published.effects)
    assert len(model.columns) + len(model.shapes) == 2 * COUNTS[name]
    assert published.source
    rng = np.random.default_rng(0)
    q, dq, ddq, load, temperature = rng.normal(size=(5, 20, 2))
    dq[:3] = 0.0
    load[:2] = 0.0
    columns = lieid.compile(model).effect_columns(
        q, dq, ddq, load=load, temperature=temperature, time=np.linspace(0.0, 1.0, 20)
    )
    assert np.isfinite(columns).all()
    assert np.all(np.abs(columns).max(axis=(0, 1)) > 0.0)


def test_an_unknown_set_is_refused():
    with pytest.raises(EffectError, match=r"unknown friction model 'eq9'.*paper"):
        friction_model("eq9")
