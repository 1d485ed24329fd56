"""The generator of the benchmark: sizes, noise and joints agree with the stated truth."""

import ast
import json
import zlib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hidden_effects import effect_library, schedule
from hidden_effects.arms import ARMS, load_arm
from hidden_effects.case_setup import Case, CaseSetup, draw_setup
from hidden_effects.foreign import FOREIGN, FORMS
from hidden_effects.generator import draw, write
from hidden_effects.motions import draw_motion
from hidden_effects.sizes import BaseSpan, EffectSizes, columns, noiseless_record, whitened
from hidden_effects.worlds import WORLDS
from plant.arms import MujocoArm, with_links
from scipy.signal import lfilter

from lieid_casadi import Recording, Robot
from lieid_casadi.plant import Arm, JointFriction, Sensors, measure, move_along, perturbed_inertias
from lieid_casadi.plant.sensors import coloured_noise
from lieid_casadi.plant.trajectories import Envelope

HERE = Path(__file__).parent
GENERATOR_MODULES = (
    "arms", "case_setup", "effect_library", "foreign", "generator", "motions", "sizes", "worlds",
)  # fmt: skip


@pytest.mark.parametrize("name", GENERATOR_MODULES)
def test_the_generator_is_independent_of_the_effects(name):
    tree = ast.parse((HERE / f"{name}.py").read_text("utf-8"))
    imported = [n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
    imported += [a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names]
    own = {".".join(m.split(".")[:2]) for m in imported if m.startswith("lieid_casadi")}
    assert own <= {f"lieid_casadi{part}" for part in ("", ".plant", ".robot", ".arrays")}
    assert not any(m.startswith("casadi") for m in imported)


def an_arm(name, seed=1):
    robot = load_arm(name)
    rng = np.random.default_rng(seed)
    friction = JointFriction(*rng.uniform(0.2, 1.0, (3, robot.n)))
    return Arm(robot, perturbed_inertias(robot, seed=seed), friction)


def a_motion(robot, kind="mixture", seed=1, rate=200.0):
    plan = draw_motion(robot, kind, 12.0, np.random.default_rng(seed))
    t = np.arange(round(plan.duration * rate) + 1) / rate
    return t, *plan.at(t)


@pytest.mark.parametrize("name", ARMS)
def test_rigid_torques_are_those_of_mujoco(name):
    arm = an_arm(name)
    t, q, dq, ddq = a_motion(arm.robot)
    rows = slice(None, None, 50)
    expected = MujocoArm(with_links(arm.robot, arm.parameters)).torques(
        q[rows], dq[rows], ddq[rows]
    )
    rigid = move_along(arm, t, q, dq, ddq).rigid[rows]
    assert np.abs(rigid - expected).max() < 1e-6 * np.abs(expected).max()


@pytest.mark.parametrize("name", ARMS)
def test_the_torque_of_an_arm_without_effects_is_in_the_span(name):
    """The true inertias differ from the nominal ones, but not the span of the columns."""
    arm = an_arm(name)
    record = noiseless_record(arm, move_along(arm, *a_motion(arm.robot)), 200.0)
    space = BaseSpan(arm.robot, record, np.ones(arm.n))
    torque = space.stacked(record.tau)
    assert space.by_joint(space.outside(torque)).max() < 1e-8 * space.by_joint(torque).min()


@pytest.mark.parametrize("kind", ["fourier", "poses", "mixture"])
@pytest.mark.parametrize("name", ARMS)
def test_motions_are_consistent_and_within_limits(name, kind):
    robot = load_arm(name)
    t, q, dq, ddq = a_motion(robot, kind, seed=3, rate=2000.0)
    envelope = Envelope.of(robot, margin=1.0)
    assert np.all(q >= envelope.lower - 1e-9)
    assert np.all(q <= envelope.upper + 1e-9)
    assert np.all(np.abs(dq).max(axis=0) <= envelope.velocity + 1e-9)
    # the trapezoidal rule is off by h²/12 · d³q/dt³ at most, jumps of ddq included
    h = t[1] - t[0]
    assert np.abs(np.diff(q, axis=0) - 0.5 * h * (dq[1:] + dq[:-1])).max() < 1e-5
    assert np.abs(np.diff(dq, axis=0) - 0.5 * h * (ddq[1:] + ddq[:-1])).max() < 1e-2
    assert 11.0 < t[-1] < 30.0


SOME = (
    "missing-single-stribeck-5x-0",
    "missing-single-encoder_offset-1x-0",
    "missing-single-presliding-1x-0",
    pytest.param("missing-single-joint_elasticity-2x-0", marks=pytest.mark.slow),
    pytest.param("missing-single-torque_gain-2x-1", marks=pytest.mark.slow),
    "missing-single-base_tilt-0.5x-2",
    "changed-single-payload-2x-0",
    pytest.param("changed-single-coulomb-1x-0", marks=pytest.mark.slow),
    pytest.param("missing-foreign-friction_peak-5x-0", marks=pytest.mark.slow),
    "missing-pair-1",
)


@cache
def drawn_once(name):
    return draw(Case.parse(name))


@pytest.mark.parametrize("name", [*SOME, "missing-six-2"])
def test_sizes_agree_with_the_truth(name):
    """Computed from all rows of the recording, with least squares solved directly."""
    case = Case.parse(name)
    drawn = drawn_once(name)
    run = 1 if case.changed else 0
    noise, arm, motion = drawn.noise, drawn.arms[run], drawn.motions[run]
    assert not (case.changed and drawn.arms[0].effects)  # the arm before the change
    silent = Sensors(rate=drawn.sensors.rate)
    record = noiseless_record(arm, motion, drawn.sensors.rate)
    recorded = measure(arm, motion, silent)
    assert np.array_equal(recorded.tau, record.tau)
    if case.kind in ("pair", "six"):
        for effect in drawn.truth["effects"]:
            assert effect["size"] == pytest.approx(effect["target"], rel=0.15)
        return
    effect = drawn.truth["effects"][0]
    assert effect["size"] == pytest.approx(effect["target"], rel=0.15)
    if case.changed:
        plain = replace_effects(arm, drawn.arms[0])
        before = move_along(plain, record.t, record.q, record.dq, record.ddq).tau
        rest = np.where(record.moving, record.tau - before, 0.0)
    else:
        a = columns(arm.robot, record)
        n = arm.n
        use = record.moving.ravel()
        weight = np.tile(1.0 / noise, len(record.t))[use]
        rows, torque = a.reshape(-1, a.shape[2])[use], record.tau.ravel()[use]
        x = np.linalg.lstsq(rows * weight[:, None], torque * weight, rcond=1e-11)[0]
        rest = np.zeros(len(record.t) * n)
        rest[use] = torque - rows @ x
        rest = rest.reshape(-1, n)
    counts = record.moving.sum(axis=0)
    by_joint = np.sqrt((rest**2).sum(axis=0) / counts) / noise
    assert by_joint.max() == pytest.approx(effect["target"], rel=0.2)
    assert np.argmax(by_joint) + 1 == effect["joint"]


def replace_effects(arm, plain):
    """The arm with the effects and friction of another."""
    return replace(arm, effects=plain.effects, friction=plain.friction)


@pytest.mark.parametrize("name", [n for n in SOME if n != "missing-pair-1"])
def test_an_effect_acts_on_the_joint_of_the_truth(name):
    """Noiseless torque with the effect minus torque without it, on the same path of the links."""
    case = Case.parse(name)
    drawn = drawn_once(name)
    arm = drawn.arms[1 if case.changed else 0]
    effect = drawn.truth["effects"][0]
    motion = drawn.motions[1 if case.changed else 0]
    thin = slice(None, None, 10)
    path = motion.t[thin], motion.q[thin], motion.dq[thin], motion.ddq[thin]
    plain = replace_effects(arm, drawn.arms[0]) if case.changed else replace_effects(arm, bare(arm))
    ideal = Sensors(rate=None)
    with_it, without = (measure(a, move_along(a, *path), ideal) for a in (arm, plain))
    # at rest dry friction is undetermined
    change = np.where(np.abs(path[2]) > 1e-3, with_it.tau - without.tau, 0.0)
    touched = np.flatnonzero(np.abs(change).max(axis=0) > 1e-6 * drawn.noise)
    shown = np.flatnonzero(np.abs(with_it.q - without.q).max(axis=0) > 1e-12)
    place = {j - 1 for j in effect["joints"][:1]}
    if effect["effect"] in ("encoder_offset", "joint_elasticity"):
        assert set(shown) == place
    elif place:
        assert set(touched) == place
        assert not shown.size
    else:
        assert touched.size > 1


def bare(arm):
    return replace(arm, effects=())


@pytest.mark.parametrize("name", ["missing-none-1", "missing-none-2", "missing-none-5"])
def test_noise_agrees_with_the_truth(name):
    drawn = draw(Case.parse(name))
    sensors = drawn.sensors
    recorded = measure(drawn.arms[0], drawn.motions[0], sensors, seed=3)
    ideal = measure(drawn.arms[0], drawn.motions[0], Sensors(rate=sensors.rate))
    noise = recorded.tau - ideal.tau
    rms = np.sqrt(np.mean(noise**2, axis=0)) / drawn.noise
    # the coloured part is correlated: fewer independent samples than rows
    assert rms == pytest.approx(np.ones(len(rms)), rel=0.12)
    assert np.sqrt(np.mean(rms**2)) == pytest.approx(1.0, rel=0.05)
    lag = max(1, round(0.5 * sensors.correlation_time * sensors.rate))
    coloured = np.array(sensors.coloured_noise) ** 2
    keep = np.exp(-lag / sensors.rate / sensors.correlation_time)
    correlation = np.mean(noise[lag:] * noise[:-lag], axis=0)
    assert correlation.sum() == pytest.approx(
        keep * coloured.sum(), abs=0.12 * (drawn.noise**2).sum()
    )
    white = lfilter([1.0, -1.0], [1.0], noise, axis=0)[1:]
    assert np.all(np.std(white, axis=0) > 0.3 * drawn.noise)


def test_files_contain_robot_and_recordings_but_no_truth(tmp_path):
    folder, truth = tmp_path / "files", tmp_path / "truth.json"
    returned = write(Case.parse("missing-single-temperature_friction-2x-0"), folder, truth)
    assert json.loads(truth.read_text()) == returned
    stems = {f.stem for f in folder.iterdir()}
    assert stems - {"train2", "train3"} == {
        "robot", "train1", "test" if returned["tested"] else "unseen"
    }  # fmt: skip
    robot = Robot.load(next(folder.glob("robot.*")))
    train = Recording.load(folder / "train1.csv")
    assert train.n == robot.n
    assert train.temperature is not None
    assert 1400 < len(train.t) < 14000
    text = "".join(f.read_text()[:300] for f in folder.iterdir())
    assert "temperature_friction" not in text


def test_a_name_defines_a_case(tmp_path):
    name = "changed-single-viscous-1x-0"
    assert Case.parse(name).name == name
    for k in range(2):
        write(Case.parse(name), tmp_path / str(k))
    for file in ("before.csv", "after.csv"):
        assert (tmp_path / "0" / file).read_bytes() == (tmp_path / "1" / file).read_bytes()


def test_the_schedule_contains_all_kinds_of_cases():
    every = list(schedule.cases())
    names = [case.name for case in every]
    assert len(set(names)) == len(names)
    assert all(Case.parse(name).name == name for name in names)
    for changed in (False, True):
        own = [c for c in every if c.changed == changed]
        for kind, least in (("pair", 30), ("triple", 10), ("none", 80), ("foreign", 30)):
            assert sum(c.kind == kind for c in own) >= least
        for effect in effect_library.CHANGED if changed else effect_library.MISSING:
            assert sum(c.effect == effect for c in own) >= 4
    assert sum(c.kind == "six" for c in every) >= 80
    for kind, names in (("foreign", FOREIGN), ("form", FORMS), ("world", WORLDS)):
        assert {c.effect for c in every if c.kind == kind} == set(names)
        for half in schedule.HALVES:
            chosen = schedule.chosen(half=half, kinds=[kind], series=[2])
            assert {c.effect for c in chosen} == set(names)
    assert not set(schedule.chosen(half="tune")) & set(schedule.chosen(half="sealed"))
    assert {c.half for c in schedule.quick()} == {"tune"}
    assert {c.kind for c in schedule.quick()} == set(schedule.KINDS) - {"triple", "six"}
    first, following = schedule.chosen(count=7), schedule.chosen(skip=7, count=5)
    assert [*first, *following] == schedule.chosen(count=12)


def test_the_second_series_draws_correlated_noise_and_short_recordings():
    cases = [Case("none", 100 + k) for k in range(40)]
    setups = [draw_setup(c, np.random.default_rng(k), 1.0) for k, c in enumerate(cases)]
    times = np.array([s.sensors.correlation_time for s in setups])
    assert times.min() < 0.02
    assert times.max() > 0.8
    assert sum(max(p.duration for p in s.plans[:1]) < 25.0 for s in setups) > 10
    for s in setups:
        variance = np.square([s.sensors.torque_noise, s.sensors.coloured_noise]).sum(axis=0)
        assert variance + np.square(s.sensors.torque_step) / 12.0 == pytest.approx(s.noise**2)


@pytest.mark.parametrize("white", [0.05, 1.0])
def test_the_filter_whitens_correlated_noise(white):
    """Innovations of simulated noise are uncorrelated and of unit variance."""
    t, random = np.arange(4000) / 100.0, np.random.default_rng(1)
    noise = np.sqrt(1.0 - white) * coloured_noise(t, 2, 0.3, random)
    noise += np.sqrt(white) * random.standard_normal(noise.shape)
    seen = random.random(noise.shape) < 0.8
    shown = whitened(noise[:, :, None], seen, t, np.full(2, white), 0.3)[:, :, 0]
    assert np.all(shown[~seen] == 0.0)
    for j in range(2):
        kept = shown[seen[:, j], j]
        assert np.std(kept) == pytest.approx(1.0, rel=0.06)
        assert abs(np.mean(kept[1:] * kept[:-1])) < 0.07
        assert abs(np.mean(kept[30:] * kept[:-30])) < 0.07


def drawn_setups(count=24):
    cases = [Case("none", k) for k in range(count)]
    return [draw_setup(c, np.random.default_rng(k), 1.0) for k, c in enumerate(cases)]


def test_recordings_last_15_to_60_s_with_and_without_test_one_and_three_for_training():
    setups = drawn_setups()
    assert {len(s.plans) - 1 for s in setups} == {1, 3}
    assert {s.tested for s in setups} == {True, False}
    durations = [plan.duration for s in setups for plan in s.plans]
    assert min(durations) > 14.9
    assert max(durations) < 75.0  # moves between poses end after the stated duration


#: draws whose arm follows the motion exactly: one that sticks and slips is simulated for 20 s
KNOWN_MOTION = {"kinematics": 6, "load_friction_root": 104}


@pytest.mark.parametrize(
    "name",
    [
        name
        if name in ("kinematics", "shared_noise")
        else pytest.param(name, marks=pytest.mark.slow)
        for name in WORLDS
        if name != "bam_m1"  # Coulomb and viscous friction alone: it violates nothing
    ],
)
def test_a_world_changes_what_is_recorded_or_described(name, tmp_path):
    """With the same seeds, the violated assumption is the only difference."""
    case = Case("world", KNOWN_MOTION.get(name, 0), effect=name)
    write(case, tmp_path)
    drawn = draw(case)
    plain = [replace(arm, effects=()) for arm in drawn.arms]
    seed = zlib.crc32(case.name.encode())
    shown = Recording.load(tmp_path / "train1.csv")
    motion = drawn.motions[0]
    tau = move_along(plain[0], motion.t, motion.q, motion.dq, motion.ddq).tau
    assumed = measure(plain[0], replace(motion, tau=tau), drawn.sensors, seed=seed)
    moving = ~motion.resting[np.searchsorted(motion.t, assumed.t)]
    change = np.abs(shown.tau - assumed.tau)[moving].max() / drawn.noise.max()
    moved = np.abs(shown.q - assumed.q).max()
    robot, true = Robot.load(next(tmp_path.glob("robot.*"))), load_arm(drawn.arm_name)
    described = np.abs(
        [a.home - b.home for a, b in zip(robot.joints, true.joints, strict=True)]
    ).max()
    assert max(change, moved / 1e-3, described / 1e-3) > 0.5
    assert (described > 1e-6) == (name == "kinematics")


@pytest.mark.parametrize(
    "name",
    [
        name if name == "load_friction_root" else pytest.param(name, marks=pytest.mark.slow)
        for name in FORMS
    ],
)
def test_a_form_acts_on_its_joint(name):
    drawn = draw(Case("form", KNOWN_MOTION.get(name, 100), effect=name, size=5.0))
    (effect,) = drawn.truth["effects"]
    assert effect["accepted"]
    assert effect["joints"] == [effect["joint"]]
    assert effect["size"] == pytest.approx(5.0, rel=0.15)


def test_absorbed_effects_have_no_size():
    """A payload is part of the last link; an offset of the first, vertical joint has no effect."""
    drawn = draw(Case.parse("missing-none-1"))
    from hidden_effects.effect_library import ScalableEffect, with_effect

    from lieid_casadi.plant import EncoderOffset, Payload, Thermal

    arm = drawn.arms[0]
    setup = CaseSetup("", arm, (None, None), ("", ""), (Thermal(), Thermal()), drawn.sensors,
                  drawn.noise, False, False)  # fmt: skip
    m = drawn.motions[0]
    sizing = EffectSizes(setup, m.t, (m.q, m.dq, m.ddq))
    payload = ScalableEffect(
        "payload", (), with_effect(lambda s: Payload(mass=s, com=(0.0, 0.0, 0.05))), 9.0
    )
    assert sizing.size(payload, 1.0, [])[1] < 1e-6
    turned = ScalableEffect(
        "encoder_offset", (0,), with_effect(lambda s: EncoderOffset(0, offset=s)), 1.0
    )
    assert sizing.size(turned, 0.1, [])[0] < 1e-6
