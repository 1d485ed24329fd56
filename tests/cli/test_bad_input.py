"""Bad input through the command line: status 2, one line that names the location, no files."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi.cli.main import main

URDF = """<robot name="arm">
  <link name="base"/><link name="upper">{inertial}</link><link name="fore">{inertial}</link>
  <joint name="shoulder" type="{kind}"><parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="50" velocity="3"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/>
    <origin xyz="0.5 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="50" velocity="3"/></joint>{more}
</robot>"""
INERTIAL = (
    '<inertial><origin xyz="0.2 0 0"/><mass value="3"/>'
    '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial>'
)


def urdf(*, kind="revolute", inertial=INERTIAL, more=""):
    return URDF.format(kind=kind, inertial=inertial, more=more)


def columns(n=2, seconds=8.0, rate=100.0):
    """A motion of the two-link arm with the torques of Pinocchio's plant, as named columns."""
    from lieid_casadi.plant import Arm, JointFriction, measure_along

    robot = lieid.robots.two_link()
    t = np.arange(0, seconds, 1 / rate)
    phase = 2 * np.pi * np.outer(t, [0.31, 0.47])
    w = 2 * np.pi * np.array([0.31, 0.47])
    q, dq, ddq = np.sin(phase), w * np.cos(phase), -(w**2) * np.sin(phase)
    friction = JointFriction(np.array([1.0, 0.5]), np.array([0.3, 0.2]), np.zeros(2))
    recording = measure_along(Arm(robot, robot.link_parameters, friction), t, q, dq, ddq)
    table = {"t": recording.t}
    for name, values in (("q", recording.q), ("dq", recording.dq), ("tau", recording.tau)):
        for j in range(n):
            table[f"{name}{j + 1}"] = values[:, j]
    return table


def write(path, table):
    data = np.column_stack(list(table.values()))
    np.savetxt(path, data, delimiter=",", header=",".join(table), comments="", fmt="%.10g")
    return str(path)


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    return write(tmp_path_factory.mktemp("good") / "run.csv", columns())


@pytest.fixture
def run(capsys):
    def call(*arguments):
        try:
            status = main([str(a) for a in arguments])
        except SystemExit as stop:
            status = stop.code
        output = capsys.readouterr()
        return status, output.out, output.err

    return call


def refused(outcome, *words):
    """The outcome is status 2 with one line on stderr that has these words."""
    status, _, err = outcome
    assert status == 2, err
    assert err.count("\n") == 1
    assert err.endswith("\n")
    for word in words:
        assert word in err


def test_missing_file(run, tmp_path):
    refused(run("identify", "two_link", tmp_path / "no.csv"), "no.csv", "no such file")


def test_missing_robot(run, good):
    refused(run("identify", "no.urdf", good), "no.urdf", "no such file")
    refused(run("identify", "armadillo", good), "armadillo", "two_link")


def test_not_a_csv(run, tmp_path):
    path = tmp_path / "picture.csv"
    path.write_bytes(bytes(range(256)) * 20)
    refused(run("identify", "two_link", path), "picture.csv")


def test_header_without_a_torque(run, tmp_path):
    table = columns()
    del table["tau2"]
    refused(run("identify", "two_link", write(tmp_path / "a.csv", table)), "a.csv", "tau2")


def test_wrong_number_of_joints(run, good):
    refused(run("identify", "panda", good), "run.csv", "2", "7")


def test_text_in_a_number(run, tmp_path, good):
    path = tmp_path / "a.csv"
    lines = Path(good).read_text().splitlines()
    lines[10] = lines[10].replace(lines[10].split(",")[3], "fast", 1)
    path.write_text("\n".join(lines))
    refused(run("identify", "two_link", path), "a.csv", "fast", "11")


def test_empty_file(run, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("")
    refused(run("identify", "two_link", path), "a.csv", "empty")


def test_one_row(run, tmp_path):
    table = {k: v[:1] for k, v in columns().items()}
    refused(run("identify", "two_link", write(tmp_path / "a.csv", table)), "a.csv")


def test_nan(run, tmp_path):
    table = columns()
    table["dq2"] = table["dq2"].copy()
    table["dq2"][20] = np.nan
    refused(run("identify", "two_link", write(tmp_path / "a.csv", table)), "a.csv", "dq2")


def test_time_going_back(run, tmp_path):
    table = columns()
    table["t"] = table["t"].copy()
    table["t"][30] = table["t"][10]
    refused(run("identify", "two_link", write(tmp_path / "a.csv", table)), "a.csv", "t")


def test_degrees(run, tmp_path):
    table = {k: np.degrees(v) if "q" in k else v for k, v in columns().items()}
    refused(run("identify", "two_link", write(tmp_path / "a.csv", table)), "a.csv", "rad")


@pytest.mark.parametrize("kind", ["floating", "planar", "ball"])
def test_joint_types(run, tmp_path, good, kind):
    path = tmp_path / "arm.urdf"
    path.write_text(urdf(kind=kind))
    refused(run("identify", path, good), "arm.urdf", "shoulder", kind)


def test_urdf_with_a_loop(run, tmp_path, good):
    path = tmp_path / "arm.urdf"
    closing = (
        '<joint name="bar" type="revolute"><parent link="base"/><child link="fore"/>'
        '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    )
    path.write_text(urdf(more=closing))
    refused(run("identify", path, good), "arm.urdf", "loop", "fore")


def test_not_xml(run, tmp_path, good):
    path = tmp_path / "arm.urdf"
    path.write_text("robot: arm")
    refused(run("identify", path, good), "arm.urdf", "not XML")


def test_a_urdf_without_inertias_identifies_all_the_same(run, tmp_path, good):
    path = tmp_path / "arm.urdf"
    path.write_text(urdf(inertial=""))
    status, _, err = run("identify", path, good, "--json", tmp_path / "a.json")
    assert status == 0, err
    assert json.loads((tmp_path / "a.json").read_text())["base_parameter_count"] == 12


@pytest.mark.parametrize(
    ("screw", "words"),
    [("[0, 2, 0, 0, 0, 0]", ["|ω| = 2", "expected 1"]), ("[0, 1, 0, 0, 1, 0]", ["screw"])],
)
def test_screws(run, tmp_path, good, screw, words):
    path = tmp_path / "arm.yaml"
    path.write_text(f"name: arm\njoints:\n  - {{name: a, screw: {screw}}}\n")
    refused(run("identify", path, good), "arm.yaml", "joints[0]", *words)


def test_unknown_effect_and_joint(run, good):
    refused(run("identify", "two_link", good, "--effects", "coulom"), "coulom", "expected")
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
        (lambda text: text.replace('"schema": 3', '"schema": 99'), ["99", "newer"]),
        (lambda text: text.replace('"values": [\n  ', '"values": [\n  NaN, '), ["NaN"]),
        (lambda text: text.replace('"kind": "lieid-fit"', '"kind": "other"'), ["not a fit"]),
        (lambda text: text.replace('"values": [\n  ', '"values": [\n  1.5, '), ["values"]),
        (lambda text: text.replace('"coulomb:1"', '"cuolomb:1"'), ["cuolomb"]),
        (lambda text: "[]", ["not a fit"]),
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


def test_stamps_of_almost_zero_length_are_refused_before_they_are_used(run, tmp_path):
    table = columns()
    table["t"] = table["t"] * 1e-300
    data = write(tmp_path / "run.csv", table)
    refused(run("identify", "two_link", data, "-o", tmp_path / "fit.json"), "column t", "mean rate")


def test_warnings_of_libraries_are_not_printed(tmp_path):
    table = columns()
    table["dq1"] = table["dq1"] * 1e-300  # overflows in SciPy's interpolation
    data = write(tmp_path / "run.csv", table)
    command = [sys.executable, "-m", "lieid_casadi.cli.main", "identify", "two_link", data]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "VelocityMismatch" in done.stdout


def test_output_that_cannot_be_written(run, tmp_path, good):
    (tmp_path / "file").write_text("")
    place = tmp_path / "file" / "fit.json"
    refused(run("identify", "two_link", good, "-o", place), "file", "not a folder")
    refused(run("identify", "two_link", good, "-o", tmp_path), "folder")
    refused(run("identify", "two_link", good, "-o", ""), "path of an output is empty")


def test_bad_input_writes_nothing(run, tmp_path):
    out = tmp_path / "new" / "fit.json"
    refused(run("identify", "two_link", tmp_path / "no.csv", "-o", out))
    assert not out.parent.exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["excite", "two_link", "-o", "out", "--seed", "-1"],
        ["diagnose", "two_link", "--train", "x.csv", "--seed", "1.5"],
        ["friction", "two_link", "x.csv", "--joint", "1", "--seed", "x"],
        ["demo", "--seed", "-1"],
        ["identify", "two_link", "x.csv", "--cutoff", "nan"],
        ["excite", "two_link", "-o", "out", "--duration", "inf"],
        ["identify", "two_link"],
        ["identify", "two_link", "x.csv", "--method", "magic"],
        ["identify", "two_link", "x.csv", "--cutoff", "fast"],
        ["identify", "two_link", "{good}", "--torque-constants", "1,b"],
        ["identify", "two_link", "{good}", "--torque-constants", "1,inf"],
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
        ("1 / 0\n", 1, "ZeroDivisionError"),
        ("raise GeneratorExit\n", 1, "GeneratorExit"),
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


def test_cutoff_beyond_the_rate(run, good):
    refused(run("identify", "two_link", good, "--cutoff", 400), "400", "Hz")


def test_a_killed_run_leaves_no_half_written_fit(tmp_path, good):
    """Kill the process in the middle of the write: the old file is still whole."""
    path = tmp_path / "fit.json"
    path.write_text("old")
    script = (
        "import os, sys\n"
        "import lieid_casadi.atomic_file as atomic\n"
        "replace = os.replace\n"
        "def die(*a): os.kill(os.getpid(), 9)\n"
        "os.replace = die\n"
        "from lieid_casadi.cli.main import main\n"
        f"main(['identify', 'two_link', {good!r}, '-o', {str(path)!r}])\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, check=False)
    assert done.returncode == -9
    assert path.read_text() == "old"
