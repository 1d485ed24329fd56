from pathlib import Path

import hypothesis
import pytest
from real_arms import FOLDER

# No test depends on how fast the machine is.
hypothesis.settings.register_profile("any machine", deadline=None, max_examples=40)
hypothesis.settings.load_profile("any machine")


@pytest.fixture
def recordings() -> Path:
    """Folder of the recordings of real arms; skips where it is not."""
    if not FOLDER.is_dir():
        pytest.skip(f"no recordings of real arms in {FOLDER.name}/ (set LIEID_RECORDINGS)")
    return FOLDER


@pytest.fixture
def refusal(capsys):
    """Run a command that ends with status 2 and one line that has a message; return its output."""
    from lieid_casadi.cli.main import main

    def check(words, message: str) -> str:
        try:
            status = main([str(word) for word in words])
        except SystemExit as stop:  # argparse's own
            status = stop.code
        shown = capsys.readouterr()
        assert status == 2
        assert shown.err.count("\n") == 1
        assert message in shown.err
        return shown.out

    return check
