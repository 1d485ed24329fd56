"""Motions that separate rival effects, checked independently, and ``lieid discriminate``."""

import json
from dataclasses import replace

import numpy as np
import pytest
from plant.recordings import recorded
from scipy.signal import lfilter

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.cli.main import main
from lieid_casadi.discrimination import discriminate
from lieid_casadi.discrimination.discriminate import shown_of
from lieid_casadi.discrimination.motion_search import independent_rate
from lieid_casadi.errors import NoSolution
from lieid_casadi.excitation import Torque
from lieid_casadi.excitation.checks import MARGIN
from lieid_casadi.excitation.limits import motion_range
from lieid_casadi.excitation.trajectory import MotionSamples
from lieid_casadi.identification.uncertainty.noise_model import Noise

RIVALS = ("stribeck:1", "viscous_polynomial:1")
EFFECTS = ["coulomb", "viscous", "offset"]


def measured(arm, t, q, dq, ddq, seed):
    sensors = plant.demo_sensors(arm.robot)
    return plant.measure_along(arm, t, q, dq, ddq, sensors=sensors, seed=seed)


@pytest.fixture(scope="module")
def robot():
    return lieid.robots.two_link()


@pytest.fixture(scope="module")
def train(robot):
    arm = plant.demo_arm(robot, hidden=None)
    t = np.arange(0.0, 20.0, 0.002)
    motion = plant.FourierTrajectory(robot, base_frequency=0.05, seed=1)
    return measured(arm, t, *motion.at(t), seed=1)


@pytest.fixture(scope="module")
def fit(robot, train):
    return lieid.identify(lieid.Model(robot, EFFECTS), train)


@pytest.fixture(scope="module")
def design(fit):
    return discriminate(
        fit, RIVALS, starts=40, evaluations=140, margin=1.0, limits=[Torque()],
        start_pose=[0.0, 0.0],
    )  # fmt: skip


def separation(fit, sizes, q, dq, ddq):
    """Return the RMS residual of the worse of both refits, relative to the noise.

    Friction columns by NumPy, refits by least squares, the Stribeck velocity on a fine grid.
    """
    base = lieid.compile(fit.model).base_regressor(q, dq, ddq)
    moving = (np.abs(dq) > 0.01) / fit.noise
    base = (base * moving[:, :, None]).reshape(-1, base.shape[2])

    def on_first(column):
        rows = np.zeros_like(dq)
        rows[:, 0] = column
        return (rows * moving).ravel()

    v = dq[:, 0]
    (f_s, v_s), (f_v2, f_v3) = (sizes[name] for name in RIVALS)
    polynomial = [on_first(np.sign(v) * v**2), on_first(v**3)]
    widths = np.geomspace(1e-3, 2.0, 40)
    stribeck = [[on_first(np.sign(v) * np.exp(-((v / w) ** 2)))] for w in widths]

    def left(torque, columns):
        matrix = np.column_stack([base, *columns])
        scale = np.maximum(np.linalg.norm(matrix, axis=0), 1e-12)
        solution = np.linalg.lstsq(matrix / scale, torque, rcond=1e-10)[0]
        return np.sqrt(np.mean((torque - matrix / scale @ solution) ** 2))

    one = left(on_first(f_s * np.sign(v) * np.exp(-((v / v_s) ** 2))), polynomial)
    torque = f_v2 * polynomial[0] + f_v3 * polynomial[1]
    return min(one, min(left(torque, columns) for columns in stribeck))


def test_designed_motion_separates_better_than_random_ones(robot, fit, design):
    designed = design.motion(rate=50.0)
    t = designed.t
    reached = separation(fit, design.sizes, designed.q, designed.dq, designed.ddq)
    others = [
        separation(
            fit,
            design.sizes,
            *plant.FourierTrajectory(robot, base_frequency=1.0 / t[-1], seed=seed).at(t),
        )
        for seed in range(15)
    ]
    assert reached > 2.0 * max(others)


def test_stated_seconds_are_enough(robot, fit, design):
    motion = design.motion(rate=200.0, periods=design.periods)
    assert motion.t[-1] == pytest.approx(design.seconds)
    (extra, width), (quadratic, cubic) = (design.sizes[name] for name in RIVALS)
    hidden = (
        plant.Stribeck(0, extra=extra, velocity=width),
        plant.ViscousPolynomial(0, quadratic=quadratic, cubic=cubic),
    )
    models = [lieid.Model(robot, [*EFFECTS, name]) for name in RIVALS]
    right = 0
    for run in range(12):
        true = run % 2
        arm = plant.demo_arm(robot, hidden=hidden[true])
        recording = measured(arm, motion.t, motion.q, motion.dq, motion.ddq, 100 + run)
        fits = [lieid.identify(m, recording, processing=fit.processing) for m in models]
        misfit = [float(np.sum((f.rms_train / fit.noise) ** 2)) for f in fits]
        right += int(np.argmin(misfit)) == true
    assert right >= 11


def test_correlated_samples_count_less(fit):
    """The mean of correlated samples varies more: its variance, by simulation, says how many."""
    noise = replace(Noise.white(1.0), filter=np.array([1.0, -0.8]))
    rate = independent_rate(replace(fit, residual_noise=(noise, Noise.white(1.0))))
    white = np.random.default_rng(1).standard_normal((4000, 1000))
    coloured = lfilter([1.0], noise.filter, white)
    variance = coloured.mean(axis=1).var() / coloured.var()
    assert rate[0] / rate[1] == pytest.approx(1.0 / (1000 * variance), rel=0.1)
    assert rate[1] == pytest.approx(2.0 * fit.processing.cutoff)


def test_one_motion_separates_several_groups(fit):
    groups = [RIVALS, ("position_spring:2", "torque_ripple:2")]
    design = discriminate(fit, groups, starts=20, evaluations=30)
    pairs = {frozenset((p.true, p.rival)) for p in design.pairs}
    assert pairs == {frozenset(group) for group in groups}
    worst = min(p.noncentrality / p.needed for p in design.pairs)
    assert design.exact_seconds == pytest.approx(design.trajectory.duration / worst)


def test_interrupted_search_keeps_the_best_so_far(fit, monkeypatch):
    from lieid_casadi.discrimination.rival_effects import RivalEffects

    calls, along = [], RivalEffects.columns_along

    def interrupted(self, motion):
        calls.append(motion)
        if len(calls) == 70:  # in the first refinement
            raise KeyboardInterrupt
        return along(self, motion)

    monkeypatch.setattr(RivalEffects, "columns_along", interrupted)
    design = discriminate(fit, RIVALS, starts=20)
    assert design.interrupted
    assert design.evaluations < 70
    assert design.seconds > 0.0


def test_one_effect_is_separated_from_its_absence(robot, fit):
    """Its noncentrality is the square of the coefficient in standard deviations of a fit."""
    label, stiffness = "position_spring:2", 0.05
    design = discriminate(fit, [label], sizes={label: [stiffness]}, starts=20, evaluations=30)
    (pair,) = design.pairs
    assert (pair.rival, pair.remaining < 1.0) == ("its absence", True)
    assert f"separate it from {pair.rival}" in design.summary()
    motion, velocity = design.motion(rate=1000.0), motion_range(robot, margin=MARGIN).velocity
    for periods in (1, 3):
        shown = shown_of(
            fit, label, design.motion(rate=1000.0, periods=periods), size=[stiffness],
            velocity=velocity,
        )  # fmt: skip
        assert shown == pytest.approx(periods * pair.noncentrality / pair.needed, rel=0.01)
    still = MotionSamples(motion.t, 0.0 * motion.q + 0.5, 0.0 * motion.dq, 0.0 * motion.ddq)
    assert shown_of(fit, label, still, size=[stiffness], velocity=velocity) == 0.0
    arm = plant.demo_arm(robot, hidden=plant.PositionSpring(1, stiffness=stiffness))
    recording = measured(arm, motion.t, motion.q, motion.dq, motion.ddq, 7)
    model = lieid.Model(robot, [*EFFECTS, label])
    again = lieid.identify(model, recording, processing=fit.processing)
    std = dict(zip((c.label for c in again.fitted), again.std, strict=True))["position_spring.K:2"]
    assert (stiffness / std) ** 2 == pytest.approx(pair.noncentrality, rel=0.4)


def test_effect_of_the_fit_keeps_its_size(robot, train):
    fit = lieid.identify(lieid.Model(robot, [*EFFECTS, "viscous_polynomial:1"]), train)
    design = discriminate(fit, RIVALS, starts=20, evaluations=30)
    columns = [c.label for c in fit.model.columns]
    first = next(k for k, label in enumerate(columns) if "f_v2" in label)
    fitted = fit.effect_coefficients[first : first + 2]
    assert design.sizes["viscous_polynomial:1"] == pytest.approx(fitted.tolist())
    assert not any("polynomial" in effect for effect in design.model.effects)


def test_a_rival_that_contains_the_other_is_separable_one_way(fit):
    sizes = {"stribeck/exponent:1": (0.2, 0.1, 0.5)}
    rivals = ["stribeck:1", "stribeck/exponent:1"]
    design = discriminate(fit, rivals, sizes=sizes, starts=20, evaluations=30)
    separable = {(p.true, p.rival): p.separable for p in design.pairs}
    assert separable == {tuple(rivals): False, tuple(rivals[::-1]): True}
    assert "stribeck:1 from stribeck/exponent:1" in design.summary()
    with pytest.raises(NoSolution, match="sizes"):  # with an exponent of 2 they are one
        discriminate(fit, rivals)


QUICK = ["--evaluations", "20"]


@pytest.fixture(scope="module")
def paths(tmp_path_factory):
    """Return the paths of a fit and of its recording."""
    folder = tmp_path_factory.mktemp("fit")
    robot = lieid.robots.two_link()
    recording = recorded(plant.demo_arm(robot, hidden=None), 2, step=0.005)
    recording.save(folder / "train.csv")
    fit = lieid.identify(lieid.Model(robot, ["coulomb", "viscous", "offset"]), recording)
    fit.save(folder / "fit.json")
    return str(folder / "fit.json"), str(folder / "train.csv")


def test_writes_the_trajectory_and_prints_its_duration(paths, tmp_path, capsys):
    fit, _ = paths
    out, result = tmp_path / "out", tmp_path / "result.json"
    words = ["discriminate", fit, "stribeck:1", "viscous_polynomial:1", "-o", str(out), *QUICK]
    assert main([*words, "--json", str(result)]) == 0
    shown = capsys.readouterr()
    content = json.loads(result.read_text())
    assert f"{content['seconds']:.4g} s of this motion" in shown.out
    # within the default limits: the tool stays above the base plane
    assert {"floor", "self-collision", "tool speed"}.isdisjoint(content["unchecked"])
    assert "Not checked: " in shown.out
    lines = (out / "trajectory.csv").read_text().splitlines()
    assert any(line.startswith("# not checked: ") for line in lines)
    table = np.genfromtxt([line for line in lines if line[0] != "#"], delimiter=",", names=True)
    height = 0.5 * np.sin(table["q1"]) + 0.4 * np.sin(table["q1"] + table["q2"])
    assert height.min() > 0.0
    assert shown.err == ""
    assert {p.name for p in out.iterdir()} == {
        "trajectory.csv", "discriminate.json", "discriminate.png", "lieid-manifest.json"
    }  # fmt: skip
    assert json.loads((out / "discriminate.json").read_text()) == content
    # a folder with content stays as it is, unless forced
    assert main(words) == 2
    assert "--force" in capsys.readouterr().err
    assert main([*words, "--force", "--size", "stribeck:1=0.3,0.08"]) == 0
    again = json.loads((out / "discriminate.json").read_text())
    assert again["sizes"]["stribeck:1"] == [0.3, 0.08]
