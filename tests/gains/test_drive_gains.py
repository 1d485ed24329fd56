"""Drive gains identified from simulated currents with known torque constants, and the command."""

import json
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.cli.main import main
from lieid_casadi.errors import EffectError, IdentificationError, ModelError

PANDA = lieid.robots.panda()
GAINS = (14.9, 13.3, 11.1, 10.6, 11.0, 11.5, 9.0)
MASS, COM = 3.0, (0.03, -0.02, 0.08)
PAYLOAD = plant.Payload(mass=MASS, com=COM, radius=0.06)
ARM = plant.demo_arm(PANDA, seed=1, hidden=None)
LOADED = ARM.with_effects(PAYLOAD)
CUTOFF = lieid.Processing(cutoff=8.0)


@lru_cache(maxsize=16)
def amperes(arm, *, motion=4, seed=0, seconds=30.0, sensors=None, gains=GAINS, name="", still=()):
    """Return currents of an arm on a random motion; joints in ``still`` do not move."""
    path = plant.FourierTrajectory(arm.robot, base_frequency=1 / seconds, harmonics=8, seed=motion)
    t = np.arange(0.0, seconds, 0.001)
    q, dq, ddq = path.at(t)
    for j in still:
        q[:, j], dq[:, j], ddq[:, j] = q[0, j], 0.0, 0.0
    quality = sensors or plant.demo_sensors(arm.robot)
    run = plant.measure_along(arm, t, q, dq, ddq, sensors=quality, seed=seed)
    current = run.tau / np.array(gains)
    return lieid.Recording.from_arrays(run.t, run.q, run.dq, current=current, name=name)


@pytest.fixture(scope="module")
def unloaded():
    return amperes(ARM, name="empty.csv")


@pytest.fixture(scope="module")
def found(unloaded):
    return lieid.drive_gains(
        PANDA, unloaded, amperes(LOADED, motion=5, seed=1), mass=MASS, processing=CUTOFF
    )


def test_gains_within_three_standard_deviations(found):
    assert np.all(np.abs(found.gains - GAINS) < 3.0 * found.std)
    assert found.std[0] < 0.01 * GAINS[0]
    assert np.all(found.std[1:] < 0.004 * np.array(GAINS[1:]))
    assert found.not_identified == ()
    assert found.warnings == ()
    constants = found.option.removeprefix("--torque-constants ").split(",")
    assert np.allclose([float(k) for k in constants], found.gains, rtol=1e-4)
    assert found._repr_html_().count("<tr>") == 8
    figure = found.plot()
    assert found.plot(figure.axes[0]) is figure


def test_exact_without_noise_and_friction():
    """Gains of any sign and size are found, and inertias are not needed."""
    still = plant.Arm(PANDA, ARM.parameters, plant.JointFriction.none(7))
    gains = np.array([3.0, -250.0, 0.1, 1.0, 40.0, 7.0, -2.0])
    ideal = plant.Sensors(rate=200.0)
    bare = replace(PANDA, joints=tuple(replace(j, link=None) for j in PANDA.joints))
    one = amperes(still, sensors=ideal, gains=tuple(gains))
    other = amperes(still.with_effects(PAYLOAD), motion=5, sensors=ideal, gains=tuple(gains))
    found = lieid.drive_gains(bare, one, other, mass=MASS, effects="", processing=CUTOFF)
    assert np.allclose(found.gains, gains, rtol=1e-3)


@pytest.mark.slow
def test_intervals_cover_the_truth():
    """40 pairs of runs with different motions: 90-98.5 % of 280 intervals."""
    held = []
    for seed in range(40):
        one = amperes(ARM, motion=10 * seed + 4, seed=seed)
        other = amperes(LOADED, motion=10 * seed + 5, seed=1000 + seed)
        found = lieid.drive_gains(PANDA, one, other, mass=MASS, processing=CUTOFF)
        held.append(np.abs(found.gains - GAINS) / found.std)
    assert 0.90 <= np.mean(np.array(held) < 1.96) <= 0.985
    assert np.max(held) < 4.0


def test_a_joint_that_never_moves_is_reported_and_the_others_are_found():
    one, other = amperes(ARM, still=(6,)), amperes(LOADED, motion=5, seed=1, still=(6,))
    found = lieid.drive_gains(PANDA, one, other, mass=MASS, processing=CUTOFF)
    assert [(p.joint, p.reason) for p in found.not_identified] == [(6, "the joint never moves")]
    assert np.isnan(found.gains[6])
    assert found.to_dict()["gains"][6] is None
    assert np.all(np.abs(found.gains - GAINS)[:6] < 3.5 * found.std[:6])


def test_loaded_runs_without_the_payload_are_refused(unloaded):
    again = amperes(ARM, motion=5, seed=1, seconds=15.0)
    with pytest.raises(IdentificationError, match=r"do not show a payload of 3 kg|exchanged"):
        lieid.drive_gains(PANDA, unloaded, again, mass=MASS, processing=CUTOFF)


def test_another_arm_is_refused(unloaded):
    mirrored = lieid.robots.panda_luo2024()
    other = plant.demo_arm(mirrored, seed=9, hidden=None).with_effects(PAYLOAD)
    with pytest.raises(IdentificationError, match=r"expected runs of that arm|do not show"):
        lieid.drive_gains(PANDA, unloaded, amperes(other, motion=8), mass=MASS, processing=CUTOFF)


@pytest.mark.parametrize("mass", [0.0, np.nan, 1e300])
def test_a_mass_that_is_not_positive_is_refused(unloaded, mass):
    with pytest.raises(IdentificationError, match="mass of the payload"):
        lieid.drive_gains(PANDA, unloaded, unloaded, mass=mass)


def test_unsuitable_input_is_refused(unloaded):
    def gains(one, other, **options):
        return lieid.drive_gains(PANDA, one, other, mass=MASS, **options)

    with pytest.raises(IdentificationError, match=r"empty\.csv: given as unloaded and as loaded"):
        gains(unloaded, unloaded)
    two_link = lieid.robots.two_link()
    small = amperes(plant.demo_arm(two_link, hidden=None), gains=GAINS[:2])
    with pytest.raises(ModelError, match=r"2 joints; robot .* has 7"):
        gains(unloaded, small)
    torque = replace(unloaded, current=None, tau=unloaded.current, source_hash="x")
    with pytest.raises(ModelError, match="no motor currents"):
        gains(unloaded, torque)
    dead = unloaded.current.copy()
    dead[:, 2] = 0.0
    with pytest.raises(IdentificationError, match="current i3 is the same in every row"):
        gains(unloaded, replace(unloaded, current=dead, source_hash="y"))
    for effect in ("stribeck:2", "load_friction:2"):
        with pytest.raises(EffectError, match=f"^{effect[:-2]}.*shape parameters or of the load"):
            gains(unloaded, replace(unloaded, source_hash="z"), effects=effect)
    with pytest.raises(IdentificationError, match="no loaded recording"):
        gains(unloaded, [])


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("gains")
    amperes(ARM, seconds=15.0).save(folder / "empty.csv")
    amperes(LOADED, motion=5, seed=1, seconds=15.0).save(folder / "loaded.csv")
    return folder


def test_table_json_and_the_option(files, tmp_path, capsys):
    out = tmp_path / "g.json"
    words = ["--unloaded", files / "empty.csv", "--loaded", files / "loaded.csv", "--mass", MASS]
    assert main(["gains", "panda", *map(str, [*words, "--json", out])]) == 0
    shown = capsys.readouterr().out
    content = json.loads(out.read_text())
    assert len(content["gains"]) == len(content["std"]) == 7
    z = (np.array(content["gains"]) - GAINS) / np.array(content["std"])
    assert np.all(np.abs(z) < 3.5)
    assert content["not_identified"] == []
    assert content["warnings"] == []
    assert content["option"] in shown.splitlines()
