"""Premises on the page: findings first, a button that applies the correction."""

import functools
import shlex

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi.cli.workbench import load_robot, read_recordings
from lieid_casadi.premises import PremiseCheck
from lieid_casadi.workbench.computation import Computation
from lieid_casadi.workbench.session import RecordingInput, WorkbenchInputs, WorkerSetup

SETUP = WorkerSetup(prepare=functools.partial(int), robot=load_robot, read=read_recordings)


@pytest.fixture(scope="module")
def swapped(two_link_files, tmp_path_factory):
    """Return the recordings with the torques of one joint turned round."""
    folder, paths = tmp_path_factory.mktemp("swapped"), []
    for path in two_link_files:
        r = lieid.Recording.load(path)
        paths.append(folder / path.name)
        lieid.Recording.from_arrays(r.t, r.q, r.dq, r.tau * [1.0, -1.0]).save(paths[-1])
    return paths


def test_a_finding_is_corrected_by_its_remedy(swapped):
    recordings = zip(map(str, swapped), ("train", "test"), strict=True)
    inputs = WorkbenchInputs("two_link", recordings=tuple(RecordingInput(*r) for r in recordings))
    computation = Computation(SETUP, inputs)
    found = computation.premises(report=lambda stage, fraction: None)
    assert isinstance(found, PremiseCheck)
    finding = found.findings[0]
    assert (found.verdict, finding.premise) == ("wrong", "torque_sign")
    corrected = Computation(SETUP, inputs.with_options(shlex.split(finding.remedy)))
    whole = lieid.Recording.load(swapped[0])
    np.testing.assert_allclose(corrected.recordings[0].tau, whole.tau * [1.0, -1.0])
    assert corrected.premises(report=lambda stage, fraction: None).verdict == "sound"


def test_options_take_the_place_of_the_same_ones():
    inputs = WorkbenchInputs().with_options(["--units", "deg", "--lock", "a", "b"])
    assert inputs.options == (("units", ("deg",)), ("lock", ("a", "b")))
    more = inputs.with_options(["--units", "ms", "--lock", "c", "--derive-velocity"])
    assert more.words == ["--units", "deg,ms", "--lock", "c", "--derive-velocity"]
    assert more.without_option("units").words == ["--lock", "c", "--derive-velocity"]


@pytest.mark.slow
def test_the_button_of_a_finding_opens_the_corrected_recordings(start, browse, swapped):
    server = start("two_link", *map(str, swapped))
    page = browse(server.url)
    page.wait(lambda: page.shown("premise-torque_sign"), "the finding")
    assert "wrong" in page.text("premise-torque_sign")
    page.picture("premise_found")
    page.click("correct-torque_sign", done=lambda: not page.shown("premise-torque_sign"))
    page.wait(lambda: "belong together" in page.text("premises"), "the verdict")
    page.click("copy-command", done=lambda: "--torque-sign" in page.text("command-shell"))
    page.click("close-commands", done=lambda: not page.shown("command-shell"))
    page.picture("premise_corrected")
    page.click("uncorrect-torque-sign", done=lambda: page.shown("premise-torque_sign"))
    assert page.script_errors() == []
