from functools import cache

import numpy as np
import pytest

from lieid_casadi.recording import Recording, check, process
from lieid_casadi.robot import Robot

pytestmark = pytest.mark.real

RUNS = {
    "ur10e/excitation_30s": ("ur10e/ur10e.urdf", 6, 94, (5, 12)),
    "ur10e/excitation_50s": ("ur10e/ur10e.urdf", 6, 94, (5, 12)),
    "ur10e/excitation_14_harmonics": ("ur10e/ur10e.urdf", 6, 94, (5, 12)),
    "ur10e/point_to_point": ("ur10e/ur10e.urdf", 6, 94, (3, 12)),
    "ur10e/joint_2_alone_currents": ("ur10e/ur10e.urdf", 6, 94, (1, 12)),
    "staubli_tx40/excitation": ("staubli_tx40/tx40.urdf", 6, 5000, (12, 30)),
    "franka_panda/excitation": ("franka_panda/panda.urdf", 7, 30, (1.5, 4)),
}
UR10E_CONSTANTS = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)


@cache
def loaded(file, constants=None):
    """A recording, read once for all tests."""
    return Recording.load(file, torque_constants=constants)


@pytest.fixture(params=RUNS)
def run(request, recordings):
    urdf, n, rate, cutoff = RUNS[request.param]
    lock = ("panda_finger_joint1", "panda_finger_joint2") if "panda" in urdf else ()
    robot = Robot.load(recordings / urdf, lock=lock)
    constants = UR10E_CONSTANTS if "currents" in request.param else None
    recording = loaded(recordings / f"{request.param}.csv.gz", constants)
    return recording, robot, n, rate, cutoff


def test_it_loads_without_false_alarms(run):
    recording, robot, n, rate, _ = run
    assert recording.n == n
    assert len(recording) / recording.duration == pytest.approx(rate, rel=0.02)
    assert len(recording.segments()) == 1
    found = [type(warning).__name__ for warning in check(recording, robot)]
    # only joint 2 moves in this recording, which is a warning
    alone = "joint_2_alone" in recording.name
    assert found == (["JointStillWarning"] if alone else [])


def test_it_is_processed_without_options(run):
    recording, _, _, _, (lowest, highest) = run
    (processed,) = process(recording)
    assert lowest <= processed.cutoff <= highest
    assert processed.rate < 30 * processed.cutoff or processed.rate < 110
    assert np.all(np.isfinite(processed.filter(processed.tau)))
