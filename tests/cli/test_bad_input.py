"""Bad input through the command line: status 2, one line that names the location, no files."""

import json
import os
from pathlib import Path

import pytest
from cli.two_link_files import refused

from lieid_casadi.cli.main import main
from lieid_casadi.errors import UsageError


def test_unknown_effect_and_joint(run, good):
    misspelt = run("identify", "two_link", good, "--effects", "coulom")
    refused(misspelt, "'coulom'; expected coulomb", "lieid effects")
    refused(run("identify", "two_link", good, "--effects", "coulomb:3"), "joint 3")


@pytest.fixture(scope="module")
def fit_text(good, tmp_path_factory):
    path = tmp_path_factory.mktemp("fit") / "fit.json"
    assert main(["identify", "two_link", good, "-o", str(path)]) == 0
    return path.read_text()


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda text: text[: len(text) // 2], ["truncated"]),
        (lambda text: text.replace('"schema": 5', '"schema": 99'), ["99", "newer"]),
        (lambda text: text.replace('"values": [\n  ', '"values": [\n  NaN, '), ["not JSON"]),
        (lambda text: text.replace('"kind": "lieid-fit"', '"kind": "other"'), ["not a fit"]),
        (lambda text: text.replace('"values": [\n  ', '"values": [\n  1.5, '), ["values"]),
        (lambda text: text.replace('"coulomb:1"', '"cuolomb:1"'), ["cuolomb"]),
    ],
)
def test_fit_files(run, tmp_path, good, fit_text, damage, words):
    damaged = damage(fit_text)
    assert damaged != fit_text
    path = tmp_path / "fit.json"
    path.write_text(damaged)
    refused(run("compare", path, good), *words)
    refused(run("predict", path, good, "-o", tmp_path / "p.csv"), *words)
    assert not (tmp_path / "p.csv").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["excite", "two_link", "-o", "out", "--seed", "-1"],
        ["identify", "two_link", "x.csv", "--cutoff", "nan"],
        ["excite", "two_link", "-o", "out", "--duration", "inf"],
        ["identify", "two_link"],
        ["identify", "two_link", "x.csv", "--method", "magic"],
        ["identify", "two_link", "x.csv", "--cutoff", "fast"],
        ["identify", "two_link", "{good}", "--torque-constants", "1,b"],
        ["identify", "two_link", "{good}", "--torque-constants", "1"],
        ["identify", "two_link", "{good}", "--threads", "0"],
        ["identify", "two_link", "{good}", "--torque-constants", "0,1"],
        ["excite", "two_link", "-o", "out", "--duration", "1e300"],
        ["fly"],
        [],
    ],
)
def test_usage(run, tmp_path, monkeypatch, good, arguments):
    monkeypatch.chdir(tmp_path)
    refused(run(*(word.format(good=good) for word in arguments)))
    assert not list(tmp_path.iterdir())


OWN = """import casadi as ca
import lieid_casadi as lieid
@lieid.effect("own_broken", formula="a·q", coefficients={{"a": "N·m"}}, signals=["q"])
def own(s, shape):
    return [{column}]
{last}
"""


@pytest.mark.parametrize(
    ("content", "line", "words"),
    [
        ("x = 1\nraise RuntimeError('two\\nlines')\n", 2, "RuntimeError: two lines"),
        ("def f(:\n", 1, "SyntaxError"),
        ("import nothing_like_this\n", 1, "ModuleNotFoundError"),
        ("import sys\n\nsys.exit(0)\n", 3, "SystemExit"),
        (OWN.format(column="s.nothing", last=""), 5, "AttributeError"),
        (OWN.format(column="s.q", last="own(1, 2)"), 6, "TypeError"),
    ],
)
def test_an_exception_in_the_effects_file_names_the_line(run, tmp_path, good, content, line, words):
    path, out = tmp_path / "own.py", tmp_path / "out"
    path.write_text(content)
    effects = "own_broken:1" if "own_broken" in content else "coulomb"
    options = ["--effects", effects, "--effects-file", path, "-o", out]
    refused(run("identify", "two_link", good, *options), f"{path}, line {line}: {words}")
    assert not out.exists()
    from lieid_casadi.effects.registry import REGISTER

    REGISTER.pop("own_broken", None)


def test_an_interrupt_before_the_options_are_read_has_its_status(run, monkeypatch):
    def interrupted():
        raise KeyboardInterrupt

    monkeypatch.setattr("lieid_casadi.cli.main.build_parser", interrupted)
    assert run("show", "two_link") == (130, "", "lieid: interrupted\n")


def test_names_cannot_control_the_terminal(run, tmp_path, good):
    evil = "\x1b[2J\u202e:warning:[bold]"
    path = tmp_path / "arm.yaml"
    screw = "[0, 1, 0, 0, 0, 0]"
    path.write_text(
        json.dumps({"name": evil, "joints": [{"name": evil}]}).replace(
            '"name": "\\u001b[2J\\u202e:warning:[bold]"}',
            f'"name": {json.dumps(evil)}, "screw": {screw}}}',
        )
    )
    status, out, err = run("show", path)
    assert status == 0, err
    for text in (out, run("show", tmp_path / f"{evil}.yaml")[2], run(evil)[2]):
        assert "\x1b" not in text
        assert "\u202e" not in text
        assert r"\x1b[2J\u202e:warning:[bold]" in text


def test_names_that_are_not_utf8(run, tmp_path, good):
    """Bytes of file names that are not UTF-8 do not stop the output."""
    path = tmp_path / os.fsdecode(b"run\xff.csv")
    path.write_bytes(Path(good).read_bytes())
    fit, report = tmp_path / "fit.json", tmp_path / "r.html"
    status, _, err = run("identify", "two_link", path, "-o", fit, "--html", report)
    assert status == 0, err
    assert run("compare", fit, path)[0] == 0
    refused(run("identify", path, good), r"run\udcff.csv")


@pytest.mark.parametrize("options", [[], ["--test", "run.csv"], ["run.csv", "--train", "run.csv"]])
def test_diagnose_of_a_fit_states_both_questions(run, work, options):
    refused(run("diagnose", "fit.json", *options), "since", "lacks")


def test_with_training_data_diagnose_starts_from_the_effects_of_the_fit(run, work, monkeypatch):
    def stop(model, train, test, **_):
        raise UsageError(f"{' '.join(model.effects)} from {train[0].title}")

    monkeypatch.setattr("lieid_casadi.diagnosis.diagnose", stop)
    words = ["identify", "two_link", "run.csv", "--effects", "viscous,stribeck:2", "-o", "own.json"]
    assert run(*words)[0] == 0
    refused(run("diagnose", "own.json", "--train", "run.csv"), "viscous stribeck:2 from run.csv")
