"""Premise: the arm is mounted as the model says, so that gravity has the stated direction."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.premises.correction import Correction, base_rpy
from lieid_casadi.premises.screen import Alternative, Screen

#: Angles of a coarse search on the sphere, rad.
STEP = np.pi / 4.0
#: Steps of the refinement, rad: halved until the last.
FIRST, LAST = np.radians(15.0), np.radians(0.2)
#: Least angle that is reported, and that up to which it is what the effect `base_tilt` describes
#: (a doubt at most), degrees.
LEAST_TURN, SMALL_TURN = 3.0, 10.0


def alternatives(screen: Screen) -> Iterator[Alternative]:
    """Yield the direction of gravity that suits the recording best."""
    size = float(np.linalg.norm(screen.gravity))
    none = Correction.none(screen.n)

    def scored(directions: list[Array]) -> list[tuple[float, Array]]:
        scores = screen.scores([replace(none, gravity=size * d) for d in directions])
        return list(zip(scores.tolist(), directions, strict=True))

    grid = [d for d in _directions() if np.linalg.norm(size * d - screen.gravity) > 0.1 * size]
    start = screen.gravity / size
    low, best = min([(0.0, start), *scored(grid)], key=lambda found: found[0])
    step = FIRST
    while step > LAST:
        around = np.linalg.svd(best[None])[2][1:]
        tried = [best + step * s * axis for axis in around for s in (-1.0, 1.0)]
        tried = [d / np.linalg.norm(d) for d in tried]
        found = min(scored(tried), key=lambda pair: pair[0])
        if found[0] < low:
            low, best = found
        else:
            step /= 2.5
            if best is start and step < np.radians(LEAST_TURN):
                return
    best = _snapped(best)
    gravity = size * best
    rpy = base_rpy(gravity)
    turn = np.degrees(np.arccos(np.clip(best @ start, -1.0, 1.0)))
    if turn < LEAST_TURN:
        return
    what = "The arm is mounted {} in this recording: with the base turned by {{}}"
    yield Alternative(
        "gravity_direction",
        (),
        {
            "gravity": [round(x, 4) for x in gravity.tolist()],
            "base_rpy": [round(x, 4) for x in rpy],
        },
        what.format(_words(rpy, float(turn))),
        replace(none, gravity=gravity),
        cost=0.5,
        small=bool(turn < SMALL_TURN),
        again=what.format("otherwise than stated"),
    )


def _directions() -> list[Array]:
    """Return the 26 directions to the neighbours in a cubic grid."""
    cells = np.array(np.meshgrid(*3 * [[-1, 0, 1]])).reshape(3, -1).T
    return [c / np.linalg.norm(c) for c in cells[np.any(cells != 0, axis=1)].astype(float)]


def _snapped(best: Array) -> Array:
    """Return an axis of the base frame where the direction is within 1.5° of it."""
    k = int(np.argmax(np.abs(best)))
    axis = np.zeros(3)
    axis[k] = np.sign(best[k])
    return axis if best @ axis > np.cos(np.radians(1.5)) else best


def _words(rpy: tuple[float, float, float], turn: float) -> str:
    if turn > 150.0:
        return "upside down"
    return "sideways" if turn > 60.0 else f"at an angle of {turn:.0f}°"


def not_checkable(screen: Screen) -> str | None:
    """Return why the mounting is not identifiable from this recording, or None."""
    if np.abs(np.tensordot(screen.gravity, screen.rigid[1:], axes=1)).max() < 1e-6:
        return "no joint of this arm carries gravity as it is mounted"
    return None
