import numpy as np
import pytest
from recording.bag_files import NAMES, START, StoragePlugin, arm_messages, write
from recording.planar_arm import measured

import lieid_casadi as lieid
from lieid_casadi.errors import RecordingError
from lieid_casadi.recording import Recording


@pytest.fixture(scope="module")
def arm():
    return measured(duration=2, rate=100)


@pytest.mark.parametrize("plugin", list(StoragePlugin))
@pytest.mark.parametrize("stamped", [True, False])
def test_a_bag_comes_back(tmp_path, arm, plugin, stamped):
    bag = write(tmp_path / "bag", arm_messages(arm, stamped=stamped), plugin)
    suffix = ".mcap" if plugin is StoragePlugin.MCAP else ".db3"
    files = [bag, *(p for p in bag.iterdir() if p.suffix == ".mcap" == suffix)]
    for file in files:
        recording = Recording.load(file)
        np.testing.assert_allclose(recording.t, arm.t, atol=1e-9)
        np.testing.assert_array_equal(recording.q, arm.q)
        np.testing.assert_array_equal(recording.dq, arm.dq)
        np.testing.assert_array_equal(recording.tau, arm.tau)
        assert len(recording.source_hash) == 64


def test_joints_are_ordered_by_the_robot(tmp_path, arm):
    bag = write(tmp_path / "bag", arm_messages(arm, names=["elbow", "shoulder"]))
    np.testing.assert_array_equal(Recording.load(bag).q, arm.q[:, ::-1])
    ordered = Recording.load(bag, joint_names=NAMES)
    np.testing.assert_array_equal(ordered.q, arm.q)
    np.testing.assert_array_equal(ordered.tau, arm.tau)


def test_signals_of_a_bag_may_be_taken_for_others(tmp_path, arm):
    bag = write(tmp_path / "bag", arm_messages(arm))
    read = Recording.load(bag, columns="tau1=tau2,tau2=tau1")
    np.testing.assert_array_equal(read.tau, arm.tau[:, ::-1])
    read = Recording.load(bag, columns="i=tau", torque_constants=[2.0, 3.0])
    np.testing.assert_array_equal(read.tau, arm.tau * [2.0, 3.0])
    with pytest.raises(RecordingError, match="no column temp1"):
        Recording.load(bag, columns="tau1=temp1")


def test_messages_of_a_gripper_are_ignored(tmp_path, arm):
    gripper = [
        ("/joint_states", START + 3_000_000 + k * 50_000_000, ["finger"], [0.0], None, None, True)
        for k in range(20)
    ]
    messages = sorted(arm_messages(arm) + gripper, key=lambda m: m[1])
    bag = write(tmp_path / "bag", messages)
    np.testing.assert_array_equal(Recording.load(bag, joint_names=NAMES).q, arm.q)


def test_several_topics_need_a_choice(tmp_path, arm):
    other = [(*m[:3], m[3] + 1.0, *m[4:]) for m in arm_messages(arm, topic="/left")]
    bag = write(tmp_path / "bag", arm_messages(arm) + other)
    with pytest.raises(RecordingError, match=r"/joint_states, /left.*topic="):
        Recording.load(bag)
    recording = Recording.load(bag, topic="/left")
    np.testing.assert_array_equal(recording.q, arm.q + 1.0)
    with pytest.raises(RecordingError, match="expected /right among them"):
        Recording.load(bag, topic="/right")


def test_bad_bags(tmp_path, arm):
    messages = arm_messages(arm)
    bag = write(tmp_path / "good", messages)
    with pytest.raises(RecordingError, match=r"found 2 joints \(shoulder, elbow\), expected 7"):
        Recording.load(bag, n=7)
    with pytest.raises(RecordingError, match="no joint 'wrist'"):
        Recording.load(bag, joint_names=[*NAMES, "wrist"])
    with pytest.raises(RecordingError, match="no JointState message with the joints wrist"):
        Recording.load(bag, joint_names=["wrist"])
    mixed = [messages[0], (*messages[1][:5], None, True), *messages[2:]]
    with pytest.raises(RecordingError, match="1 of 200 messages lack effort"):
        Recording.load(write(tmp_path / "mixed", mixed))
    (database,) = bag.glob("*.db3")
    for content in (b"no bag", b"", database.read_bytes()[:9000]):
        for name in ("broken.mcap", "broken.db3"):
            (tmp_path / name).write_bytes(content)
            with pytest.raises(RecordingError, match="not a bag that can be read"):
                Recording.load(tmp_path / name)
    (tmp_path / "empty").mkdir()
    with pytest.raises(RecordingError, match=r"found a folder, expected one with metadata\.yaml"):
        Recording.load(tmp_path / "empty")


def test_commands_match_joints_by_name(tmp_path, arm):
    """Joint state topics are often in alphabetical order, without a word about it."""
    from lieid_casadi.cli.main import main

    arm.save(tmp_path / "run.csv")
    write(tmp_path / "bag", arm_messages(arm, names=["elbow", "shoulder"]))
    fits = [tmp_path / "csv.json", tmp_path / "bag.json"]
    options = ["--cutoff", "8", "--despite-check"]  # the arm is heavier than two_link
    for recording, fit in zip((tmp_path / "run.csv", tmp_path / "bag"), fits, strict=True):
        assert main(["identify", "two_link", str(recording), *options, "-o", str(fit)]) == 0
    values = [lieid.Fit.load(fit).values for fit in fits]
    np.testing.assert_allclose(values[0], values[1], rtol=1e-6)
