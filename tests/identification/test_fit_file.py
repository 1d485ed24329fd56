"""Fit files: valid content loads identically, any other content is one `FitFileError`."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plant.recordings import recorded
from robot.random_arms import random_arm

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.diagnosis.steps import fitted_values
from lieid_casadi.errors import EffectError, FitFileError
from lieid_casadi.exporters.export import export_samples
from lieid_casadi.workbench.evaluation import effect_rows

ROBOT = lieid.robots.two_link()


@pytest.fixture(scope="module")
def run():
    sensors = plant.Sensors(rate=100.0, torque_noise=0.05)
    arm = plant.demo_arm(ROBOT, hidden=None)
    return recorded(arm, 1, seconds=8.0, step=0.01, sensors=sensors, seed=0)


@pytest.fixture(scope="module")
def fit(run):
    model = lieid.Model(ROBOT, "coulomb,viscous,offset,stribeck:1")
    return lieid.identify(model, run, method="feasible", processing=lieid.Processing(cutoff=8.0))


@pytest.fixture(scope="module")
def text(fit, tmp_path_factory):
    path = tmp_path_factory.mktemp("fit") / "folder" / "fit.json"
    fit.save(path)
    assert [path.name] == [p.name for p in path.parent.iterdir()]
    return path.read_text("utf-8")


def loaded(content, tmp_path):
    path = tmp_path / "fit.json"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return lieid.Fit.load(path)


def refusal(content, tmp_path):
    with pytest.raises(FitFileError) as refused:
        loaded(content, tmp_path)
    message = str(refused.value)
    assert "\n" not in message
    assert message.startswith(str(tmp_path / "fit.json"))
    assert len(message) < 500
    return message


def test_a_saved_fit_loads_identically(fit, run, text, tmp_path):
    again = loaded(text, tmp_path)
    for name in ("values", "shapes", "covariance", "parameters", "noise", "rms_train", "rms_cv"):
        np.testing.assert_array_equal(getattr(again, name), getattr(fit, name))
    for kept, own in zip(again.residual_noise, fit.residual_noise, strict=True):
        np.testing.assert_array_equal(kept.filter, own.filter)
        for name in ("sigma", "spread", "motion_ratio"):
            assert getattr(kept, name) == getattr(own, name)
    assert again.to_dict() == fit.to_dict()
    assert again.certificate.to_dict() == fit.certificate.to_dict()
    np.testing.assert_array_equal(again.predict(run), fit.predict(run))
    assert json.loads(text)["robot"]["text"] == ROBOT.source.text


def test_schema_1_is_migrated(fit, text, tmp_path):
    old = json.loads(text) | {"schema": 1}
    del old["residual_noise"]
    migrated = loaded(json.dumps(old), tmp_path)
    np.testing.assert_array_equal(migrated.values, fit.values)
    assert [n.spread for n in migrated.residual_noise] == list(fit.noise)
    assert all(n.order == 0 and n.motion_ratio == 1.0 for n in migrated.residual_noise)


def test_schema_2_is_migrated(fit, text, tmp_path):
    old = json.loads(text) | {"schema": 2}
    for entry in ("torque_constants", "units"):
        del old["provenance"][entry]
    old["processing"] |= {"order": 4, "average_periods": False, "smoother": "butterworth"}
    assert loaded(json.dumps(old), tmp_path).provenance == fit.provenance


@pytest.fixture(scope="module")
def coupled():
    """Two couplings on joint 1, of joints 2 and 3."""
    robot = random_arm(np.random.default_rng(3), 3, mixed=False)
    friction = plant.JointFriction(*np.full((3, 3), 2.0))
    true = [(1, 0.6, 0.4), (2, -0.5, 0.9)]
    hidden = [
        plant.TransmissionCoupling(0, source=source, viscous_coefficient=viscous, coulomb=coulomb)
        for source, viscous, coulomb in true
    ]
    sensors = plant.Sensors(rate=100.0, torque_noise=0.02)
    arm = plant.Arm(robot, robot.link_parameters, friction, tuple(hidden))
    couplings = "transmission_coupling:1<2,transmission_coupling:1<3"
    return lieid.identify(
        lieid.Model(robot, f"coulomb,viscous,offset,{couplings}"),
        recorded(arm, 2, seconds=15.0, step=0.01, sensors=sensors),
        method="feasible",
        processing=lieid.Processing(cutoff=8.0),
    ), true  # fmt: skip


def test_two_couplings_on_one_joint_have_their_own_numbers(coupled):
    fit, true = coupled
    placements = [p for p in fit.model.placements if p.source is not None]
    for placement, (source, viscous, coulomb) in zip(placements, true, strict=True):
        values, _, by_name = fitted_values(fit, placement)
        np.testing.assert_allclose(values, [viscous, coulomb], atol=0.05)
        for row in fit.parameter_table():
            if row["source"] == source + 1:
                assert row["value"] == by_name[row["name"].rpartition(".")[2]][0]
    shown = {row.label: row.values for row in effect_rows(fit)}
    assert [len(shown[p.label]) for p in placements] == [2, 2]
    assert shown[placements[0].label] != shown[placements[1].label]


def test_samples_of_two_couplings_are_apart(coupled, tmp_path):
    fit, _ = coupled
    samples = fit.sample(3, seed=1)
    export_samples(samples, tmp_path)
    arrays = np.load(tmp_path / "samples.npz")
    names = list(arrays["effect_coefficients_names"])
    assert names == [p.label for p in fit.model.columns]
    own = [names.index(f"transmission_coupling.f_c:1<{source}") for source in (2, 3)]
    drawn = arrays["effect_coefficients"][:, own]
    np.testing.assert_allclose(drawn.mean(axis=0), [0.4, 0.9], atol=0.1)


def test_a_file_whose_names_lack_the_acting_joint_is_read(coupled, tmp_path):
    fit, _ = coupled
    fit.save(tmp_path / "fit.json")
    content = json.loads((tmp_path / "fit.json").read_text("utf-8"))
    content["names"] = [name.partition("<")[0] for name in content["names"]]  # version 0.2
    np.testing.assert_array_equal(loaded(json.dumps(content), tmp_path).values, fit.values)
    content["names"][-1] = "transmission_coupling.f_c:2"
    assert "parameters are not those" in refusal(json.dumps(content), tmp_path)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "truncated"),
        (b"\xff\xfe\x00", "not JSON; expected a fit"),
        (b"t,q1,tau1", "not JSON; expected a fit"),
        (b"[" * 100_000, "nested too deeply"),
        (b'{"kind": "lieid-fit", "schema": 2, "values": [' + b"9" * 5000 + b"]}", "out of range"),
        (b'{"kind": "lieid-fit", "schema": 2, "values": [1e999]}', "out of range"),
        (
            b'{"kind": "lieid-fit", "schema": 2,\n "values": [NaN]}',
            "JSON is malformed: invalid character",
        ),
        (b"[]", "not a fit file"),
        (b'{"kind": "lieid-fit", "schema": true}', "no schema number"),
        (b'{"kind": "lieid-fit", "schema": 6}', "newer than 5"),
        (b'{"kind": "lieid-fit", "schema": 1, "noise": [[[]]]}', "not a usable fit"),
    ],
)
def test_bytes_that_are_no_fit(content, words, tmp_path):
    assert words in refusal(content, tmp_path)


@given(data=st.data())
def test_a_file_that_ends_anywhere_is_truncated(data, text, tmp_path_factory):
    end = data.draw(st.integers(1, len(text) - 2))
    assert "truncated" in refusal(text[:end], tmp_path_factory.mktemp("cut"))


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        (["residual_noise"], [], "residual_noise has 0 entries; expected 2"),
        (["residual_noise", 0, "filter"], [], "filter"),
        (["residual_noise", 0, "sigma"], 0.0, "sigma"),
        (["covariance", 1], [], "covariance[1] has 0 entries"),
        (["covariance", 1, 1], -1.0, "covariance[1][1]"),
        (["values"], ["1"], "values"),
        (["parameters", 0], 1e200, "parameters[0]"),
        (["a\nb\x1b[31m"], 0, "unknown field `a b?[31m`"),
        (["parameters"], [], "parameters has 0 entries"),
        (["certificate"], {}, "certificate"),
        (["processing", "cutoff"], None, "cutoff"),
        (["names", 0], "m1", "fit again"),
        (["robot", "text"], "name: [", "robot inside the fit"),
        (["robot", "kind"], "pickle", "expected urdf or yaml"),
    ],
)
def test_entries_that_are_not_valid(place, value, words, text, tmp_path):
    content = json.loads(text)
    entry = content
    for key in place[:-1]:
        entry = entry[key]
    entry[place[-1]] = value
    assert words in refusal(json.dumps(content), tmp_path)


def test_an_unknown_effect_is_named(text, tmp_path):
    with pytest.raises(EffectError, match=r"fit\.json: unknown effect 'cuolomb'; .*--effects-file"):
        loaded(text.replace('"coulomb:1"', '"cuolomb:1"'), tmp_path)


def test_a_file_that_is_not_there_or_too_large(tmp_path, monkeypatch):
    with pytest.raises(FitFileError, match="no such file"):
        lieid.Fit.load(tmp_path / "fit.json")
    with pytest.raises(FitFileError, match="cannot be read"):
        lieid.Fit.load(tmp_path)
    monkeypatch.setattr("lieid_casadi.identification.fit_file.LARGEST_FILE", 1 << 20)
    assert "larger than 1 MB" in refusal(b" " * ((1 << 20) + 1), tmp_path)
