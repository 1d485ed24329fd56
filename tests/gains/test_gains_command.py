"""``lieid gains``: table, JSON, printed option; one line and status 2 for bad input."""

import json

import numpy as np
import pytest
from gains.test_drive_gains import ARM, GAINS, LOADED, MASS, amperes

from lieid_casadi.cli.main import main


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("gains")
    amperes(ARM, seconds=15.0).save(folder / "empty.csv")
    amperes(LOADED, motion=5, seed=1, seconds=15.0).save(folder / "loaded.csv")
    return folder


def lieid_gains(files, *words, unloaded="empty.csv", loaded="loaded.csv", mass=MASS):
    given = ["--unloaded", files / unloaded, "--loaded", files / loaded, "--mass", mass]
    return main(["gains", "panda", *map(str, [*given, *words])])


def test_table_json_and_the_option(files, tmp_path, capsys):
    out = tmp_path / "g.json"
    assert lieid_gains(files, "--json", out) == 0
    shown = capsys.readouterr().out
    content = json.loads(out.read_text())
    assert len(content["gains"]) == len(content["std"]) == 7
    z = (np.array(content["gains"]) - GAINS) / np.array(content["std"])
    assert np.all(np.abs(z) < 3.5)
    assert content["not_identified"] == []
    assert content["warnings"] == []
    assert content["option"] in shown.splitlines()


@pytest.mark.parametrize(
    ("words", "files_and_mass", "message"),
    [
        ([], {"mass": 0}, "--mass: 0: expected a number above 0"),
        ([], {"unloaded": "loaded.csv", "loaded": "empty.csv"}, "exchanged"),
        (["--effects", "coulom"], {}, "unknown effect 'coulom'"),
    ],
)
def test_bad_input_is_one_line(files, tmp_path, refusal, words, files_and_mass, message):
    out = tmp_path / "g.json"
    given = {"unloaded": "empty.csv", "loaded": "loaded.csv", "mass": MASS} | files_and_mass
    recordings = [files / given[name] for name in ("unloaded", "loaded")]
    command = ["gains", "panda", "--unloaded", recordings[0], "--loaded", recordings[1]]
    assert refusal([*command, "--mass", given["mass"], *words, "--json", out], message) == ""
    assert not out.exists()
