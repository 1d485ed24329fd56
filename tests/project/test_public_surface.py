"""What is public: names, docstrings, arguments that are accepted, and what importing costs."""

import inspect
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from exporters.c_arms import ARMS

import lieid_casadi as lieid
from lieid_casadi.errors import ModelError, RecordingError
from lieid_casadi.recording.recording import listed

PUBLIC = {
    "Batch", "CartesianSpeed", "Coefficient", "Comparison", "Compiled",
    "Diagnosis", "Discrimination", "Drive", "DriveGains", "Effect", "Excitation", "Experiment",
    "Export", "Fit", "FrictionFit", "Joint", "LieidError",
    "LieidWarning", "Limits", "Model", "Obstacle", "PayloadEstimate",
    "PlannedMotion", "PremiseCheck", "Processing", "Recording", "Robot", "SelfCollision", "Shape",
    "Signals", "Simulation", "SymbolicDynamics", "Torque", "Wall",
    "__version__", "check", "compare", "compile", "default_limits", "diagnose",
    "discriminate", "drive_gains", "effect", "excite", "experiment", "export", "extend", "floor",
    "friction", "identify", "identify_payload", "predict",
    "register", "robots", "servo_drive", "simulate", "symbolic", "workspace_box",
}  # fmt: skip


def test_public_names():
    """A change here is a change of the public interface: say so in the CHANGELOG."""
    assert set(lieid.__all__) == PUBLIC
    assert all(getattr(lieid, name) is not None for name in PUBLIC)
    assert set(dir(lieid)) == PUBLIC


def test_importing_is_quick():
    """Heavy libraries are imported where they are used."""
    script = (
        "import sys, lieid_casadi, lieid_casadi.cli.main as m; m.build_parser(); "
        "heavy = {'casadi', 'pinocchio', 'matplotlib', 'cvxpy', 'scipy', 'numpy'}; "
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


FEWEST = 3  # arguments from which on a Parameters section is required


def functions(name):
    """Yield name and function: the public object itself, or the public methods of a class."""
    found = getattr(lieid, name)
    if inspect.isfunction(found):
        yield name, found
    if inspect.isclass(found):
        for method, value in inspect.getmembers(found):
            function = inspect.unwrap(getattr(value, "__func__", value))
            own = inspect.isfunction(function) and function.__module__.startswith("lieid_casadi")
            if own and not method.startswith("_"):
                yield f"{name}.{method}", function


@pytest.mark.parametrize("name", [n for n in lieid.__all__ if n not in ("__version__", "robots")])
def test_public_functions_with_three_or_more_arguments_have_a_parameters_section(name):
    assert (inspect.getdoc(getattr(lieid, name)) or "").strip()
    for place, function in functions(name):
        text = inspect.getdoc(function) or ""
        assert text, place
        arguments = [
            a.name
            for a in inspect.signature(function).parameters.values()
            if a.name not in ("self", "cls") and a.kind is not a.VAR_KEYWORD
        ]
        shared = inspect.getdoc(getattr(lieid, name)) if "." in place else ""  # for all methods
        if len(arguments) >= FEWEST and not all(
            re.search(rf"\b{argument}\b", f"{text}\n{shared}") for argument in arguments
        ):
            assert "Parameters\n---" in text or text.startswith("See `"), place


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
