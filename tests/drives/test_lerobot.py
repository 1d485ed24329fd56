"""LeRobot datasets, versions 2.1 and 3.0."""

import json

import numpy as np
import pytest
from drives.lerobot_files import JOINTS, LENGTHS, SO101, frames, write

import lieid_casadi as lieid
from lieid_casadi.errors import RecordingError, SameRecordingWarning
from lieid_casadi.recording.plausibility import check_time

LIMITS = np.column_stack([SO101.limit("position_lower"), SO101.limit("position_upper")])


def load(folder, **options):
    return lieid.Recording.load(
        folder, joint_names=JOINTS, position_limits=LIMITS, **({"calibration": "limits"} | options)
    )


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_both_versions(tmp_path, version):
    recording = load(write(tmp_path / "set", version))
    assert [len(segment) for segment in recording.segments()] == list(LENGTHS)
    assert recording.rate == pytest.approx(30.0)
    state, action = frames(40)
    share = (state[:, :5] + 100.0) / 200.0
    expected = LIMITS[:5, 0] + share * (LIMITS[:5, 1] - LIMITS[:5, 0])
    np.testing.assert_allclose(recording.q[:40, :5], expected, atol=1e-6)
    jaw = LIMITS[5, 0] + action[:, 5] / 100.0 * (LIMITS[5, 1] - LIMITS[5, 0])
    np.testing.assert_allclose(recording.command[:40, 5], jaw, atol=1e-6)
    assert "AssumedCalibrationWarning" in {type(w).__name__ for w in recording.warnings}
    assert not list(check_time(recording))  # pauses between episodes are no dropouts


def test_episodes_are_a_part_of_the_name(tmp_path):
    """The other episodes of a dataset are no training data."""
    folder = write(tmp_path / "set")
    train, test = load(folder, episodes=(0, 2)), load(folder, episodes=(2, None))
    assert (train.name, test.name) == ("set episodes 0:2", "set episodes 2:")
    robot = SO101.with_drives(lieid.servo_drive("sts3215"))
    train, test = (run.with_drives(robot.drives) for run in (train, test))
    fit = lieid.identify(
        lieid.Model(robot, "viscous"), train, processing=lieid.Processing(cutoff=5.0, trim=0.1)
    )

    def warned(recording):
        found = lieid.compare(fit, recording).warnings
        return any(isinstance(w, SameRecordingWarning) for w in found)

    assert not warned(test)
    assert warned(train)


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_episodes(tmp_path, version):
    recording = load(write(tmp_path / "set", version), episodes=(1, 3))
    assert [len(segment) for segment in recording.segments()] == [30, 50]
    np.testing.assert_allclose(recording.q, load(tmp_path / "set").q[40:])


def test_calibration_file(tmp_path):
    file = tmp_path / "arm.json"
    motor = {"id": 1, "drive_mode": 0, "homing_offset": 12, "range_min": 1000, "range_max": 3000}
    file.write_text(json.dumps(dict.fromkeys(JOINTS, motor)))
    recording = load(write(tmp_path / "set"), calibration=str(file))
    state, _ = frames(40)
    per_count = 2.0 * np.pi / 4096
    np.testing.assert_allclose(recording.q[:40, 0], state[:, 0] * 10 * per_count, atol=1e-6)
    assert not recording.warnings


def test_joints_are_matched_by_name(tmp_path):
    order = [*JOINTS[::-1], "extra"]

    def reversed_frames(length, start):
        state, action = frames(length, start)
        zero = np.zeros((length, 1), np.float32)
        return np.hstack([state[:, ::-1], zero]), np.hstack([action[:, ::-1], zero])

    names = [f"main_{joint}" for joint in order]
    recording = load(write(tmp_path / "set", "v2.1", names, reversed_frames))
    np.testing.assert_allclose(recording.q, load(write(tmp_path / "other")).q, atol=1e-6)


def test_refusals(tmp_path):
    folder = write(tmp_path / "set")
    with pytest.raises(RecordingError, match="--calibration FILE"):
        load(folder, calibration=None)
    with pytest.raises(RecordingError, match="no frames in episodes 7:"):
        load(folder, episodes=(7, None))
    with pytest.raises(RecordingError, match="no motor 'joint1'"):
        lieid.Recording.load(folder, joint_names=["joint1"], calibration="limits")
    with pytest.raises(RecordingError, match="no such file"):
        load(folder, calibration=str(tmp_path / "none.json"))

    def in_degrees(length, start):
        state, action = frames(length, start)
        return state * 1.5, action * 1.5

    with pytest.raises(RecordingError, match="--units deg"):
        load(write(tmp_path / "degrees", positions=in_degrees), calibration=None)
    (folder / "meta" / "info.json").write_text("{}")
    with pytest.raises(RecordingError, match="not the description of a LeRobot dataset"):
        load(folder)
