"""What each command prints and writes; the real arms through the command line."""

import csv
import json

import numpy as np
import pytest
from cli.two_link_files import columns, write
from comparison import two_link_data as arm

import lieid_casadi as lieid
from lieid_casadi.cli.main import main
from lieid_casadi.tables import figures

IDENTIFY_KEYS = {
    "rms_train", "rms_test", "correlation_test", "rms_train_raw", "rms_test_raw", "cutoff",
    "warnings", "base_parameter_count", "condition_number", "physically_consistent", "parameters",
}  # fmt: skip


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    table = columns(seconds=16.0)
    half = len(table["t"]) // 2
    parts = [{k: v[:half] for k, v in table.items()}, {k: v[half:] for k, v in table.items()}]
    return [write(folder / f"{k}.csv", part) for k, part in enumerate(parts)]


def test_version(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--version"])
    assert stop.value.code == 0
    assert capsys.readouterr().out.strip() == f"lieid {lieid.__version__}"


def test_identify_writes_fit_json_and_report(runs, tmp_path, capsys):
    out, report = tmp_path / "new" / "a.json", tmp_path / "r.html"
    fit = tmp_path / "new" / "fit.json"
    arguments = ["identify", "two_link", runs[0], "--test", runs[1], "-o", fit]
    assert main([str(a) for a in [*arguments, "--json", out, "--html", report]]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert "coulomb.f_c:2" in captured.out
    content = json.loads(out.read_text())
    assert content.keys() >= IDENTIFY_KEYS
    assert "rms_cv" not in content
    assert len(content["rms_test"]) == len(content["correlation_test"]) == 2
    assert min(content["correlation_test"]) > 0.99
    errors = [line.split()[2] for line in captured.out.splitlines() if line[2:3] in ("1", "2")][:2]
    moving = lieid.compare(lieid.Fit.load(fit), lieid.Recording.load(runs[1])).rms_moving
    assert errors == [figures(x) for x in moving]  # the digits that `compare` and the page show
    assert {"name", "joint", "value", "std", "unit"} <= content["parameters"][0].keys()
    assert {p["joint"] for p in content["parameters"]} == {1, 2}
    assert report.read_text().startswith("<!DOCTYPE html>")
    assert lieid.Fit.load(fit).model.effects == ["coulomb", "viscous", "offset"]


def test_predict_and_compare(runs, tmp_path, capsys):
    fit, predicted = tmp_path / "fit.json", tmp_path / "deep" / "er" / "p.csv"
    assert main(["identify", "two_link", runs[0], "-o", str(fit)]) == 0
    assert main(["predict", str(fit), runs[1], "-o", str(predicted)]) == 0
    rows = list(csv.reader(predicted.read_text().splitlines()))
    assert rows[0] == ["t", "tau1", "tau2"]
    measured = lieid.Recording.load(runs[1])
    table = np.array(rows[1:], dtype=float)
    np.testing.assert_allclose(table[:, 0], measured.t, rtol=1e-9)
    assert np.isfinite(table).all()
    out = tmp_path / "c.json"
    capsys.readouterr()
    arguments = ["compare", str(fit), runs[1], "--json", str(out)]
    assert main(arguments) == 0
    assert "Largest errors" in capsys.readouterr().out
    assert len(json.loads(out.read_text())["rms"]) == 2


def test_show_names_the_base_parameters(tmp_path, capsys):
    out = tmp_path / "a.json"
    assert main(["show", "panda", "--json", str(out)]) == 0
    text = capsys.readouterr().out
    assert "43 base parameters" in text
    assert "mcx3 + 0.0825 (m4 + m5 + m6 + m7)" in text
    content = json.loads(out.read_text())
    assert content["base_parameter_count"] == 43
    assert content["schema"] == 1


def test_effects_lists_the_library_and_describes_one_effect(tmp_path, capsys):
    out = tmp_path / "a.json"
    assert main(["effects", "--json", str(out)]) == 0
    shown = capsys.readouterr().out
    names = {effect["name"] for effect in json.loads(out.read_text())["effects"]}
    assert {"coulomb", "stribeck/two_width", "payload"} <= names
    assert "f_c·sgn(q̇)" in shown
    assert main(["effects", "stribeck"]) == 0
    shown = capsys.readouterr().out
    for text in ("(f_s − f_c)·sgn(q̇)", "v_s [rad/s]", "revealed by", "confused with presliding"):
        assert text in shown
    assert main(["effects", "stribek"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_own_effect_from_a_file(runs, tmp_path, capsys):
    code = tmp_path / "mine.py"
    code.write_text(
        "import casadi as ca\nimport lieid_casadi as lieid\n"
        "@lieid.effect('cli_waves', formula='a·sin(6q)', coefficients={'a': 'N·m'}, "
        "signals=['q'])\ndef waves(s, shape):\n    return [ca.sin(6 * s.q)]\n"
    )
    fit = tmp_path / "fit.json"
    arguments = ["identify", "two_link", runs[0], "--effects", "viscous,cli_waves:2"]
    assert main([*arguments, "--effects-file", str(code), "-o", str(fit)]) == 0
    assert "cli_waves.a:2" in capsys.readouterr().out
    from lieid_casadi.effects.registry import REGISTER

    del REGISTER["cli_waves"]
    assert main(["compare", str(fit), runs[1]]) == 2
    assert "--effects-file" in capsys.readouterr().err
    assert main(["compare", str(fit), runs[1], "--effects-file", str(code)]) == 0


def test_show_lists_effects_and_values_of_a_fit(tmp_path, capsys):
    robot = lieid.robots.two_link()
    fit = lieid.identify(lieid.Model(robot, "coulomb,viscous"), arm.recording(12.0, seed=1))
    fit.save(tmp_path / "fit.json")
    out = tmp_path / "show.json"
    assert main(["show", str(tmp_path / "fit.json"), "--json", str(out)]) == 0
    content = json.loads(out.read_text())
    assert content["effects"] == ["coulomb", "viscous"]
    _, friction = (r for r in content["parameters"] if r["name"] == "coulomb.f_c")
    assert friction["value"] == pytest.approx(1.5, rel=0.1)  # simulated
    shown = capsys.readouterr().out
    assert "Values (wls, coulomb, viscous)" in shown
    assert f"{friction['value']:.4g}" in shown
