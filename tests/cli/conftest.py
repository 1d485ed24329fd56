"""Commands run in this process, and files that several tests read."""

import pytest
from cli.two_link_files import columns, write

from lieid_casadi.cli.main import main


@pytest.fixture(scope="session")
def good(tmp_path_factory):
    return write(tmp_path_factory.mktemp("good") / "run.csv", columns())


@pytest.fixture
def run(capsys):
    def call(*arguments):
        try:
            status = main([str(a) for a in arguments])
        except SystemExit as stop:
            status = stop.code
        output = capsys.readouterr()
        return status, output.out, output.err

    return call


@pytest.fixture(scope="session")
def kept(tmp_path_factory):
    """A recording and a fit that tests copy."""
    folder = tmp_path_factory.mktemp("kept")
    write(folder / "run.csv", columns(seconds=4.0))
    assert main(["identify", "two_link", str(folder / "run.csv"), "-o", f"{folder}/fit.json"]) == 0
    return {name: (folder / name).read_bytes() for name in ("run.csv", "fit.json")}


@pytest.fixture
def work(kept, tmp_path, monkeypatch):
    """The current directory, with a recording and a fit in it."""
    for name, content in kept.items():
        (tmp_path / name).write_bytes(content)
    monkeypatch.chdir(tmp_path)
    return tmp_path
