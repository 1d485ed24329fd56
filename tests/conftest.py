import os
from pathlib import Path

import pytest
from real_arms import FOLDER

# On a busy machine a compiler may exceed the default; tests would go on without compiled code.
os.environ.setdefault("LIEID_COMPILER_TIMEOUT", "600")


@pytest.fixture
def recordings() -> Path:
    """Folder of the recordings of real arms; skips where it is not."""
    if not FOLDER.is_dir():
        pytest.skip(f"no recordings of real arms in {FOLDER.name}/ (set LIEID_RECORDINGS)")
    return FOLDER
