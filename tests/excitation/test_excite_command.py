"""``lieid excite``, requests that are refused, and runs at constant speeds."""

import json
from dataclasses import replace

import numpy as np
import pytest
from exporters.c_arms import made_fit

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.cli import inputs
from lieid_casadi.cli.main import build_parser, main
from lieid_casadi.errors import ExcitationError, NoSolution, RobotError
from lieid_casadi.excitation import CartesianSpeed, Torque, Wall, excite, floor, friction_sweep
from lieid_casadi.excitation.limits import motion_range
from lieid_casadi.robot.yaml_file import write_yaml

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


def test_a_folder_with_content_needs_force(folder, capsys):
    assert main(["excite", "two_link", "-o", str(folder), *QUICK]) == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert "not empty" in captured.err
    (folder / "old.txt").write_text("old")
    assert main(["excite", "two_link", "-o", str(folder), "--force", *SHORT]) == 0
    assert (folder / "old.txt").read_text() == "old"


def test_a_request_without_a_solution_has_status_3_and_no_files(tmp_path, capsys):
    wall = [*QUICK, "--wall", "0", "0", "1", "-5"]
    assert main(["excite", "two_link", "-o", str(tmp_path / "out"), *wall]) == 3
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert "every pose violates a limit" in captured.err
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
    arguments = build_parser().parse_args(["excite", "panda", "-o", "x", *options])
    limits = inputs.limits_of(arguments, lieid.robots.panda())
    assert [type(limit).__name__ for limit in limits] == expected
    assert limits[0].fraction == 0.8


@pytest.mark.parametrize("of_fit", [False, True])
def test_velocity_limits_of_a_robot_that_states_none(tmp_path, of_fit):
    """MuJoCo models have no attribute for them."""
    two_link = lieid.robots.two_link()
    joints = tuple(
        replace(joint, limits=replace(joint.limits, velocity=np.nan)) for joint in two_link.joints
    )
    robot = replace(two_link, joints=joints)
    path = tmp_path / ("fit.json" if of_fit else "robot.yaml")
    made_fit(robot, "viscous").save(path) if of_fit else path.write_text(write_yaml(robot))
    words = ["excite", str(path), "-o", str(tmp_path)]
    arm, _ = inputs.arm_of(build_parser().parse_args([*words, "--velocity", "1.5", "0.5"]))
    limits = (arm.model if of_fit else arm).robot.limit("velocity")
    np.testing.assert_array_equal(limits, [1.5, 0.5])
    with pytest.raises(ExcitationError, match=r"state it \(--velocity V…\)"):
        motion_range(robot)
    with pytest.raises(RobotError, match="expected 1 or 2 positive numbers"):
        robot.with_velocity_limits([1.0, -1.0])


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


PANDA = lieid.robots.panda()


def test_a_start_pose_in_collision_is_refused_before_the_search():
    under_the_floor = [0.0, 1.7, 0.0, -0.2, 0.0, 1.8, 0.0]
    with pytest.raises(NoSolution, match=r"start pose violates a limit at rest: .* from the floor"):
        excite(lieid.Model(PANDA), start_pose=under_the_floor, limits=[floor(0.15)])


def test_interrupt_before_anything_is_feasible():
    """`test_interrupt_keeps_the_trajectory` interrupts a design that has a feasible motion."""

    def progress(stage, fraction):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        excite(lieid.Model(lieid.robots.two_link()), starts=1, progress=progress, limits=())


def test_infeasible_workspace_names_the_limit():
    ceiling = Wall((0.0, 0.0, 1.0), 0.45, "ceiling")
    with pytest.raises(NoSolution, match=r"no start pose .* from the ceiling is violated"):
        excite(lieid.Model(PANDA), limits=[ceiling], starts=1, max_iterations=20)


def test_torque_limit_below_gravity_is_infeasible():
    limits = [Torque(0.01, dry=0.0, viscous=0.0)]
    with pytest.raises(NoSolution, match="torque of joint"):
        excite(lieid.Model(lieid.robots.two_link()), limits=limits, start_pose=[0.0, 0.5])


def robot_with(**changes):
    joints = list(lieid.robots.two_link().joints)
    joints[1] = replace(joints[1], limits=replace(joints[1].limits, **changes))
    return replace(lieid.robots.two_link(), joints=tuple(joints))


@pytest.mark.parametrize(
    ("robot", "options", "message"),
    [
        ({"velocity": np.nan}, {}, "no velocity limit for joint 2"),
        ({"position_lower": 2.0, "position_upper": -2.0}, {}, "joint 2 .* contradict"),
        ({}, {"start_pose": [0.0, 9.0]}, "joint 2 .* at 9, outside its position limits"),
        ({}, {"start_pose": [0.0]}, "start pose: 1 numbers; expected 2"),
        ({}, {"acceleration": [1.0, 2.0, 3.0]}, "3 numbers; expected 1 or 2"),
        ({}, {"samples": 10}, "samples: 10; expected 44"),
        ({}, {"rate": 1e12}, "rate: 1e\\+12 Hz gives 2e\\+13 rows .* at most 10000000"),
        ({}, {"samples": 10**9}, "samples: 1000000000; .* at most 100000"),
        ({}, {"limits": [CartesianSpeed(0.0)]}, "Cartesian speed: 0"),
    ],
)
def test_bad_requests(robot, options, message):
    with pytest.raises(ExcitationError, match=message):
        excite(lieid.Model(robot_with(**robot)), **options)


def test_a_robot_without_acceleration_limits_or_end_stops():
    robot = robot_with(acceleration=np.nan, position_lower=np.nan, position_upper=np.nan)
    found = excite(lieid.Model(robot), duration=8.0, starts=1, max_iterations=30, limits=())
    assert np.abs(found.motion(200.0).ddq[:, 1]).max() <= 3.0


PANDA_MODEL = lieid.Model(lieid.robots.panda())


@pytest.fixture(scope="module")
def runs():
    return friction_sweep(PANDA_MODEL, 2, seconds=2.0, limits=[Torque()])


def test_speeds_of_the_paper_forward_and_backward(runs):
    forward = np.rad2deg([p.speed for p in runs.parts[::2]])
    back = np.rad2deg([p.speed for p in runs.parts[1::2]])
    assert len(forward) == 28
    assert np.isclose(forward[0], 0.1)
    assert np.isclose(forward[-1], 30.0)
    np.testing.assert_allclose(back, -forward)
    assert runs.left_out == ()


def test_speed_is_constant_and_positions_are_the_same_both_ways(runs):
    t, q, dq = runs.motion.t, runs.motion.q[:, 2], runs.motion.dq[:, 2]
    for forward, back in zip(runs.parts[::2], runs.parts[1::2], strict=True):
        ranges = []
        for part in (forward, back):
            inside = (t >= part.start + 1e-9) & (t <= part.end - 1e-9)
            assert inside.sum() > 3
            np.testing.assert_allclose(dq[inside], part.speed, rtol=1e-9)
            ranges.append(np.sort(np.interp([part.start, part.end], t, q)))
        np.testing.assert_allclose(ranges[0], ranges[1], atol=2e-3 * abs(forward.speed))


def test_speeds_beyond_the_limits_are_left_out():
    fast = friction_sweep(PANDA_MODEL, 0, speeds=[0.1, 3.0], seconds=1.0, limits=[])
    assert fast.left_out == (3.0,)
    assert len(fast.parts) == 2


@pytest.mark.parametrize("joint", [0, 1])
def test_default_limits_hold_where_the_middle_of_the_range_is_horizontal(joint):
    """A pose is found around which the joint can move above the floor; height by hand."""
    runs = friction_sweep(lieid.Model(lieid.robots.two_link()), joint, speeds=[0.1, 0.5])
    q = runs.motion.q
    elbow = 0.5 * np.sin(q[:, 0])
    tool = elbow + 0.4 * np.sin(q.sum(axis=1))
    assert min(elbow.min(), tool.min()) > 0.0
    assert len(runs.parts) == 4
    assert "floor" not in runs.unchecked


def test_bad_sweeps():
    with pytest.raises(ExcitationError, match="no joint 9; the arm has 1 to 7"):
        friction_sweep(PANDA_MODEL, 8)
    with pytest.raises(NoSolution, match="too short for every speed"):
        friction_sweep(PANDA_MODEL, 0, speeds=[5.0], limits=[])
    with pytest.raises(NoSolution, match="torque of joint"):
        friction_sweep(PANDA_MODEL, 1, speeds=[0.1], limits=[Torque(0.01, dry=0.0, viscous=0.0)])
