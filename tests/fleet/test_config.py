"""Fleet files: what they hold, and errors that name the line."""

import numpy as np
import pytest

from lieid_casadi.errors import FleetError
from lieid_casadi.fleet.config import read_fleet

ARM = """arms:
  - serial: A17
    fit: fits/a17.json
    recordings: nights/a17/*.csv
"""


def fleet_of(tmp_path, text):
    path = tmp_path / "fleet.yaml"
    path.write_text(text, encoding="utf-8")
    return read_fleet(path)


def test_an_arm_with_all_that_is_known_of_it(tmp_path):
    text = (
        ARM
        + """    torque_constants: [14.9, 13.3]
    tool: {xyz: [0, 0, 0.1]}
    payload:
      - {mass: 2.0, com: [0, 0, 0.05], inertia: {ixx: 0.01, iyy: 0.01, izz: 0.02}, label: crate}
      - {mass: 0.5, com: [0.01, 0, 0]}
    limits: {coulomb: [5.0, 3.0], viscous: 2.0}
  - serial: B2
    robot: panda
    train: [one.csv, "s3://bucket/two.csv"]
    recordings: ["s3://bucket/b2/*.parquet", later/*.mcap]
night: "{serial}/(?P<date>\\\\d{4}-\\\\d{2}-\\\\d{2})"
"""
    )
    fleet = fleet_of(tmp_path, text)
    first, second = fleet.arms
    assert [f.value for f in first.fits] == [str(tmp_path / "fits/a17.json")]
    assert [k.value for k in first.torque_constants] == [(14.9, 13.3)]
    np.testing.assert_allclose(first.tools[0].value[:3, 3], [0.0, 0.0, 0.1])
    assert [p.value.label for p in first.payloads] == ["crate", ""]
    np.testing.assert_allclose(
        first.payloads[0].value.parameters, [2, 0, 0, 0.1, 0.015, 0, 0.015, 0, 0, 0.02]
    )
    assert first.limits == {"coulomb": (5.0, 3.0), "viscous": (2.0,)}
    assert second.robot == "panda"
    assert second.train == (str(tmp_path / "one.csv"), "s3://bucket/two.csv")
    assert second.recordings[0] == "s3://bucket/b2/*.parquet"
    match = fleet.night_pattern("A17").search("x/A17/2026-01-02.csv")
    assert match["date"] == "2026-01-02"
    assert fleet.night_pattern("A17").search("x/B2/2026-01-02.csv") is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("arms: []", "line 1: arms: Expected 'array' of length >= 1"),
        ("arms:\n  - serial: A\n    fit: f\n", "line 2: .*missing required field 'recordings'"),
        (ARM + "    colour: red\n", "line 2: .*unknown field 'colour'"),
        (ARM.replace("A17", "17"), "line 2: arms\\[0\\].serial: Expected 'str', got 'int'"),
        (ARM + ARM.partition("\n")[2], "line 5: arms\\[1\\].serial: found 'A17' twice"),
        (
            ARM + "    robot: panda\n",
            "line 2: arms\\[0\\]: expected either fit, or robot",
        ),
        (ARM + "night: '(\\d+)'\n", "line 5: night: .*\\(\\?P<date>"),
        (ARM + "night: '(?P<date'\n", "line 5: night: .*regular expression"),
        (ARM + "    limits: {coulomb: -1}\n", "line 5: arms\\[0\\].limits: .*> 0"),
        (ARM + "    payload: {mass: 1}\n", "line 5: .*missing required field 'com'"),
        (ARM + "    torque_constants: [1, 0]\n", "line 5: .*other than 0"),
        ("arms:\n  - [", "line 3, column"),
        ("arms: !!python/object:os.system x", "tag"),
    ],
)
def test_errors_are_one_line_with_the_line_in_the_file(tmp_path, text, message):
    with pytest.raises(FleetError, match=message) as caught:
        fleet_of(tmp_path, text)
    assert str(caught.value).startswith(str(tmp_path / "fleet.yaml"))
    assert "\n" not in str(caught.value)
