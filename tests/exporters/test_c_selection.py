"""Which functions exported C has, and what is left out."""

import dataclasses

import pytest
from exporters.c_arms import ARMS, made_fit, with_load_friction

import lieid_casadi as lieid
from lieid_casadi.exporters.c.functions import NAMES
from lieid_casadi.exporters.export import export


def exported_names(folder):
    header = (folder / "arm.h").read_text(encoding="utf-8")
    return {name for name in NAMES if f"void arm_{name}(" in header}


def test_all_functions_are_exported(tmp_path):
    export(ARMS["presliding"](), tmp_path / "arm", to="c")
    assert exported_names(tmp_path / "arm") == set(NAMES)
    export(ARMS["rigid"](), tmp_path / "rigid", to="c")
    assert exported_names(tmp_path / "rigid") == set(NAMES) - {"effect_columns"}


def indefinite_fit(effects):
    fit = made_fit(lieid.robots.two_link(), effects)
    links = fit.parameters.copy()
    links[10:20] *= -1.0
    return dataclasses.replace(fit, parameters=links)


@pytest.mark.parametrize("effects", ["viscous", ""])
def test_an_indefinite_mass_matrix_has_no_forward_dynamics(tmp_path, effects):
    made = export(indefinite_fit(effects), tmp_path / "arm", to="c")
    (note,) = [note for note in made.notes if note.startswith("forward_dynamics is left out")]
    assert "--method feasible" in note
    assert "forward_dynamics" not in exported_names(tmp_path / "arm")
    text = " ".join((tmp_path / "arm" / "arm.h").read_text().replace("*", " ").split())
    assert "is left out: the mass matrix is not positive definite" in text


def test_unphysical_load_friction_has_no_forward_dynamics(tmp_path):
    """A friction of more than the load itself leaves the acceleration undetermined."""
    for size, has in ((0.005, True), (2.0, False)):
        fit = with_load_friction(made_fit(lieid.robots.two_link(), "load_friction/square"), size)
        made = export(fit, tmp_path / f"{size}", to="c")
        assert ("forward_dynamics" in exported_names(tmp_path / f"{size}")) is has
        assert any("changes by more than the load" in note for note in made.notes) is not has
