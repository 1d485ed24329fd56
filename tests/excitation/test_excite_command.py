"""``lieid excite``: files, keys and exit statuses."""

import io
import json
from dataclasses import replace

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.cli import inputs
from lieid_casadi.cli.main import main

KEYS = {
    "condition_number", "start", "end", "neg_log_det", "solve_seconds", "build_seconds",
    "max_violation", "criterion", "coefficients",
}  # fmt: skip
QUICK = ["--duration", "6", "--starts", "1", "--rate", "200", "--unchecked-workspace"]
SHORT = [*QUICK, "--max-iterations", "30"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    target = tmp_path_factory.mktemp("design") / "new" / "out"
    assert main(["excite", "two_link", "-o", str(target), *QUICK]) == 0
    return target


def test_files_and_keys(folder):
    names = {path.name for path in folder.iterdir()}
    assert names >= {"trajectory.csv", "excitation.json", "excitation.png", "summary.txt"}
    content = json.loads((folder / "excitation.json").read_text())
    assert content.keys() >= KEYS
    assert content["criterion"] == "combined"
    assert content["max_violation"] == 0.0
    assert "Not checked: " in (folder / "summary.txt").read_text()


def test_csv_matches_the_coefficients_in_json(folder):
    lines = (folder / "trajectory.csv").read_text().splitlines()
    comments = [line for line in lines if line.startswith("#")]
    assert "# not checked: floor" in comments
    header = lines[len(comments)].split(",")
    assert header == ["t", "q1", "q2", "dq1", "dq2", "ddq1", "ddq2"]
    rows = np.loadtxt(folder / "trajectory.csv", delimiter=",", skiprows=len(comments) + 1)
    assert len(rows) == 6 * 200 + 1
    c = json.loads((folder / "excitation.json").read_text())["coefficients"]
    w, t = 2.0 * np.pi * c["base_frequency"], rows[:, 0]
    for j in range(2):
        q = c["q0"][j] + sum(
            a / (k * w) * np.sin(k * w * t) - b / (k * w) * np.cos(k * w * t)
            for k, (a, b) in enumerate(zip(c["a"][j], c["b"][j], strict=True), start=1)
        )
        np.testing.assert_allclose(rows[:, 1 + j], q, atol=1e-9)


def test_plot_leaves_global_state_alone():
    import matplotlib as mpl

    before = dict(mpl.rcParams)
    model = lieid.Model(replace(lieid.robots.two_link(), name="a$x^{$"))
    found = lieid.excitation.excite(model, duration=6.0, starts=1, max_iterations=20)
    figure = found.plot()
    figure.savefig(io.BytesIO(), format="png")  # "$" in a name is no formula
    assert "a$x^{$" in figure.axes[0].get_title()
    assert len(figure.axes) == 1
    assert dict(mpl.rcParams) == before


def test_a_folder_with_content_needs_force(folder, capsys):
    assert main(["excite", "two_link", "-o", str(folder), *QUICK]) == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert "not empty" in captured.err
    (folder / "old.txt").write_text("old")
    assert main(["excite", "two_link", "-o", str(folder), "--force", *SHORT]) == 0
    assert (folder / "old.txt").read_text() == "old"


@pytest.mark.parametrize(
    ("options", "status", "message"),
    [
        (["--start-pose", "0", "99"], 2, "joint 2"),
        (["--duration", "0.2"], 2, "too short for the acceleration limit"),
        (["--wall", "0", "0", "1", "-5"], 3, "every pose violates a limit"),
        (["--criterion", "best"], 2, "expected one of combined"),
        (["--margin", "1.5"], 2, "margin: 1.5; expected more than 0, at most 1"),
        (["--acceleration", "0"], 2, "acceleration"),
        (["--friction-sweep", "7"], 2, "no joint 7"),
        (["--obstacle", "1", "1", "1", "0", "0", "0"], 2, "lower corner"),
        (["--capsules", "nowhere.yaml", "--self-collision"], 2, "nowhere.yaml"),
    ],
)
def test_bad_input_gives_one_line_and_no_files(tmp_path, capsys, options, status, message):
    target = tmp_path / "out"
    assert main(["excite", "two_link", "-o", str(target), *QUICK, *options]) == status
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert message in captured.err
    assert list(tmp_path.iterdir()) == []


def test_friction_sweep(tmp_path, capsys):
    target = tmp_path / "runs"
    report = tmp_path / "a.json"
    arguments = ["--friction-sweep", "2", "--no-torque", "--json", str(report)]
    assert main(["excite", "two_link", "-o", str(target), *arguments]) == 0
    assert {p.name for p in target.iterdir()} == {
        "friction_sweep_q2.csv", "friction_sweep_q2.json", "lieid-manifest.json",
    }  # fmt: skip
    assert json.loads(report.read_text())["sweeps"][0]["joint"] == 2


def test_a_fit_in_place_of_the_robot(tmp_path, capsys):
    """Its effects and torque are used; options for another model are refused."""
    robot = lieid.robots.two_link()
    t = np.arange(0.0, 10.0, 0.01)
    motion = plant.FourierTrajectory(robot, base_frequency=0.1, seed=2).at(t)
    recording = plant.measure_along(plant.demo_arm(robot, hidden=None), t, *motion)
    fit = tmp_path / "fit.json"
    lieid.identify(lieid.Model(robot, ["coulomb", "viscous"]), recording).save(fit)
    target = tmp_path / "out"
    assert main(["excite", str(fit), "-o", str(target), *SHORT]) == 0
    content = json.loads((target / "excitation.json").read_text())
    assert content["effects"] == ["coulomb", "viscous"]
    assert any("by the fit with all effects, ± 2 standard" in text for text in content["checked"])
    capsys.readouterr()
    for option in (["--effects", "coulomb"], ["--tip", "link"], ["--lock", "elbow"]):
        assert main(["excite", str(fit), "-o", str(tmp_path / "no"), *option]) == 2
        assert "a fit" in capsys.readouterr().err
    sweep = ["--friction-sweep", "1", "--json", str(tmp_path / "s.json"), "--unchecked-workspace"]
    assert main(["excite", str(fit), "-o", str(tmp_path / "runs"), *sweep]) == 0
    unchecked = json.loads((tmp_path / "s.json").read_text())["sweeps"][0]["unchecked"]
    assert {"floor", "self-collision", "tool speed"} <= set(unchecked)
    assert "Not checked: " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ([], ["Torque", "CartesianSpeed", "Wall", "SelfCollision"]),
        (["--floor", "none"], ["Torque", "CartesianSpeed", "SelfCollision"]),
        (["--unchecked-workspace"], ["Torque"]),
        (
            ["--cartesian-speed", "1", "--floor", "--self-collision", "--wall", "1", "0", "0",
             "0.8", "--workspace-box", "-1", "-1", "-1", "1", "1", "2",
             "--obstacle", "0.5", "-0.1", "0", "0.7", "0.1", "0.3"],
            ["Torque", "CartesianSpeed", "Wall", "SelfCollision", *["Wall"] * 7, "Obstacle"],
        ),
    ],
)  # fmt: skip
def test_limits_of_the_options(options, expected):
    from lieid_casadi.cli.main import build_parser

    arguments = build_parser().parse_args(["excite", "panda", "-o", "x", *options])
    limits = inputs.limits_of(arguments, lieid.robots.panda())
    assert [type(limit).__name__ for limit in limits] == expected
    assert limits[0].fraction == 0.8


def test_interrupt_keeps_the_trajectory(tmp_path, monkeypatch):
    import lieid_casadi.excitation as package

    calls = []

    def quick(model, **options):
        def progress(stage, fraction):
            calls.append(stage)
            if len(calls) == 60:
                raise KeyboardInterrupt

        return original(model, **{**options, "progress": progress, "starts": 4})

    original = package.excite
    monkeypatch.setattr(package, "excite", quick)
    target = tmp_path / "out"
    assert main(["excite", "two_link", "-o", str(target), *QUICK]) == 130
    content = json.loads((target / "excitation.json").read_text())
    assert content["interrupted"] is True
    assert content["max_violation"] == 0.0
