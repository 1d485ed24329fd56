"""Folders of exported C: refused requests, files, and the command."""

import dataclasses

import casadi as ca
import numpy as np
import pytest
from exporters.c_arms import ARMS, made_fit, run, with_load_friction

import lieid_casadi as lieid
from lieid_casadi.cli.main import main
from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.c.functions import NAMES
from lieid_casadi.exporters.export import export
from lieid_casadi.output_folder import MANIFEST, write_folder

FILES = {
    "arm.h", "arm.c", "arm_parameters.c", "arm_test.c", "lieid_runtime.h", "CMakeLists.txt",
    MANIFEST,
}  # fmt: skip


@pytest.fixture(scope="module")
def fit():
    return ARMS["presliding"]()


@pytest.fixture(scope="module")
def fit_file(fit, tmp_path_factory):
    path = tmp_path_factory.mktemp("fits") / "fit.json"
    fit.save(path)
    return path


def names(folder):
    return {path.name for path in folder.iterdir()}


def test_all_files_and_nothing_else(fit, tmp_path):
    made = export(fit, tmp_path / "new" / "arm", to="c")
    assert names(tmp_path / "new" / "arm") == FILES
    assert {path.name for path in made.files} == FILES - {MANIFEST}
    assert names(tmp_path / "new") == {"arm"}
    export(fit, tmp_path / "empty", prefix="left2", to="c")
    assert "left2_test.c" in names(tmp_path / "empty")


@pytest.mark.parametrize("prefix", ["", "2arm", "my-arm", "é", "arm;", "lieid_runtime", "LIEID_x"])
def test_prefix_must_be_a_name_of_its_own(fit, tmp_path, prefix):
    with pytest.raises(ExportError, match=r"expected letters, digits and _"):
        export(fit, tmp_path / "arm", prefix=prefix, to="c")
    assert not names(tmp_path)


def test_failure_leaves_the_folder_as_it_was(tmp_path):
    class Erf(lieid.Effect):
        name = "erf_friction"
        formula = "f·erf(q̇)"
        coefficients = (lieid.Coefficient("f", "N·m"),)

        def columns(self, s, shape):
            return [ca.erf(s.dq)]

    fit = made_fit(lieid.robots.two_link(), [Erf()])
    write_folder(tmp_path / "arm", {"old.c": b"old"})
    with pytest.raises(ExportError, match="operation ERF, which exported C does not have"):
        export(fit, tmp_path / "arm", force=True, to="c")
    assert names(tmp_path) == {"arm"}
    assert names(tmp_path / "arm") == {"old.c", MANIFEST}


def test_numbers_that_are_not_finite_are_refused(tmp_path):
    fit = ARMS["rigid"]()
    broken = dataclasses.replace(fit, parameters=np.where(fit.parameters > 0.1, np.nan, 0.0))
    with pytest.raises(ExportError, match="nan; expected finite"):
        export(broken, tmp_path / "arm", to="c")
    assert not names(tmp_path)


def test_user_effect_is_exported(tmp_path):
    class Waves(lieid.Effect):
        name = "atan_friction"
        formula = "f·atan(q̇/0.1) + g·|sin 3q|^1.5"
        coefficients = (lieid.Coefficient("f", "N·m"), lieid.Coefficient("g", "N·m"))
        signals = ("q", "dq")

        def columns(self, s, shape):
            return [ca.atan(s.dq / 0.1), ca.fabs(ca.sin(3 * s.q)) ** 1.5]

    export(made_fit(lieid.robots.two_link(), [Waves()]), tmp_path / "arm", to="c")
    sources = ["arm.c", "arm_parameters.c", "arm_test.c"]
    run(["gcc", "-std=c99", *sources, "-lm", "-o", "t"], tmp_path / "arm")
    run([str(tmp_path / "arm" / "t")], tmp_path / "arm")


def test_command_writes_c(fit_file, tmp_path, capsys):
    out = tmp_path / "arm"
    assert main(["export", str(fit_file), "--to", "c", "-o", str(out)]) == 0
    assert names(out) == FILES
    captured = capsys.readouterr()
    assert "arm_test.c" in captured.out
    assert captured.err == ""
    assert main(["export", str(fit_file), "--to", "c", "-o", str(out)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    force = ["--force", "--prefix", "scara"]
    assert main(["export", str(fit_file), "--to", "c", "-o", str(out), *force]) == 0
    assert "scara.h" in names(out)


# -- which functions exported C has --


def exported_names(folder):
    header = (folder / "arm.h").read_text(encoding="utf-8")
    return {name for name in NAMES if f"void arm_{name}(" in header}


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
