"""Recordings of a fleet from stores: local files, S3, other arms, known payloads."""

from datetime import UTC, date, datetime

import numpy as np
import pytest
from fleet.simulated_fleet import fit_of, healthy_arm, recorded

from lieid_casadi import plant
from lieid_casadi.errors import FleetError
from lieid_casadi.fleet.arm_night import run_arm_night
from lieid_casadi.fleet.night_result import ArmNight
from lieid_casadi.fleet.recordings import RecordingFile, list_recordings, night_of
from lieid_casadi.identification.fit import content_of

DURATION = 15.0


@pytest.fixture(scope="module")
def content():
    return content_of(fit_of("two_link", 1, DURATION))


def night(path, **known):
    return ArmNight("A1", "2026-01-01", str(path), "", "f", **known)


@pytest.fixture(scope="module")
def s3_store():
    """An S3-compatible store on this machine."""
    import boto3
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    host, port = server.get_host_and_port()
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        environment.setenv("AWS_ACCESS_KEY_ID", "key")
        environment.setenv("AWS_SECRET_ACCESS_KEY", "secret")
        environment.setenv("AWS_DEFAULT_REGION", "us-east-1")
        client = boto3.client("s3")
        client.create_bucket(Bucket="nights")
        yield client
    server.stop()


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_recordings_in_s3(s3_store, tmp_path, content):
    recording = recorded(
        "two_link", healthy_arm("two_link", 1), motion_seed=3, seed=3, duration=DURATION
    )
    for name in ("one.csv", "two.parquet"):
        recording.save(tmp_path / name)
        s3_store.upload_file(str(tmp_path / name), "nights", f"A1/2026-01-05/{name}")
    s3_store.put_object(Bucket="nights", Key="A1/2026-01-06/empty.csv", Body=b"")
    files = list_recordings("s3://nights/A1/*/*.*")
    assert [file.location for file in files] == [
        "s3://nights/A1/2026-01-05/one.csv",
        "s3://nights/A1/2026-01-05/two.parquet",
        "s3://nights/A1/2026-01-06/empty.csv",
    ]
    assert len({file.stamp for file in files}) == 3
    assert night_of(files[0], None) == datetime.now(UTC).date()
    results = [run_arm_night(night(file.location), content) for file in files]
    assert [r.status for r in results] == ["done", "done", "refused"]
    np.testing.assert_allclose(
        [p.value for p in results[0].parameters], [p.value for p in results[1].parameters]
    )
    assert "s3://nights/A1/2026-01-06/empty.csv" in results[2].reason
    missing = run_arm_night(night("s3://nights/A1/none.csv"), content)
    assert missing.status == "failed"
    assert "no such file" in missing.reason
    assert list_recordings("s3://other/*") == []
    with pytest.raises(FleetError, match="expected a file, or a pattern"):
        list_recordings(str(tmp_path))


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("A1/2026-01-05.csv", date(2026, 1, 5)),
        ("A1/20260105T013000+0900.csv", date(2026, 1, 4)),
        ("A1/2026-01-05T23:59.csv", date(2026, 1, 5)),
    ],
)
def test_dates_are_utc_unless_the_path_carries_a_zone(path, expected):
    import re

    pattern = re.compile(r"A1/(?P<date>[\dT:+-]+)")
    assert night_of(RecordingFile(path, "", None), pattern) == expected


def test_a_date_that_is_not_found():
    import re

    for path, text in (("B/x.csv", "does not match"), ("A1/99.csv", "found '99' as date")):
        with pytest.raises(FleetError, match=text):
            night_of(RecordingFile(path, "", None), re.compile(r"A1/(?P<date>\d+)"))
    with pytest.raises(FleetError, match="no time of change"):
        night_of(RecordingFile("x", "", None), None)


def test_a_recording_of_another_arm_is_refused(tmp_path):
    content = content_of(fit_of("rail", 1, 20.0))
    other = recorded("ur10e", healthy_arm("ur10e", 2), motion_seed=3, seed=3, duration=20.0)
    own = recorded("rail", healthy_arm("rail", 1), motion_seed=3, seed=3, duration=20.0)
    other.save(tmp_path / "other.csv")
    own.save(tmp_path / "own.csv")
    refused = run_arm_night(night(tmp_path / "other.csv"), content)
    assert refused.status == "refused"
    assert "robot and recording do not belong together" in refused.reason
    assert run_arm_night(night(tmp_path / "own.csv"), content).status == "done"
    two = recorded("two_link", healthy_arm("two_link", 1), motion_seed=3, seed=3, duration=15.0)
    two.save(tmp_path / "two.csv")
    assert run_arm_night(night(tmp_path / "two.csv"), content).status == "refused"


def test_large_changes_of_an_arm_are_not_another_arm(tmp_path, content):
    arm = healthy_arm("two_link", 1)
    for effect in (plant.EncoderOffset(1, 0.1), plant.Payload(mass=3.0, com=(0.0, 0.1, 0.0))):
        recorded(
            "two_link", arm.with_effects(effect), motion_seed=3, seed=3, duration=DURATION
        ).save(tmp_path / "night.csv")
        assert run_arm_night(night(tmp_path / "night.csv"), content).status == "done"


def test_a_known_payload_is_not_a_change(tmp_path, content):
    from dataclasses import replace

    from lieid_casadi.robot.inertia import link_parameters

    com = (0.05, 0.02, 0.0)
    arm = healthy_arm("two_link", 1).with_effects(plant.Payload(mass=2.0, com=com, radius=1e-6))
    recording = recorded("two_link", arm, motion_seed=3, seed=3, duration=DURATION)
    replace(recording, payload_label=("crate",) * len(recording)).save(tmp_path / "night.csv")
    body = tuple(link_parameters(2.0, com, np.zeros((3, 3))).tolist())
    unknown = run_arm_night(night(tmp_path / "night.csv"), content)
    assert [f.effect for f in unknown.findings] == ["payload"]
    (finding,) = unknown.findings
    assert abs(finding.change - 2.0) < 0.02
    assert 0.0 < finding.std < 0.02
    known = run_arm_night(night(tmp_path / "night.csv", payloads=(("crate", body),)), content)
    assert known.findings == ()
    assert all(e.rms_moving < 1.3 * e.expected for e in known.errors)
    wrong = run_arm_night(night(tmp_path / "night.csv", payloads=(("box", body),)), content)
    assert wrong.status == "refused"
    assert "payload 'crate' is not in the fleet file; expected one of 'box'" in wrong.reason
