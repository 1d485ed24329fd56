"""Bad input through the command line: status 2, one line that names the location, no files."""

import json
import os
import shlex
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli.two_link_files import columns, refused, tree, urdf, write

import lieid_casadi as lieid
from lieid_casadi.cli.main import main
from lieid_casadi.errors import UsageError

SEPARATE, EXPERIMENT = "discriminate fit.json -o out", "experiment two_link run.csv -o out --record"
RIVALS, COMMANDED = "stribeck:1 viscous_polynomial:1", "identify two_link commanded.csv"
REFUSED = [  # command line, and what the message states
    ("", ""),
    ("fly", ""),
    ("identify two_link", ""),
    ("identify two_link x.csv --cutoff nan", ""),
    ("identify two_link x.csv --cutoff fast", ""),
    ("identify two_link x.csv --method magic", ""),
    ("identify two_link run.csv --effects coulom", "'coulom'; expected coulomb"),
    ("identify two_link run.csv --effects coulomb:3", "joint 3"),
    ("identify two_link run.csv --torque-constants 1,b", ""),
    ("identify two_link run.csv --torque-constants 1", ""),
    ("identify two_link run.csv --torque-constants 0,1", ""),
    ("identify two_link run.csv --threads 0", ""),
    (f"{COMMANDED}", "expected --stiffness K1"),
    (f"{COMMANDED} --stiffness 1,2,3", "3 numbers; expected 1 or 2"),
    (f"{COMMANDED} --stiffness -1", "above 0, or unknown"),
    (f"{COMMANDED} --damping 1", "needs --stiffness"),
    (f"{COMMANDED} --servo sts9999", "expected one of sts3215"),
    (f"{COMMANDED} --servo sts3215 --stiffness 3", "expected one of them"),
    (f"{COMMANDED} --servo sts3215 --damping -1", "--damping"),
    (f"{COMMANDED} --known-mass elbow=1.0 --stiffness 3", "drives without stiffness"),
    (f"{COMMANDED} --known-mass elbow", "expected LINK=KG"),
    ("excite two_link -o out --seed -1", ""),
    ("excite two_link -o out --duration inf", ""),
    ("excite two_link -o out --duration 1e300", ""),
    ("excite two_link -o out --duration 0.2", "too short for the acceleration limit"),
    ("excite two_link -o out --start-pose 0 99", "joint 2"),
    ("excite two_link -o out --criterion best", "expected one of combined"),
    ("excite two_link -o out --margin 1.5", "margin: 1.5; expected more than 0, at most 1"),
    ("excite two_link -o out --acceleration 0", "acceleration"),
    ("excite two_link -o out --friction-sweep 7", "no joint 7"),
    ("excite two_link -o out --obstacle 1 1 1 0 0 0", "lower corner"),
    ("excite two_link -o out --capsules nowhere.yaml --self-collision", "nowhere.yaml"),
    (f"{SEPARATE} stribeck:1 stribeck:1", "twice"),
    (SEPARATE, "EFFECT"),
    (f"{SEPARATE} stribeck:1 striebeck:2", "striebeck"),
    (f"{SEPARATE} {RIVALS} --size stribeck:1=much", "--size"),
    (f"{SEPARATE} {RIVALS} --size stribeck:2=1", "stribeck:2"),
    (f"{SEPARATE} {RIVALS} --start-pose 9 0", "start pose"),
    (f"{SEPARATE} {RIVALS} --level 2", "level"),
    (f"{EXPERIMENT} 'cp {{trajectory}} {{recording}}'", "not a terminal"),
    (f"{EXPERIMENT} 'cp {{trajectory}}' --yes", "{recording}"),
    (f"{EXPERIMENT} 'cp {{trajectory}} {{recording}}' --yes --probe 0.2", "probe"),
    ("friction two_link run.csv --joint 3", "--joint 3: two_link has joints 1 to 2"),
    ("friction two_link run.csv --joint 1 --effects coulom", "unknown effect 'coulom'"),
    ("friction two_link run.csv --joint 1 --effects warm_up", "not friction of speed and load"),
    ("payload fit.json run.csv --cutoff -1", "cutoff"),
    ("payload fit.json run.csv --torque-constants 1,2,3", "3 numbers; expected 1 or 2"),
    ("payload fit.json gone.csv", "no such file"),
    ("payload run.csv run.csv", "not JSON; expected a fit"),
    ("gains two_link --unloaded run.csv --loaded run.csv --mass 0", "expected a number above 0"),
    ("export fit.json -o out --to c --prefix 9", "prefix '9': expected letters"),
    ("export fit.json -o out --to urdf --prefix x", "a prefix applies to C code"),
    ("export fit.json -o out --to mjcf --payload", "--payload applies to C code"),
    ("export fit.json -o out --to urdf", "--method feasible"),
    ("export fit.json -o out --to matlab", "invalid choice: 'matlab'"),
    ("sample fit.json -o out -n 0", "expected a whole number, 1 or more"),
    ("workbench no_such.urdf --no-browser", "no_such.urdf"),
    ("workbench two_link --effects wings --no-browser", "wings"),
    ("workbench two_link a.csv --train b.csv --no-browser", "a.csv"),
    ("workbench --train b.csv --no-browser", "without a robot"),
    ("workbench two_link --port 0 --no-browser", "port"),
    ("workbench two_link --effects-file missing.py --no-browser", "missing.py"),
]


@pytest.mark.parametrize(("line", "message"), REFUSED)
def test_a_command_that_cannot_be_run_is_one_line_and_writes_nothing(run, work, line, message):
    whole = lieid.Recording.load("run.csv")
    replace(whole, tau=None, command=whole.q + 0.01).save("commanded.csv")
    before = tree(work)
    refused(run(*shlex.split(line)), message)
    assert tree(work) == before


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
    joint = {"name": evil, "screw": [0, 1, 0, 0, 0, 0]}
    path.write_text(json.dumps({"name": evil, "joints": [joint]}))
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


def test_files_of_recordings(run, tmp_path, good):
    path = tmp_path / "a.csv"
    refused(run("identify", "two_link", path), "a.csv", "no such file")
    lines = Path(good).read_text().splitlines()
    lines[10] = lines[10].replace(lines[10].split(",")[3], "fast", 1)
    for content, words in (
        (bytes(range(256)) * 20, []),
        (b"", ["empty"]),
        (b"t,q1,q2,dq1,dq2,tau1\n0,1,2,3,4,5\n", ["tau2"]),
        ("\n".join(lines).encode(), ["fast", "11"]),
    ):
        path.write_bytes(content)
        refused(run("identify", "two_link", path), "a.csv", *words)
    refused(run("identify", "panda", good), "run.csv", "2", "7")
    refused(run("identify", "two_link", good, "--cutoff", 400), "400", "Hz")


def test_small_damage_and_columns_of_other_names_are_read(run, tmp_path):
    table = columns()
    names = {name: f"my_{name}" for name in table}
    stated = ",".join(f"{name}={column}" for name, column in names.items())
    table["dq2"] = table["dq2"].copy()
    table["dq2"][20] = np.nan
    file = write(tmp_path / "a.csv", {names[name]: x for name, x in table.items()})
    status, out, err = run("identify", "two_link", file, "--columns", stated)
    assert status == 0, err
    assert "1 of" in out + err
    refused(run("identify", "two_link", file), "a.csv", "--columns")


def test_warnings_of_libraries_are_not_printed(tmp_path):
    table = columns()
    table["dq1"] = table["dq1"] * 1e-300  # overflows in SciPy's interpolation
    data = write(tmp_path / "run.csv", table)
    words = ["identify", "two_link", data, "--despite-check"]  # the check finds the velocity
    command = [sys.executable, "-m", "lieid_casadi.cli.main", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "The recorded velocity of joint 1 " in done.stdout


def test_a_urdf_without_inertias_identifies_all_the_same(run, tmp_path, good):
    path = tmp_path / "arm.urdf"
    path.write_text(urdf(inertial=""))  # its zero is another than that of the recorded arm
    options = ["--despite-check", "--json", tmp_path / "a.json"]
    status, _, err = run("identify", path, good, *options)
    assert status == 0, err
    assert json.loads((tmp_path / "a.json").read_text())["base_parameter_count"] == 12
