"""Stages of USD with identified numbers: masses are those of the fit, everything else stays."""

import numpy as np
import pytest
from exporters.test_urdf_export import ARM, fitted
from scipy.spatial.transform import Rotation

import lieid_casadi as lieid
from lieid_casadi.cli.main import main
from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.export import export
from lieid_casadi.robot.inertia import link_parameters, parameter_transport, pose

pxr = pytest.importorskip("pxr", reason="needs the extra usd")
CENTIMETRE, GRAM = 0.01, 0.001


@pytest.fixture(scope="module")
def fit():
    return fitted(lieid.Robot.parse_urdf(ARM, lock=("slide",)))


@pytest.fixture
def stage_file(tmp_path):
    """The arm as a user's stage, in centimetres and grams, with things that must stay."""
    from pxr import Usd, UsdGeom, UsdPhysics

    path = tmp_path / "bench.usda"
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, CENTIMETRE)
    UsdPhysics.SetStageKilogramsPerUnit(stage, GRAM)
    for link in ("base", "upper", "fore", "hand"):
        body = UsdGeom.Xform.Define(stage, f"/arm/{link}").GetPrim()
        UsdPhysics.RigidBodyAPI.Apply(body)
        UsdGeom.Cube.Define(stage, f"/arm/{link}/box").CreateSizeAttr().Set(3.0)
    UsdPhysics.MassAPI.Apply(stage.GetPrimAtPath("/arm/hand")).CreateMassAttr().Set(600.0)
    for name, parent, child in (("shoulder", "base", "upper"), ("elbow", "upper", "fore")):
        joint = UsdPhysics.RevoluteJoint.Define(stage, f"/arm/joints/{name}")
        joint.CreateBody0Rel().SetTargets([f"/arm/{parent}"])
        joint.CreateBody1Rel().SetTargets([f"/arm/{child}"])
        joint.CreateLowerLimitAttr().Set(-100.0)
    stage.GetRootLayer().Save()
    return path


def attributes(path):
    from pxr import Usd

    stage = Usd.Stage.Open(str(path))
    return {
        str(a.GetPath()): a.Get()
        for prim in stage.Traverse()
        for a in prim.GetAttributes()
        if a.HasAuthoredValue()
    }


def test_masses_are_those_of_the_fit_and_everything_else_stays(fit, stage_file, tmp_path):
    before, text = attributes(stage_file), stage_file.read_text()
    made = export(fit, tmp_path / "out", "usd", into=stage_file)
    after = attributes(made.files[0])
    assert stage_file.read_text() == text
    assert made.files[0].name == "bench.usda"
    changed, own = set(), []
    for link in ("upper", "fore", "hand"):
        prim = f"/arm/{link}.physics:"
        mass = after[f"{prim}mass"] * GRAM
        com = np.array(after[f"{prim}centerOfMass"]) * CENTIMETRE
        turn = after[f"{prim}principalAxes"]
        axes = Rotation.from_quat([*turn.GetImaginary(), turn.GetReal()]).as_matrix()
        moments = np.array(after[f"{prim}diagonalInertia"]) * GRAM * CENTIMETRE**2
        inertia = axes @ np.diag(moments) @ axes.T
        own.append(link_parameters(mass, com, inertia))
        names = ("mass", "centerOfMass", "principalAxes", "diagonalInertia")
        changed |= {f"{prim}{name}" for name in names}
    flange = pose([0.1, 0.3, 0.0], [0.2, 0.0, 0.0]) @ pose([0.0, 0.0, 0.02], [0.0, 0.0, 0.0])
    whole = np.concatenate([own[0], own[1] + parameter_transport(flange) @ own[2]])
    np.testing.assert_allclose(whole, fit.link_parameters, rtol=1e-4, atol=1e-6)
    armature = fit.effect_coefficients[[c.name for c in fit.model.columns].index("armature.I_a")]
    key = "/arm/joints/shoulder.physxJoint:armature"
    assert after[key] * GRAM * CENTIMETRE**2 == pytest.approx(armature, rel=1e-5)
    changed |= {f"/arm/joints/{name}.physxJoint:armature" for name in ("shoulder", "elbow")}
    kept = {k: v for k, v in before.items() if k not in changed}
    assert {k: v for k, v in after.items() if k not in changed} == kept
    assert any(note.startswith("hand: ") for note in made.notes)


def test_what_cannot_be_written_is_refused(fit, stage_file, tmp_path, capsys):
    with pytest.raises(ExportError, match="expected --into FILE"):
        export(fit, tmp_path / "out", "usd")
    with pytest.raises(ExportError, match="not a USD stage"):
        export(fit, tmp_path / "out", "usd", into=__file__)
    other = tmp_path / "other.usda"
    other.write_text(stage_file.read_text().replace('"elbow"', '"knee"'))
    with pytest.raises(ExportError, match=r"no joint 'elbow'; its joints: knee, shoulder"):
        export(fit, tmp_path / "out", "usd", into=other)
    assert not (tmp_path / "out").exists()
    fit.save(tmp_path / "fit.json")
    words = ["export", str(tmp_path / "fit.json"), "--to", "usd", "--into", str(stage_file)]
    assert main([*words, "-o", str(tmp_path / "out")]) == 0
    assert "bench.usda written to" in capsys.readouterr().out
