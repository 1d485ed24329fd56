"""Options of the command line for reading and processing recordings."""

import json

import numpy as np
import pytest
from recording.planar_arm import measured

import lieid_casadi as lieid
from lieid_casadi.cli.main import main


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The same run in SI units and in degrees and milliseconds, gzipped."""
    folder = tmp_path_factory.mktemp("runs")
    run = measured(duration=6.0, rate=100.0)
    run.save(folder / "si.csv.gz")
    lieid.Recording.from_arrays(1e3 * run.t, np.rad2deg(run.q), np.rad2deg(run.dq), run.tau).save(
        folder / "degrees.csv.gz"
    )
    return folder


def identified(files, name, *options):
    out = files / "fit.json"
    status = main(["identify", "two_link", str(files / name), "-o", str(out), *options])
    return status, json.loads(out.read_text()) if status == 0 else None


def test_units_and_smoothing(files, capsys):
    options = ["--cutoff", "5", "--smoothing", "rloess", "--effects", "coulomb"]
    status, expected = identified(files, "si.csv.gz", *options)
    assert status == 0
    assert expected["processing"]["smoother"] == "rloess"
    status, found = identified(files, "degrees.csv.gz", *options, "--units", "deg,ms")
    assert status == 0
    np.testing.assert_allclose(found["values"], expected["values"], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("options", "unit"), [([], "ms"), (["--units", "ms"], "deg")])
def test_a_prediction_from_other_units_is_refused(files, capsys, options, unit):
    assert identified(files, "si.csv.gz", "--cutoff", "5", "--effects", "coulomb")[0] == 0
    capsys.readouterr()
    arguments = [str(files / "fit.json"), str(files / "degrees.csv.gz")]
    assert main(["predict", *arguments, "-o", str(files / "p.csv"), *options]) == 2
    assert f"convert with --units {unit}" in capsys.readouterr().err
    assert not (files / "p.csv").exists()


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("degrees.csv.gz", [], "look like milliseconds; if they are, convert with --units ms"),
        ("degrees.csv.gz", ["--units", "ms"], "convert with --units deg"),
        ("si.csv.gz", ["--units", "yards"], "found 'yards', expected some of rad, deg, s, ms"),
        ("si.csv.gz", ["--inflate-limit", "0.01"], "limit of 0.01 MiB; if the file is what"),
        ("si.csv.gz", ["--inflate-limit", "0"], "expected MiB above 0"),
    ],
)
def test_refusals(files, capsys, name, options, message):
    (files / "fit.json").unlink(missing_ok=True)
    assert identified(files, name, *options)[0] == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (files / "fit.json").exists()
