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
