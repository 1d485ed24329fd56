"""The paper's results: friction of the plant, verdicts, the page and its requirements."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).parents[2] / "examples" / "paper"
NAMES = [path.stem for path in FOLDER.glob("*.py")]


@pytest.fixture(scope="module")
def scripts():
    """Import a script by name with its folder on the path; remove all afterwards."""
    before = {name: sys.modules.pop(name, None) for name in NAMES}
    sys.path.insert(0, str(FOLDER))
    yield importlib.import_module
    sys.path.remove(str(FOLDER))
    for name in NAMES:
        sys.modules.pop(name, None)
    sys.modules.update({name: module for name, module in before.items() if module is not None})


def eq_8(f, j, v, load):
    """Friction at v > 0 as the paper prints Eq. 8."""
    return (
        f.f_v1[j] * v
        + f.f_v2[j] * v**2
        + f.f_v3[j] * v**3
        + f.f_c[j] * (1 - np.exp(-((v / f.f_c1[j]) ** 2)))
        + f.f_s[j] * np.exp(-((v / f.f_s1[j]) ** 2))
        + f.f_tau[j] * load
        + f.f_tau1[j] * np.exp(-f.f_tau2[j] * load / v)
    )


def test_plant_has_eq_8_and_its_friction_is_positive(scripts):
    arm = scripts("arm")
    friction = arm.true_friction()
    for j in range(7):
        fastest = arm.ROBOT.limit("velocity")[j]
        v, load = (
            x.ravel() for x in np.meshgrid(np.geomspace(1e-3, fastest, 30), [0.1, 3.0, 40.0])
        )
        found = arm.friction_surface(j, v, load)
        assert found == pytest.approx(eq_8(friction, j, v, load), rel=1e-9)
        assert np.all(found > 0.0)


def test_library_with_the_true_parameters_is_eq_8(scripts):
    """Both definitions agree where ε of the library's is small."""
    arm, lab = scripts("arm"), scripts("lab")
    from lieid_casadi import Model, compile
    from lieid_casadi.friction_curves.friction_fit import steady_columns

    model = Model(arm.ROBOT, effects=lab.EQ_18)
    numbers = {f"{k}:{j + 1}": x for k, row in lab.TRUE.items() for j, x in enumerate(row)}
    coefficients = np.array([numbers[c.label] for c in model.columns])
    shapes = np.array([numbers[s.label] for s in model.shapes])
    speed, load = np.deg2rad([1.0, 5.0, 30.0]), np.array([2.0, 0.5, 1.0])
    for j in range(7):
        found = steady_columns(compile(model), j, speed, shapes, load=load) @ coefficients
        assert found == pytest.approx(arm.friction_surface(j, speed, load), rel=1e-2)


def test_printed_links_in_the_base_frame_are_a_panda(scripts):
    """In the frames of the links, Table IV differs by most of the gravity torque."""
    table_4 = scripts("table_4")
    gravity, error = table_4._gravity(table_4.printed_in_link_frames())
    assert np.all(error[1:4] < 0.05 * gravity[1:4])
    raw = scripts("arm").PRINTED["table_4"]
    order = ("m", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
    entries = np.array([raw[name] for name in order], dtype=float).T.ravel()
    _, as_printed = table_4._gravity(entries)
    assert np.all(as_printed[1:4] > 0.5 * gravity[1:4])


def test_errors_leave_out_standstill(scripts):
    """``moving`` leaves out samples of joints at rest and at reversals."""
    arm, lab, measure = scripts("arm"), scripts("lab"), scripts("measure")
    from lieid_casadi import plant
    from lieid_casadi.recording import process

    t = np.arange(0.0, 12.0, 0.002)
    motion = plant.FourierTrajectory(arm.ROBOT, base_frequency=0.1, periods=1, seed=3).at(t)
    run = plant.measure_along(arm.true_arm(), t, *motion)
    model = lab.lieid.Model(arm.ROBOT, effects=lab.EQ_16)
    truth = lab._with_numbers(
        lab.lieid.identify(model, run, processing=lab.LINEAR),
        arm.true_arm().parameters,
        {f"{k}:{j + 1}": x for k, row in lab.TRUE.items() for j, x in enumerate(row)},
        f"{lab.EQ_18},offset",
    )
    found = measure.errors(truth, process(run, lab.LINEAR))
    assert np.all(found.left_out > 0.15)  # it rests for two of twelve seconds
    assert np.all(found.moving < 0.2 * found.rms)


@pytest.mark.slow
@pytest.mark.real
def test_recordings_give_the_same_columns(scripts, tmp_path, recordings, monkeypatch):
    real_arm = scripts("real_arm")
    monkeypatch.setenv("LIEID_RECORDINGS", str(recordings))
    section = real_arm.section(real_arm.ur10e())
    section.draw(tmp_path)
    assert {p.stem for p in tmp_path.glob("*.png")} == {"recorded_5", "recorded_6"}
    load = [c for c in section.claims if c.text.startswith("Eq. 18")]
    assert len(load) == 2
    assert all("sum -" in claim.evidence for claim in load)  # its load friction is real


@pytest.mark.slow
def test_page_is_complete(scripts, tmp_path, monkeypatch):
    make = scripts("make")
    monkeypatch.delenv("LIEID_RECORDINGS", raising=False)
    sections = make.main(["--quick", "-o", str(tmp_path)])
    page = (tmp_path / "README.md").read_text()
    for title in ("Table III", "Table IV", "Tables V and VI", "Fig. 5", "Fig. 7", "Closing note"):
        assert title in page
    assert "left out" in page
    for picture in ("figure_4", "figure_5", "figure_6", "figure_7"):
        assert f"(figures/{picture}.png)" in page
        assert 3_000 < (tmp_path / "figures" / f"{picture}.png").stat().st_size < 150_000
    claims = [claim for section in sections for claim in section.claims]
    assert len([c for c in claims if c.source == "this project"]) == 3
    for claim in claims:
        assert claim.text in page
        if claim.source == "this project":
            assert claim.holds, claim.evidence
