"""Output files: whole or unchanged, never over an input; closed streams and other encodings."""

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest
from cli.two_link_files import refused, tree

from lieid_casadi.atomic_file import atomic_binary
from lieid_casadi.errors import OutputError


def save(path, content=b"new"):
    with atomic_binary(path) as file:
        file.write(content)


def test_a_regular_file_is_replaced_and_keeps_its_mode(tmp_path):
    path = tmp_path / "a.json"
    path.write_bytes(b"old")
    path.chmod(0o640)
    before = path.stat().st_ino
    save(path)
    assert path.read_bytes() == b"new"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert path.stat().st_ino != before
    assert os.listdir(tmp_path) == ["a.json"]


def test_a_full_device_is_status_2(work, run):
    refused(run("identify", "two_link", "run.csv", "-o", "/dev/full"), "/dev/full", "No space left")


@pytest.mark.parametrize("target", ["/dev/stdout", "same"])
def test_standard_output_is_written_through(work, target):
    """Also if the shell has redirected it to the file that is named; without any message."""
    with open("all.csv", "wb") as shown:
        target = "all.csv" if target == "same" else target
        command = [sys.executable, "-m", "lieid_casadi.cli.main", "predict", "fit.json", "run.csv"]
        subprocess.run([*command, "-o", target], stdout=shown, check=True)
    lines = Path("all.csv").read_text().splitlines()
    assert lines[0] == "t,tau1,tau2"
    assert len(lines) == 401


def test_a_place_that_cannot_be_written_is_named(work, run):
    for place, words in (("run.csv/fit.json", "not a folder"), ("", "path of an output is empty")):
        refused(run("identify", "two_link", "run.csv", "-o", place), words)


@pytest.mark.parametrize("fault", ["write", "fsync", "replace"])
def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch, fault):
    path = tmp_path / "a.json"
    path.write_bytes(b"old")

    def full(*arguments):
        raise OSError(28, "No space left on device")

    def half():
        with atomic_binary(path) as file:
            file.write(b"new")
            if fault == "write":
                full()

    with monkeypatch.context() as patch:
        if fault != "write":
            patch.setattr(os, fault, full)
        with pytest.raises(OutputError, match=r"a\.json: cannot be written: No space left"):
            half()
    assert tree(tmp_path) == {"a.json": b"old"}
    save(path)
    assert tree(tmp_path) == {"a.json": b"new"}


@pytest.mark.parametrize("output", ["fit.json", "closed/a.json", "closed"])
def test_a_missing_permission_is_status_2(work, run, monkeypatch, output):
    allowed, closed = os.access, {str(work / "closed"), "fit.json"}
    Path("closed").mkdir()

    def access(path, mode):  # root may write everywhere
        return allowed(path, mode) and not (mode & os.W_OK and str(path) in closed)

    monkeypatch.setattr(os, "access", access)
    before = tree(work)
    if output == "closed":
        outcome = run("export", "fit.json", "--to", "c", "-o", output)
    else:
        outcome = run("identify", "two_link", "run.csv", "-o", output)
    refused(outcome, output, "permission")
    assert tree(work) == before


def test_a_closed_reader_of_stdout_is_no_error():
    lieid = f"{sys.executable} -m lieid_casadi.cli.main show two_link"
    command = f"{lieid} | head -1; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert done.stderr == ""
    full = subprocess.run(
        ["bash", "-c", f"{lieid} > /dev/full"], capture_output=True, text=True, check=False
    )
    assert full.returncode == 2
    assert full.stderr.count("\n") == 1


@pytest.mark.parametrize(
    "words",
    [
        ["predict", "fit.json", "run.csv", "-o", "run.csv"],
        ["predict", "fit.json", "run.csv@0:2", "-o", "run.csv"],
        ["predict", "fit.json", "run.csv", "-o", "linked.csv"],
        ["predict", "fit.json", "run.csv", "-o", "../{here}/run.csv"],
        ["identify", "two_link", "run.csv", "--json", "hard.csv"],
        ["identify", "two_link", "run.csv", "--test", "hard.csv", "-o", "hard.csv"],
        ["compare", "fit.json", "run.csv", "--html", "run.csv"],
        ["extend", "fit.json", "--add", "stribeck", "--train", "run.csv", "-o", "fit.json"],
    ],
    ids=" ".join,
)
def test_an_output_that_is_an_input_is_refused(work, run, words):
    os.symlink("run.csv", "linked.csv")
    os.link("run.csv", "hard.csv")
    before = tree(work)
    message = run(*(word.format(here=work.name) for word in words))
    refused(message)
    assert "is also an input" in message[2]
    assert tree(work) == before


def test_outputs_that_cannot_be_written_together_write_nothing(work, run):
    words = ["identify", "two_link", "run.csv", "-o", "a.json", "--json"]
    refused(run(*words, "./a.json"), "a.json", "two options")
    refused(run(*words, "/dev/full"))
    assert not Path("a.json").exists()


COMMAND = (sys.executable, "-m", "lieid_casadi.cli.main")


@pytest.mark.parametrize(
    ("closed", "words", "status"),
    [
        ("2>&-", "show none.urdf", 2),
        ("<&- >&- 2>&-", "show two_link --json out.json", 0),
    ],
)
def test_closed_streams(tmp_path, closed, words, status):
    line = f"{' '.join(COMMAND)} {words} {closed}"
    assert subprocess.run(line, shell=True, cwd=tmp_path, check=False).returncode == status
    if "out.json" in words:  # nothing else was written into it
        assert (tmp_path / "out.json").read_text().startswith("{")


def test_streams_without_utf8():
    posix = {"LC_ALL": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = subprocess.run(
        [*COMMAND, "show", "two_link"], env=os.environ | posix, capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert b"shoulder" in done.stdout
