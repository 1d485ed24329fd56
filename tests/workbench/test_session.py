"""The state of the page: transitions, what is saved, and the commands that reproduce it."""

import os
import shlex
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lieid_casadi.cli.main import build_parser
from lieid_casadi.workbench.open_panel import first_values
from lieid_casadi.workbench.page import shell_lines
from lieid_casadi.workbench.session import (
    ExcludedRange,
    RecordingInput,
    Session,
    SessionFileError,
    StepErrors,
    WorkbenchInputs,
    kept_parts,
    load_session,
    page_token,
    remove_old_sessions,
    save_session,
    upload_file,
)

INPUTS = WorkbenchInputs(
    robot="two_link",
    recordings=(RecordingInput("a b.csv", "train"), RecordingInput("c.csv@:9", "test")),
)
FIRST = Session().opened(INPUTS, ["coulomb:1", "coulomb:2"])
NAME = "0123456789abcdef"


def test_a_step_back_and_forward_restores_the_model():
    added = FIRST.with_added("stribeck:2")
    assert added.step.effects == ("coulomb:1", "coulomb:2", "stribeck:2")
    assert added.can_undo
    assert not added.can_redo
    assert added.at(0).step == FIRST.step
    assert added.at(0).at(1) == added
    assert added.with_added("stribeck:2") is added
    several = FIRST.with_added("coulomb:1", "stribeck:1", "stribeck:2")
    assert several.step.effects == (*FIRST.step.effects, "stribeck:1", "stribeck:2")
    assert several.step.title == "+ stribeck:1+2"


def test_a_new_step_replaces_those_that_were_undone():
    other = FIRST.with_added("stribeck:2").at(0).without_effect("coulomb:1")
    assert [step.title for step in other.history] == ["first model", "− coulomb:1"]


def test_errors_belong_to_every_step_with_the_same_fit():
    back = FIRST.with_added("stribeck:2").without_effect("stribeck:2")
    errors = StepErrors((0.1, 0.2), (0.3, None), (0.1, 0.1))
    both = back.with_errors(FIRST.step, errors)
    assert [step.errors for step in both.history] == [errors, None, errors]
    assert both.at_worst_joint().joint == 0


@given(
    st.lists(
        st.tuples(st.floats(0.0, 10.0), st.floats(0.0, 10.0))
        .map(sorted)
        .filter(lambda r: r[0] < r[1]),
        max_size=5,
    ),
    st.floats(0.001, 9.999),
)
def test_kept_parts_are_what_is_not_excluded(ranges, t):
    parts = kept_parts([ExcludedRange(0, *r) for r in ranges], 0)
    inside = any((a is None or a <= t) and (b is None or t < b) for a, b in parts)
    assert inside == (not any(a <= t < b for a, b in ranges))


def test_commands_parse_and_leave_out_what_is_excluded():
    inputs = replace(INPUTS, options=(("columns", ("t=stamp,q=pos_*",)),))
    session = Session().opened(inputs, ["coulomb:1", "coulomb:2"])
    session = session.with_added("stribeck:2").excluding(3.0, 4.5)
    lines = shell_lines(session).splitlines()
    for line in lines:
        assert build_parser().parse_args(shlex.split(line)[1:]).columns == "t=stamp,q=pos_*"
    first = shlex.split(lines[0])
    assert first[:4] == ["lieid", "identify", "two_link", "a b.csv"]
    assert first[first.index("--test") + 1 :][:2] == ["c.csv@:3", "c.csv@4.5:9"]
    assert first[first.index("--effects") + 1] == "coulomb,stribeck:2"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("LIEID_WORKBENCH_DIR", str(tmp_path))
    return tmp_path


def test_a_saved_session_is_read_back(folder):
    errors = StepErrors((0.1, None), (0.3, None), (0.1, 0.1))
    session = FIRST.with_added("stribeck:2").with_errors(FIRST.step, errors).excluding(1.0, 2.0)
    save_session(NAME, session)
    assert load_session(NAME) == session
    assert load_session("f" * 16) is None
    upload_file(NAME, "run.csv")
    save_session("f" * 16, session)
    os.utime(folder / f"{NAME}.json", (1.0, 1.0))
    remove_old_sessions()
    assert [path.name for path in folder.iterdir()] == [f"{'f' * 16}.json"]


def test_the_token_stays_while_its_file_is_private_and_new(folder):
    file, token = folder / "token", page_token()
    assert page_token() == token
    assert file.stat().st_mode & 0o777 == 0o600
    file.chmod(0o644)
    assert (other := page_token()) != token
    os.utime(file, (1.0, 1.0))
    assert page_token() != other
    file.write_text("")
    assert len(page_token()) == 32


@pytest.mark.parametrize("content", [b"", b"{}", b'{"schema": 1, "session": 3}', b"\xff"])
def test_a_damaged_session_is_one_error(folder, content):
    (folder / f"{NAME}.json").write_bytes(content)
    with pytest.raises(SessionFileError, match="not a saved session"):
        load_session(NAME)


def test_files_of_a_session_are_readable_by_their_owner_alone(folder):
    old = folder / f"{NAME}.json"
    old.write_text("")
    old.chmod(0o644)
    for name in (NAME, "f" * 16):
        save_session(name, FIRST)
        assert (folder / f"{name}.json").stat().st_mode & 0o777 == 0o600
    file = upload_file(NAME, "run.csv")
    assert file.stat().st_mode & 0o777 == 0o600
    assert file.parent.stat().st_mode & 0o777 == 0o700


def test_names_that_leave_the_folder_are_not_read(folder):
    (folder.parent / "secret.json").write_text("{}")
    (folder / f"{NAME}.json").symlink_to(folder / "gone.json")
    assert load_session("../secret") is None
    assert load_session(NAME) is None
    remove_old_sessions()


@pytest.mark.parametrize("name", ["run.csv", "run.csv.gz", "run.npz"])
def test_columns_are_previewed_with_their_first_values(name, tmp_path):
    rows = np.array([[0.0, 1.5, -2.25], [0.01, 1.6, -2.2]])
    path = tmp_path / name
    if name.endswith(".npz"):
        np.savez(path, stamp=rows[:, 0], pos=rows[:, 1:])
        expected = {"stamp": ["0.0"], "pos": ["1.5", "-2.25"]}
    else:
        text = "stamp,pos_1,pos_2"
        np.savetxt(path, rows, "%g", ",", header=f"# by a recorder\n{text}", comments="")
        expected = {"stamp": ["0"], "pos_*": ["1.5", "-2.25"]}
    assert first_values(str(path)) == expected
    assert first_values(str(tmp_path / "other.mcap")) == {}
