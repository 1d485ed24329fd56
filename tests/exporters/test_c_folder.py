"""Folders of exported C: refused requests, files, and the command line."""

import casadi as ca
import numpy as np
import pytest
from exporters.c_arms import ARMS, made_fit

import lieid_casadi as lieid
from lieid_casadi.cli.main import main
from lieid_casadi.errors import ExportError
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
    import dataclasses

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

    from exporters.c_arms import run

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


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--to", "c", "--prefix", "9"], "prefix '9': expected letters"),
        (["--to", "urdf", "--prefix", "x"], "a prefix applies to C code"),
        (["--to", "mjcf", "--payload"], "--payload applies to C code"),
        (["--to", "urdf"], "--method feasible"),
        (["--to", "matlab"], "invalid choice: 'matlab'"),
    ],
)
def test_bad_requests_are_one_line_and_write_nothing(fit_file, tmp_path, capsys, words, message):
    command = ["export", str(fit_file), *words, "-o", str(tmp_path / "out")]
    try:
        status = main(command)
    except SystemExit as stop:
        status = stop.code
    assert status == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not names(tmp_path)
