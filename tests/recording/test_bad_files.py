import re

import pytest

from lieid_casadi.errors import RecordingError
from lieid_casadi.recording import Recording

HEADER = "t,q1,q2,tau1,tau2"
ROWS = ["0,1,2,3,4", "0.1,1,2,3,4", "0.2,1,2,3,4"]


def message(tmp_path, content, name="run.csv", **options):
    file = tmp_path / name
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(RecordingError) as caught:
        Recording.load(file, **options)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(str(file))
    return text.removeprefix(f"{file}: ")


def with_row(index, row):
    rows = list(ROWS)
    rows[index] = row
    return "\n".join([HEADER, *rows]) + "\n"


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (with_row(1, "0.1,1,abc,3,4"), "line 3, column q2: found 'abc', expected a number"),
        (with_row(1, "0.1,1,,3,4"), "line 3, column q2: found an empty cell, expected a number"),
        (with_row(2, "0.2,1,1_0,3,4"), "line 4, column q2: found '1_0', expected a number"),
        (with_row(0, "0,nan,2,3,4"), "line 2, column q1: found nan, expected a finite number"),
        (with_row(2, "0.2,1,2,-inf,4"), "line 4, column tau1: found -inf, expected a finite"),
        (with_row(2, "nan,1,2,3,4"), "line 4, column t: found nan, expected a finite number"),
        (with_row(1, "0.1,1,2,3"), "line 3, column tau2: found 4 columns, expected 5"),
        (with_row(1, "0.1,1,2,3,4,5"), "line 3, column tau2: found 6 columns, expected 5"),
        (
            with_row(2, "0.05,1,2,3,4"),
            "line 4, column t: found 0.05 s after 0.1 s (time goes back)",
        ),
        (with_row(2, "0.1,1,2,3,5"), "line 4, column t: found the time 0.1 s twice"),
        ("", "found an empty file, expected a header"),
        ("\n \n", "found an empty file, expected a header"),
        (HEADER, "found no rows below the header"),
        (HEADER + "\n" + ROWS[0], "found one row below the header, expected at least two"),
        ("\n".join(ROWS), "line 1: found numbers, expected a header"),
        ("<robot name='a'>\n</robot>\n", "line 1: found \"<robot name='a'>\", expected a header"),
        ("t;q1;q2\n0;1;2\n", "line 1: found semicolons between columns, expected commas"),
        ("t\tq1\n0\t1\n", "line 1: found tabs between columns, expected commas"),
        ("t,tau1\n0,1\n1,2\n", "line 1: no column q1"),
        ("when,q1\n0,1\n1,2\n", "line 1: found 'when,q1', expected a header with column t"),
        ("t,q1,q1\n0,1,2\n1,2,3\n", "line 1: column 'q1' occurs twice"),
        ("t,q0,q1\n0,1,2\n1,2,3\n", "line 1: found column 'q0', expected joints from 1"),
        (b"PK\x03\x04\0\0\xff\xfe", "found binary data, expected a CSV"),
    ],
)
def test_bad_csv(tmp_path, content, expected):
    assert message(tmp_path, content).startswith(expected)


@pytest.mark.parametrize("missing", ["q3", "dq1", "tau3", "tau6", "temp2"])
def test_a_missing_column_is_named(tmp_path, missing):
    signals = ["q", "dq", "tau", "temp"]
    names = ["t", *(f"{s}{j}" for s in signals for j in range(1, 7))]
    names.remove(missing)
    rows = [",".join(str(k) for _ in names) for k in range(3)]
    text = message(tmp_path, "\n".join([",".join(names), *rows]))
    assert text.startswith(f"line 1: column {missing} is missing")
    stem = missing.rstrip("0123456789")
    assert text.endswith(f"expected {stem}1…{stem}6")


def test_the_line_counts_blank_lines(tmp_path):
    text = message(tmp_path, "\n" + HEADER + "\n\n" + ROWS[0] + "\n\n0.1,x,2,3,4\n")
    assert text.startswith("line 6, column q1: found 'x'")


def test_a_fault_in_a_file_with_labels(tmp_path):
    text = message(tmp_path, "t,q1,load\n0,1,a\n1,2\n")
    assert text.startswith("line 3, column load: found 2 columns, expected 3")


def test_six_columns_for_a_seven_joint_robot(tmp_path):
    text = message(tmp_path, "t,q1,q2\n0,1,2\n1,2,3\n", n=3)
    assert text == "line 1: found 2 joints (q1…q2), expected 3"


def test_a_truncated_gzip(tmp_path):
    import gzip

    content = gzip.compress(with_row(0, ROWS[0]).encode())
    assert message(tmp_path, content[:-12], name="run.csv.gz").startswith("not a complete gzip")
    assert message(tmp_path, b"t,q1\n", name="run.csv.gz").endswith("or the suffix .csv")


def test_missing_file_and_unknown_suffix(tmp_path):
    for name in ("run.csv", "run.csv@0:3", "run.npz", "run.txt"):
        with pytest.raises(RecordingError, match="no such file"):
            Recording.load(tmp_path / name)
    assert message(tmp_path, "", name="run.txt").startswith("found suffix '.txt', expected .csv")
    (tmp_path / "folder").mkdir()
    with pytest.raises(RecordingError, match=re.escape(str(tmp_path / "folder"))):
        Recording.load(tmp_path / "folder")
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(RecordingError, match="cannot be read"):
        Recording.load(tmp_path / "folder.csv")
