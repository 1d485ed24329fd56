"""Functions accept a robot in place of a model, and say how a file becomes a recording."""

from pathlib import Path

import numpy as np
import pytest
from exporters.c_arms import ARMS

import lieid_casadi as lieid
from lieid_casadi.errors import ModelError, RecordingError
from lieid_casadi.recording.recording import listed

ROBOT = lieid.robots.two_link()


@pytest.fixture(scope="module")
def recording():
    t = np.arange(0.0, 4.0, 0.01)[:, None]
    q, dq, ddq = np.sin([1, 2] * t), [1, 2] * np.cos([1, 2] * t), [-1, -4] * np.sin([1, 2] * t)
    tau = lieid.compile(ROBOT).inverse_dynamics(q, dq, ddq, ROBOT.link_parameters)
    noise = 0.01 * np.random.default_rng(1).normal(size=tau.shape)
    return lieid.Recording.from_arrays(t[:, 0], q, dq, tau + noise, ddq=ddq)


def test_a_robot_is_accepted_as_its_model_without_effects(recording):
    fit = lieid.identify(ROBOT, recording)
    assert fit.model.robot is ROBOT
    assert not fit.model.effects
    np.testing.assert_array_equal(fit.values, lieid.identify(lieid.Model(ROBOT), recording).values)
    np.testing.assert_array_equal(lieid.predict(fit, recording), fit.predict(recording))


def test_what_is_no_model_is_refused(recording):
    for function in (lieid.compile, lambda model: lieid.identify(model, recording)):
        with pytest.raises(ModelError, match=r"'arm\.urdf'; expected .*Robot\.load\(path\)"):
            function("arm.urdf")


@pytest.mark.parametrize("path", ["x.csv", [Path("x.csv")]], ids=repr)
@pytest.mark.parametrize(
    "function",
    [
        lambda path: lieid.identify(lieid.Model(ROBOT), path),
        lambda path: lieid.predict(ARMS["rigid"](), path),
        lambda path: lieid.compare(ARMS["rigid"](), path),
        lambda path: lieid.diagnose(ARMS["rigid"](), path),
        lambda path: lieid.friction(ROBOT, path, 0),
        lambda path: lieid.identify_payload(ARMS["rigid"](), path),
    ],
    ids=["identify", "predict", "compare", "diagnose", "friction", "identify_payload"],
)
def test_a_path_in_place_of_a_recording_is_refused(function, path):
    with pytest.raises(RecordingError, match=r"got the path 'x\.csv'; expected Recording\.load"):
        function(path)


def test_recordings_may_be_any_iterable(recording):
    assert listed(iter([recording])) == listed(recording) == [recording]
    with pytest.raises(RecordingError, match="got a float; expected a Recording"):
        listed(1.0)
