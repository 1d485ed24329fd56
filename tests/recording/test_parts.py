import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recording.planar_arm import measured

from lieid_casadi.errors import RecordingError
from lieid_casadi.recording import Recording, join, process


@pytest.fixture
def run(tmp_path):
    file = tmp_path / "run.csv"
    measured(duration=10, rate=100).save(file)
    return file


@pytest.mark.parametrize(
    ("part", "first", "last"),
    [("@2:5", 2.0, 4.99), ("@:3", 0.0, 2.99), ("@4.5:", 4.5, 9.99), ("@:", 0, 9.99), ("", 0, 9.99)],
)
def test_part_of_a_file(run, part, first, last):
    recording = Recording.load(f"{run}{part}")
    assert recording.t[0] == pytest.approx(first)
    assert recording.t[-1] == pytest.approx(last)
    whole = Recording.load(run)
    assert recording.source_hash == whole.source_hash
    inside = (whole.t >= first) & (whole.t <= last)
    np.testing.assert_array_equal(recording.tau, whole.tau[inside])


@pytest.mark.parametrize(
    ("part", "expected"),
    [
        ("@5:2", "expected T0 < T1"),
        ("@a:2", "found 'a' after @"),
        ("@nan:", "found 'nan' after @"),
        ("@20:30", "0 rows in that part, expected some of 0 to 9.99 s"),
        ("@1:1.005", "1 rows in that part"),
    ],
)
def test_bad_part(run, part, expected):
    with pytest.raises(RecordingError, match=expected):
        Recording.load(f"{run}{part}")


def test_a_file_whose_name_looks_like_a_part(tmp_path):
    file = tmp_path / "run.csv@0:1.csv"
    measured(duration=3, rate=100).save(file)
    assert len(Recording.load(file)) == 300
    assert len(Recording.load(f"{file}@0:1")) == 100


def without(recording, low, high):
    keep = (recording.t < low) | (recording.t >= high)
    return Recording.from_arrays(
        recording.t[keep], recording.q[keep], recording.dq[keep], recording.tau[keep]
    )


@given(st.floats(1.0, 8.0), st.floats(0.1, 1.0))
def test_segments_end_at_gaps_and_lose_no_row(start, length):
    recording = without(measured(duration=10, rate=100, noise=0), start, start + length)
    segments = recording.segments()
    assert len(segments) == 2
    assert max(np.diff(s.t).max() for s in segments) < 0.0101
    np.testing.assert_array_equal(np.concatenate([s.q for s in segments]), recording.q)


def test_irregular_stamps_and_single_lost_samples_are_no_gaps():
    assert len(measured(jitter=0.9).segments()) == 1
    assert len(without(measured(rate=100), 3.0, 3.02).segments()) == 1


def test_segments_end_where_the_payload_changes():
    label = ["none"] * 1000 + ["2 kg"] * 1000
    recording = measured(duration=10, rate=200, load=label)
    assert [s.payload_label[0] for s in recording.segments()] == ["none", "2 kg"]
    assert [p.payload_label for p in process(recording)] == ["none", "2 kg"]


def test_joined_recordings_keep_their_segments():
    one, two = measured(duration=5), measured(duration=6, seed=1)
    both = join([one, two])
    assert len(both) == len(one) + len(two)
    first, second = both.segments()
    np.testing.assert_array_equal(first.tau, one.tau)
    np.testing.assert_array_equal(second.tau, two.tau)
    np.testing.assert_allclose(np.diff(second.t), np.diff(two.t), atol=1e-12)


def test_recordings_of_different_sources_are_never_one_segment():
    one = measured(duration=5)
    two = Recording.from_arrays(one.t + 5.0, one.q, one.dq, one.tau)  # its clock would fit
    assert len(join([one, two]).segments()) == 2


def test_parts_of_one_recording_join_into_the_whole():
    whole = measured(duration=6)
    again = join([whole.cut(None, 2.5), whole.cut(2.5, None)])
    np.testing.assert_array_equal(again.t, whole.t)
    assert len(again.segments()) == 1


def test_join_keeps_what_all_have_and_labels():
    one = measured(duration=2, load=["a"] * 400)
    two = Recording.from_arrays(one.t, one.q, tau=one.tau)
    both = join([one, two])
    assert both.dq is None
    assert both.tau is not None
    assert both.payload_label == ("a",) * 400 + ("",) * 400


def test_join_refuses_other_joints_and_nothing():
    with pytest.raises(RecordingError, match="has 1 joints, expected 2"):
        join([measured(), Recording.from_arrays([0, 1], [[0], [1]])])
    with pytest.raises(RecordingError, match="no recordings"):
        join([])
