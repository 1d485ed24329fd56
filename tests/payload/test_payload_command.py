"""``lieid payload``: table, JSON, report; one line and status 2 for bad input."""

import json

import numpy as np
import pytest
from payload.loaded_plant import PAYLOAD, fitted, measured
from report.test_reports import FETCHING, Page

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.cli.main import main

ROBOT = lieid.robots.two_link()
ARM = plant.demo_arm(ROBOT, seed=2, hidden=None)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("payload")
    fitted(ARM).save(folder / "fit.json")
    measured(ARM.with_effects(PAYLOAD), motion=7, seed=5).save(folder / "loaded.csv")
    return folder


def lieid_payload(*words):
    return main(["payload", *map(str, words)])


def test_table_json_and_report(files, tmp_path, capsys):
    out, page = tmp_path / "p.json", tmp_path / "p.html"
    words = [files / "fit.json", files / "loaded.csv"]
    words += ["--json", out, "--html", page]
    assert lieid_payload(*words) == 0
    shown = capsys.readouterr().out
    sentence = next(line for line in shown.splitlines() if line.startswith("Payload "))
    assert sentence.startswith(("Payload 1.99", "Payload 2.00"))
    assert "not identified: com_z" in shown
    content = json.loads(out.read_text())
    assert content["mass"] == pytest.approx(2.0, abs=4 * content["std"]["mass"])
    assert content["com"][2] is None
    assert content["std"]["com"][2] is None
    assert len(content["inertia"]) == len(content["std"]["inertia"]) == 6
    low, high = content["interval_95"]["mass"]
    assert low < content["mass"] < high
    assert {part["name"] for part in content["not_identified"]} >= {"com_z", "Ixx"}
    assert len(content["rms_before"]) == len(content["rms_after"]) == ROBOT.n
    assert content["warnings"] == []
    html = Page(page.read_text())
    assert sentence[:20] in "".join(html.text)
    assert not [v for n in FETCHING for v in html.values(n) if not v.startswith(("data:", "#"))]


def test_currents_with_torque_constants(files, tmp_path):
    run = lieid.Recording.load(files / "loaded.csv")
    constants = np.array([11.0, 9.0])
    amperes = lieid.Recording.from_arrays(run.t, run.q, run.dq, current=run.tau / constants)
    amperes.save(tmp_path / "amperes.csv")
    found = []
    for words in ([files / "loaded.csv"], [tmp_path / "amperes.csv", "--torque-constants=11,9"]):
        assert lieid_payload(files / "fit.json", *words, "--json", tmp_path / "p.json") == 0
        found.append(json.loads((tmp_path / "p.json").read_text())["mass"])
    assert found[0] == pytest.approx(found[1], rel=1e-9)


def _panda(files):
    path = files / "panda.csv"
    measured(plant.demo_arm(lieid.robots.panda(), hidden=None), seconds=10.0).save(path)
    return path


def _without_torque(files):
    run = lieid.Recording.load(files / "loaded.csv")
    path = files / "no_torque.csv"
    lieid.Recording.from_arrays(run.t, run.q, run.dq).save(path)
    return path


@pytest.mark.parametrize(
    ("make", "words", "message"),
    [
        (_panda, [], "found 7 joints"),
        (_without_torque, [], "no torque"),
        (None, ["--cutoff", "-1"], "cutoff"),
        (None, ["--cutoff", "fast"], "expected a number"),
        (None, ["--torque-constants", "1,2,3"], "3 numbers; expected 1 or 2"),
        (lambda files: files / "gone.csv", [], "no such file"),
    ],
)
def test_bad_input_is_one_line(files, tmp_path, refusal, make, words, message):
    recording = files / "loaded.csv" if make is None else make(files)
    out = tmp_path / "p.json"
    shown = refusal(["payload", files / "fit.json", recording, *words, "--json", out], message)
    # the check prints its table before the command fails
    assert shown.startswith("Robot and recording") or not shown
    assert not out.exists()


def test_a_recording_in_place_of_a_fit_is_refused_in_one_line(files, refusal):
    refusal(["payload", files / "loaded.csv", files / "loaded.csv"], "not JSON; expected a fit")
