"""Effects on the whole arm and on the measurement in exported C, against Fit.predict."""

import ctypes
import dataclasses

import numpy as np
import pytest
from exporters.c_arms import library, made_fit, pointer, sample_type
from robot.random_arms import random_arm

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.cli.main import main
from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.export import export
from lieid_casadi.robot.geometry import pose

PANDA = lieid.robots.panda()
FRICTION = "coulomb,viscous,offset,load_friction:2"
EFFECTS = {
    "bias_drift": "bias_drift:1",
    "all": "base_tilt,payload,external_wrench,encoder_offset:4,torque_gain:3,bias_drift:5",
}
SHORT = 4  # samples of a recording that is predicted as it was measured, not filtered
RUNS = 8


def tooled(robot):
    """A robot whose tool is neither at the last link's origin nor along its axes."""
    return dataclasses.replace(robot, tool=pose((0.05, 0.02, 0.12), (0.1, -0.2, 0.3)))


def arms(name):
    """A small arm with one effect; a Panda with all."""
    if name == "all":
        yield made_fit(tooled(PANDA), f"{FRICTION},{EFFECTS[name]}")
    else:
        yield made_fit(tooled(random_arm(np.random.default_rng(4), 5)), EFFECTS[name], seed=1)


def short_recordings(n):
    random = np.random.default_rng(3)
    for _ in range(RUNS):
        q, dq, ddq, tau = random.uniform(-1.5, 1.5, (4, SHORT, n))
        yield lieid.Recording.from_arrays(0.01 * np.arange(SHORT), q, dq, tau, ddq=ddq)


class Arm:
    """Exported functions on one sample."""

    def __init__(self, fit, folder):
        export(fit, folder, to="c")
        self.n, self.c = fit.model.n, library(folder)
        self.state = ctypes.create_string_buffer(4096)

    def torque(self, recording):
        """The whole torque (K, n)."""
        return np.array([self.at(recording, k, "torque") for k in range(len(recording.t))])

    def at(self, recording, k, name, *given, width=1):
        s = sample_type(self.n)()
        for signal in ("q", "dq", "ddq"):
            getattr(s, signal)[:] = getattr(recording, signal)[k].tolist()
        out = np.full(self.n * width, np.nan)
        getattr(self.c, f"arm_{name}")(ctypes.byref(s), *given, self.state, None, pointer(out))
        return out


@pytest.mark.parametrize("name", EFFECTS)
def test_torque_is_that_of_predict(name, tmp_path):
    for number, fit in enumerate(arms(name)):
        arm = Arm(fit, tmp_path / f"{number}")
        for recording in short_recordings(fit.model.n):
            expected = fit.predict(recording)
            got = arm.torque(recording)
            np.testing.assert_allclose(got, expected, rtol=0.0, atol=1e-10 * np.abs(expected).max())


def test_torque_is_that_of_a_simulated_arm_with_the_effect(tmp_path):
    """Compared with simulated arms, not with columns of this package."""
    robot = random_arm(np.random.default_rng(6), 4, mixed=False)
    cases = {
        # a point at the tool: of another body the effect neglects the inertia about it
        "payload": (plant.Payload(1.5, (0.0, 0.0, 0.0), 1e-9), [1.5, 0.0, 0.0, 0.0]),
        "external_wrench": (
            plant.ExternalWrench((1.0, -2.0, 0.5), (10.0, 5.0, -8.0)),
            [1.0, -2.0, 0.5, 10.0, 5.0, -8.0],
        ),
        "base_tilt": (plant.BaseTilt(0.06, -0.04), [0.06, -0.04]),
        "encoder_offset:3": (plant.EncoderOffset(2, 0.05), [0.05]),
        "torque_gain:3": (plant.TorqueGain(2, 0.1), [0.1]),
    }
    t = np.arange(0.0, 2.0, 0.05)
    motion = plant.FourierTrajectory(robot, base_frequency=0.1, seed=4).at(t)
    for number, (label, (effect, coefficients)) in enumerate(cases.items()):
        hidden = plant.Arm(
            robot, robot.link_parameters, plant.JointFriction.none(robot.n), (effect,)
        )
        recording = plant.measure_along(hidden, t, *motion)
        fit = made_fit(robot, label)
        fit = dataclasses.replace(
            fit, parameters=np.concatenate([robot.link_parameters, coefficients])
        )
        arm = Arm(fit, tmp_path / f"{number}")
        exact = lieid.Recording.from_arrays(t, recording.q, motion[1], recording.tau, ddq=motion[2])
        error = arm.torque(exact) - recording.tau
        assert np.abs(error).max() < 1e-6, label


def test_notes_name_what_is_not_exported(tmp_path):
    fit = made_fit(PANDA, "coulomb,torque_delay:2,bias_drift:1,payload")
    notes = export(fit, tmp_path / "arm", to="c").notes
    text = (tmp_path / "arm" / "arm.h").read_text()
    for label, words in (
        ("torque_delay:2", "without the delay"),
        ("bias_drift:1", "does not carry over"),
        ("payload", "part of effect_torque, not of rigid_torque"),
    ):
        assert any(note.startswith(label) and words in note for note in notes)
        assert f"{label}: " in text
    undelayed = made_fit(PANDA, "coulomb")
    undelayed = dataclasses.replace(undelayed, parameters=fit.parameters[: 10 * 7 + 7])
    delayed = made_fit(PANDA, "coulomb,torque_delay:2")
    delayed = dataclasses.replace(delayed, parameters=fit.parameters[: 10 * 7 + 8])
    recording = next(short_recordings(7))
    a, b = (Arm(f, tmp_path / n).torque(recording) for f, n in ((undelayed, "u"), (delayed, "d")))
    np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-12 * np.abs(b).max())


def test_elasticity_is_refused(tmp_path, capsys):
    fit = made_fit(PANDA, "coulomb,joint_elasticity:2")
    with pytest.raises(ExportError, match="joint_elasticity:2 needs the motion over time"):
        export(fit, tmp_path / "arm", to="c")
    assert not (tmp_path / "arm").exists()
    fit.save(tmp_path / "fit.json")
    folder = str(tmp_path / "out")
    assert main(["export", str(tmp_path / "fit.json"), "--to", "c", "-o", folder]) == 2
    assert capsys.readouterr().err.count("\n") == 1
