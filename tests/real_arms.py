"""Recordings of real arms; tests that need them are skipped where they are not."""

import os
from functools import cache
from pathlib import Path

import pytest

import lieid_casadi as lieid

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


@cache
def ur10e_run(name: str) -> lieid.Recording:
    """Return a recording of the UR10e."""
    return lieid.Recording.load(UR10E / f"{name}.csv.gz")


@cache
def ur10e_fit(effects: str) -> lieid.Fit:
    """Return a fit of the UR10e to its two training recordings."""
    model = lieid.Model(lieid.Robot.from_urdf(UR10E / "ur10e.urdf"), effects)
    train = [ur10e_run("excitation_30s"), ur10e_run("excitation_50s")]
    return lieid.identify(model, train, processing=lieid.Processing(cutoff=7.0))
