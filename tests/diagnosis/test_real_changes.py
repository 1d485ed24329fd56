"""Changes of a UR10e: none between motions; torques added to a recording are named."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from real_arms import UR10E, needs, ur10e_fit, ur10e_run

import lieid_casadi as lieid

pytestmark = needs(UR10E / "ur10e.urdf")


@pytest.mark.parametrize("name", ["excitation_14_harmonics", "point_to_point"])
def test_nothing_has_changed_between_motions(name):
    found = lieid.diagnose(ur10e_fit("coulomb,viscous,offset"), ur10e_run(name))
    assert found.verdict == "sufficient"
    assert found.steps == ()


@pytest.mark.parametrize(
    ("start", "end", "name"),
    [
        (13.0, 29.0, "point_to_point"),
        (13.0, 29.0, "excitation_30s"),
        (34.0, 50.0, "point_to_point"),
    ],
)
def test_nothing_has_changed_since_a_short_recording(start, end, name):
    model = lieid.Model(lieid.Robot.from_urdf(UR10E / "ur10e.urdf"), "coulomb,viscous,offset")
    part = ur10e_run("excitation_50s").cut(start, end)
    fit = lieid.identify(model, part, processing=lieid.Processing(cutoff=7.0))
    assert lieid.diagnose(fit, ur10e_run(name)).steps == ()


def test_a_body_at_the_tool_is_named():
    bare = pin.buildModelFromUrdf(str(UR10E / "ur10e.urdf"))
    loaded = pin.buildModelFromUrdf(str(UR10E / "ur10e.urdf"))
    loaded.inertias[6] += pin.Inertia(3.0, np.array([0.0, 0.0, 0.1]), 0.01 * np.eye(3))
    recording = ur10e_run("point_to_point")
    ddq = np.gradient(recording.dq, recording.t, axis=0)
    data, other = bare.createData(), loaded.createData()
    added = [
        pin.rnea(loaded, other, *state) - pin.rnea(bare, data, *state)
        for state in zip(recording.q, recording.dq, ddq, strict=True)
    ]
    found = lieid.diagnose(
        ur10e_fit("coulomb,viscous,offset"), replace(recording, tau=recording.tau + np.array(added))
    )
    assert [step.effect for step in found.steps] == ["payload"]
    assert found.steps[0].parameters["m"] == pytest.approx(3.0, abs=0.3)


@pytest.mark.parametrize(
    ("effect", "joint", "torque"),
    [
        ("offset", 4, lambda r: np.ones(len(r.t))),
        ("viscous", 2, lambda r: 15.0 * r.dq[:, 2]),
        ("torque_gain", 2, lambda r: 0.1 * r.tau[:, 2]),
    ],
)
def test_a_torque_added_to_one_joint_is_named(effect, joint, torque):
    recording = ur10e_run("excitation_14_harmonics").cut(0.0, 25.0)
    tau = recording.tau.copy()
    tau[:, joint] += torque(recording)
    found = lieid.diagnose(ur10e_fit("coulomb,viscous,offset"), replace(recording, tau=tau))
    assert [(step.effect, step.joints) for step in found.steps] == [(effect, (joint,))]
