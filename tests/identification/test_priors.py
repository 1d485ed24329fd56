"""What is known of links before any data, on short recordings."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from plant.recordings import recorded
from scipy.signal import lfilter

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.identification.regression import priors
from lieid_casadi.robot.inertia import link_parameters

ROBOT = lieid.robots.panda()
EFFECTS = "coulomb,viscous,offset"
OPTIONS = lieid.Processing(cutoff=5.0)
RATE, NONE = 200.0, 1e6


def with_slow_noise(run, seed):
    """The recording with noise of 3 % of the torque, correlated over 0.3 s."""
    memory = np.exp(-1.0 / (0.3 * RATE))
    white = np.random.default_rng(seed).normal(size=run.tau.shape) * np.sqrt(1.0 - memory**2)
    noise = lfilter([1.0], [1.0, -memory], white, axis=0)
    return replace(run, tau=run.tau + 0.03 * run.tau.std(axis=0) * noise)


def runs(arm, seed, seconds=8.0):
    """A short recording for training, and another one."""
    both = (
        recorded(arm, k, seconds=s, step=1.0 / RATE) for k, s in ((seed, seconds), (seed + 50, 20))
    )
    return [with_slow_noise(run, seed + k) for k, run in enumerate(both)]


def unseen(robot, train, test):
    fit = lieid.identify(lieid.Model(robot, EFFECTS), train, processing=OPTIONS)
    return lieid.compare(fit, test).rms_moving


def against_none(robot, train, test, monkeypatch):
    """Return the error of each joint relative to that of links of which nothing is known."""
    own = unseen(robot, train, test)
    with monkeypatch.context() as patch:
        patch.setattr(priors, "_scale", lambda *_: NONE)
        return own / unseen(robot, train, test)


def arm_of(seed, robot=ROBOT):
    parameters = plant.perturbed_inertias(robot, seed=seed)
    return plant.Arm(robot, parameters, plant.JointFriction(*np.full((3, robot.n), 0.5)))


def test_short_recordings_of_slow_noise_predict_other_motion_better(monkeypatch):
    ratios = [
        against_none(ROBOT, *runs(arm_of(seed), seed), monkeypatch) for seed in range(0, 12, 2)
    ]
    assert np.exp(np.mean(np.log(ratios))) < 0.92
    assert np.max(ratios) < 1.2


@pytest.mark.parametrize("stated", ["no bodies", "of other masses", "a tenth", "negative"])
def test_wrong_descriptions_cost_little(stated, monkeypatch):
    factors = np.exp(np.random.default_rng(0).uniform(-1.6, 1.6, ROBOT.n))
    links = {
        "no bodies": [None] * ROBOT.n,
        "of other masses": [f * j.link for f, j in zip(factors, ROBOT.joints, strict=True)],
        "a tenth": [0.1 * j.link for j in ROBOT.joints],
        "negative": [-j.link for j in ROBOT.joints],
    }[stated]
    joints = [replace(j, link=x) for j, x in zip(ROBOT.joints, links, strict=True)]
    robot = replace(ROBOT, joints=tuple(joints))
    ratios = [against_none(robot, *runs(arm_of(seed), seed), monkeypatch) for seed in (0, 2, 4)]
    assert np.exp(np.mean(np.log(ratios))) < 1.0
    assert np.max(ratios) < 1.2


def test_a_heavy_tool_and_rotors_that_are_not_stated(monkeypatch):
    """Their parameters are not drawn to those of small links."""
    arm = arm_of(0)
    tool = link_parameters(4.0, np.array([0.05, 0.0, 0.15]), np.diag([0.05, 0.05, 0.02]))
    rotors = tuple(plant.Armature(joint=j, inertia=0.3) for j in range(ROBOT.n))
    arm = replace(arm, parameters=plant.with_payload(ROBOT, arm.parameters, tool), effects=rotors)
    ratio = against_none(ROBOT, *runs(arm, 0), monkeypatch)
    assert np.exp(np.mean(np.log(ratio))) < 1.0
    assert ratio.max() < 1.2


def test_standard_deviations_contain_how_far_the_stated_bodies_are_off():
    """Of links that a short recording hardly shows they are those of the description's errors."""
    model = lieid.Model(ROBOT, EFFECTS)
    links = np.flatnonzero(model.base.kept < 10 * ROBOT.n)
    sums, inside = model.base.combination[links, : 10 * ROBOT.n], []
    for seed in range(0, 24, 2):
        arm = arm_of(seed)
        fit = lieid.identify(model, runs(arm, seed)[0], processing=OPTIONS)
        errors = np.abs(fit.values[links] - sums @ arm.parameters)
        inside.append(errors < 1.96 * fit.std[links])
    assert np.mean(inside) > 0.92  # spheres without the stated bodies: 0.82
    assert np.min(np.mean(inside, axis=0)) > 0.6


def test_the_scale_of_links_follows_how_far_the_rows_find_them_off():
    random, root = np.random.default_rng(0), np.diag(np.full(40, 2.0))
    rows = np.column_stack([np.diag(np.geomspace(0.1, 100.0, 40)), np.zeros(40)])
    mean = random.normal(size=40)
    found = {}
    for scale in (0.2, 0.5, 1.0):
        rows[:, -1] = rows[:, :-1] @ (mean + scale * 2.0 * random.normal(size=40))
        rows[:, -1] += random.normal(size=40)
        found[scale] = priors._scale(rows, np.arange(40), root, mean)
    for scale, largest in found.items():
        assert scale < largest < 2.0 * scale
    nothing = priors._scale(np.zeros((40, 41)), np.arange(40), root, mean)
    assert nothing == priors.SCALES[1]


def test_the_unit_of_the_masses_does_not_matter():
    train, _ = runs(arm_of(0), 0)
    light = replace(ROBOT, joints=tuple(replace(j, link=1e-3 * j.link) for j in ROBOT.joints))
    fits = [
        lieid.identify(lieid.Model(robot, EFFECTS), train, processing=OPTIONS)
        for robot in (ROBOT, light)
    ]
    np.testing.assert_allclose(fits[1].values, fits[0].values, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(fits[1].std, fits[0].std, rtol=1e-6)


def test_ordinary_least_squares_know_nothing_before_any_data(monkeypatch):
    train, _ = runs(arm_of(0), 0)
    stds = {"ols": [], "wls": []}
    for scale, (method, found) in product(priors.SCALES, stds.items()):
        monkeypatch.setattr(priors, "_scale", lambda *_, scale=scale: scale)
        fit = lieid.identify(lieid.Model(ROBOT, EFFECTS), train, method=method, processing=OPTIONS)
        found.append(fit.std)
    np.testing.assert_array_equal(*stds["ols"])
    assert np.any(stds["wls"][1] > 1.5 * stds["wls"][0])


def test_values_follow_the_unit_of_the_torque():
    """Of a torque in mN·m, parameters are a thousand times as large."""
    train, _ = runs(arm_of(0), 0)
    fits = [
        lieid.identify(lieid.Model(ROBOT, EFFECTS), replace(train, tau=k * train.tau),
                       processing=OPTIONS)
        for k in (1.0, 1000.0)
    ]  # fmt: skip
    np.testing.assert_allclose(fits[1].values, 1000.0 * fits[0].values, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(fits[1].std, 1000.0 * fits[0].std, rtol=1e-3)
