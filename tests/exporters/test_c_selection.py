"""Exports with some of the functions: which exist, what they need, and refused names."""

import dataclasses

import pytest
from exporters.c_arms import ARMS, WARNINGS, made_fit, run, with_load_friction

import lieid_casadi as lieid
from lieid_casadi.cli.main import main
from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.c.functions import NAMES
from lieid_casadi.exporters.export import export

SOURCES = ["arm.c", "arm_parameters.c", "arm_test.c"]


def exported_names(folder):
    header = (folder / "arm.h").read_text(encoding="utf-8")
    return {name for name in NAMES if f"void arm_{name}(" in header}


@pytest.mark.parametrize(
    "requested",
    [["forward_dynamics"], ["torque", "mass_matrix"], ["effect_columns", "jacobian"]],
    ids=",".join,
)
def test_a_selection_builds_and_passes_its_self_test(tmp_path, requested):
    folder = tmp_path / "arm"
    export(ARMS["presliding"](), folder, functions=requested, to="c")
    run(["gcc", "-std=c99", *WARNINGS, *SOURCES, "-lm", "-o", "t"], folder)
    shown = run([str(folder / "t")], folder)
    assert shown.endswith("0 of the above differ by more than 1e-12\n")
    assert exported_names(folder) == set(requested)
    effects = {"forward_dynamics", "torque", "effect_columns"} & set(requested)
    assert ("void arm_advance(" in (folder / "arm.h").read_text()) == bool(effects)


def test_by_default_all_functions_are_exported(tmp_path):
    export(ARMS["presliding"](), tmp_path / "arm", to="c")
    assert exported_names(tmp_path / "arm") == set(NAMES)
    readme = (tmp_path / "arm" / "README.md").read_text()
    assert all(f"`arm_{name}`" in readme for name in NAMES)
    export(ARMS["rigid"](), tmp_path / "rigid", to="c")
    assert exported_names(tmp_path / "rigid") == set(NAMES) - {"effect_columns"}


def test_the_command_selects_functions(tmp_path, capsys):
    ARMS["rigid"]().save(tmp_path / "fit.json")
    words = ["export", str(tmp_path / "fit.json"), "-o", str(tmp_path / "arm")]
    assert main([*words, "--to", "c", "--functions", "jacobian,mass_matrix"]) == 0
    assert exported_names(tmp_path / "arm") == {"jacobian", "mass_matrix"}
    capsys.readouterr()
    for to, given, message in (
        ("c", "torque,inertia", "'inertia'; expected some of rigid_torque, gravity, mass_matrix"),
        ("c", "", "expected some of rigid_torque"),
        ("c", "effect_columns", "effect_columns: the fit has no effects"),
        ("urdf", "torque", "expected --to c"),
    ):
        assert main([*words, "--force", "--to", to, "--functions", given]) == 2
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1
    assert exported_names(tmp_path / "arm") == {"jacobian", "mass_matrix"}


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
    for name in ("arm.h", "README.md"):
        text = " ".join((tmp_path / "arm" / name).read_text().replace("*", " ").split())
        assert "is left out: the mass matrix is not positive definite" in text.replace("\\", "")
    with pytest.raises(ExportError, match="forward_dynamics: the mass matrix is not positive"):
        export(indefinite_fit(effects), tmp_path / "other", functions=["forward_dynamics"], to="c")
    assert not (tmp_path / "other").exists()


def test_unphysical_load_friction_has_no_forward_dynamics(tmp_path):
    """A friction of more than the load itself leaves the acceleration undetermined."""
    for size, has in ((0.005, True), (2.0, False)):
        fit = with_load_friction(made_fit(lieid.robots.two_link(), "load_friction/square"), size)
        made = export(fit, tmp_path / f"{size}", to="c")
        assert ("forward_dynamics" in exported_names(tmp_path / f"{size}")) is has
        assert any("changes by more than the load" in note for note in made.notes) is not has
