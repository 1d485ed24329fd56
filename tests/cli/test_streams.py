"""Standard streams that are closed, or cannot hold every character."""

import os
import subprocess
import sys

import pytest

COMMAND = (sys.executable, "-m", "lieid_casadi.cli.main")


@pytest.mark.parametrize(
    ("closed", "words", "status"),
    [
        (">&-", "show two_link", 0),
        ("2>&-", "show none.urdf", 2),
        ("<&- >&- 2>&-", "show two_link --json out.json", 0),
    ],
)
def test_closed_streams(tmp_path, closed, words, status):
    line = f"{' '.join(COMMAND)} {words} {closed}"
    assert subprocess.run(line, shell=True, cwd=tmp_path, check=False).returncode == status
    if "out.json" in words:  # nothing else was written into it
        assert (tmp_path / "out.json").read_text().startswith("{")


@pytest.mark.parametrize(
    "environment",
    [
        {"LC_ALL": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
        {"PYTHONIOENCODING": "ascii"},
    ],
)
def test_streams_without_utf8(environment):
    done = subprocess.run(
        [*COMMAND, "show", "two_link"],
        env=os.environ | environment,
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert b"shoulder" in done.stdout
