"""Where recordings of real arms lie; tests that need them are skipped where they are not."""

import os
from pathlib import Path

import pytest

_STATED = os.environ.get("LIEID_RECORDINGS")
FOLDER = Path(_STATED) if _STATED else Path(__file__).parents[2] / "shared" / "recordings"

UR10E = FOLDER / "ur10e"
TX40 = FOLDER / "staubli_tx40"
PANDA = FOLDER / "franka_panda"


FINGERS = ("panda_finger_joint1", "panda_finger_joint2")


def needs(path: Path) -> pytest.MarkDecorator:
    """Skip a test where this file of a recording is not there."""
    return pytest.mark.skipif(
        not path.exists(),
        reason=f"no {path.relative_to(FOLDER)} in {FOLDER.name}/ (set LIEID_RECORDINGS)",
    )


#: URDF and joints to lock, as parameters of a test.
URDFS = [
    pytest.param(path, lock, id=path.stem, marks=needs(path))
    for path, lock in (
        (UR10E / "ur10e.urdf", ()),
        (TX40 / "tx40.urdf", ()),
        (PANDA / "panda.urdf", FINGERS),
    )
]
