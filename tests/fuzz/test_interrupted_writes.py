"""Killed runs and failing writes: each output is the old or the new one, and the next run works."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from cli.two_link_files import columns, write

import lieid_casadi as lieid
from lieid_casadi.atomic_file import is_temporary
from lieid_casadi.cli.main import main
from lieid_casadi.errors import OutputError
from lieid_casadi.output_folder import MANIFEST, write_folder

LIEID = [sys.executable, "-m", "lieid_casadi.cli.main"]
KILLS = 8
COMMANDS = {
    "identify": "identify two_link run.csv -o out/fit.json --json out/result.json",
    "diagnose": "diagnose two_link --train run.csv@0:4 --test run.csv@4: -o out/fit.json "
    "--html out/report.html",
    "excite": "excite two_link -o out --duration 6 --starts 1 --samples 60 --force",
    "export": "export fit.json --to c -o out --force",
}
LIMITED = {name: COMMANDS[name] for name in ("identify", "export")}


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("inputs")
    write(folder / "run.csv", columns(seconds=8.0, rate=50.0))
    fit = str(folder / "fit.json")
    assert main(["identify", "two_link", str(folder / "run.csv@0:4"), "-o", fit]) == 0
    return {name: (folder / name).read_bytes() for name in ("run.csv", "fit.json")}


@pytest.fixture
def work(inputs, tmp_path, monkeypatch):
    for name, content in inputs.items():
        (tmp_path / name).write_bytes(content)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def outputs():
    """Content of all files in ``out`` but temporary ones."""
    return {
        path.as_posix(): path.read_bytes()
        for path in Path("out").rglob("*")
        if path.is_file() and not any(map(is_temporary, path.parts))
    }


def temporary():
    return [path for path in Path().rglob("*") if is_temporary(path.name)]


def whole(name, content):
    """Whether a new file is complete."""
    if name.endswith("fit.json"):
        Path("copy.json").write_bytes(content)
        return lieid.Fit.load("copy.json").values.size > 0
    if name.endswith(".json"):
        return bool(json.loads(content))
    endings = {".html": b"</html>", ".png": b"IEND\xaeB`\x82", ".md": b"\n", ".h": b"#endif\n"}
    return content.rstrip(b"\n").endswith(endings.get(Path(name).suffix, b"").rstrip(b"\n"))


def test_a_process_killed_before_any_of_its_file_operations(tmp_path):
    program = Path(__file__).with_name("killed_writes.py")
    done = subprocess.run(
        [sys.executable, program, tmp_path], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("killed before each of") == 3


@pytest.mark.parametrize("fault", ["os.fsync", "os.replace", "pathlib.Path.write_bytes"])
@pytest.mark.parametrize("step", [0, 1, 2])
def test_an_operation_that_fails_leaves_old_and_new_files(tmp_path, monkeypatch, fault, step):
    """The disk is full, or a name cannot be changed, at the first, second or third attempt."""
    old, new = {"a": b"old", "b": b"old"}, {"a": b"new", "b": b"new", "c": b"new"}
    write_folder(tmp_path / "out", old)
    module, name = fault.rsplit(".", 1)
    owner = os if module == "os" else Path
    real, calls = getattr(owner, name), 0

    def failing(*arguments):
        nonlocal calls
        calls += 1
        if calls > step:
            raise OSError(28, "No space left on device")
        return real(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(owner, name, failing)
        with pytest.raises(OutputError, match="No space left"):
            write_folder(tmp_path / "out", new, force=True)
    made = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    assert made.pop(MANIFEST)
    assert all(content in (old.get(name), new[name]) for name, content in made.items())
    assert old.keys() <= made.keys()
    if fault != "os.replace":
        assert made == old
    write_folder(tmp_path / "out", new, force=True)
    made = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    assert made.pop(MANIFEST)
    assert made == new


@pytest.mark.parametrize("name", LIMITED)
def test_a_file_size_limit_leaves_the_old_outputs(work, name):
    assert main(COMMANDS[name].split()) == 0
    before = outputs()
    # without writing bytecode, which Python would leave truncated for all that follows
    command = [LIEID[0], "-B", *LIEID[1:]]
    limited = f"ulimit -f 1; exec {' '.join(command)} {COMMANDS[name]}"
    done = subprocess.run(["bash", "-c", limited], capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("\n") == 1
    assert "File too large" in done.stderr
    assert outputs() == before
    assert not temporary()


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_kill_9_at_random_moments(work, name):
    moments = random.Random(name)
    command = [*LIEID, *COMMANDS[name].split()]
    start = time.monotonic()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    duration = time.monotonic() - start
    before, killed = outputs(), 0
    for _ in range(KILLS):
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            # half of them near the end, where files are written
            process.wait(duration * moments.choice([moments.uniform(0, 1), moments.gauss(1, 0.03)]))
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            killed += 1
        process.wait()
        after = outputs()
        assert after.keys() == before.keys()
        for file, content in after.items():
            assert content == before[file] or whole(file, content), file
    assert killed
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    assert outputs().keys() == before.keys()
