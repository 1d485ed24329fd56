"""Links as capsules: given, fitted to collision geometry, or along the lines between joints."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.robot.robot import Robot

Array = NDArray[np.float64]
SKELETON_RADIUS = 0.06  # of the arm's length, where there is no geometry
SPLIT_VOLUME = 0.7  # of one capsule's volume: several capsules must be smaller in sum


@dataclass(frozen=True, eq=False)
class Capsule:
    """All points within ``radius`` of a segment, fixed to a link.

    Attributes
    ----------
    link : int
        0 for the base, i for the link that joint i (from 1) moves.
    start, end : (3,)
        In the link's frame, m.
    """

    link: int
    start: Array
    end: Array
    radius: float


def skeleton(robot: Robot, *, radius: float | None = None) -> tuple[Capsule, ...]:
    """Return capsules along the lines from joint to joint, for robots without geometry.

    Parameters
    ----------
    radius : float, optional
        m. Default: 6 % of the arm's length.
    """
    homes = [np.eye(4), *(joint.home for joint in robot.joints)]
    homes.append(robot.joints[-1].home @ robot.tool)
    steps = [np.linalg.norm(b[:3, 3] - a[:3, 3]) for a, b in pairwise(homes)]
    size = SKELETON_RADIUS * float(np.sum(steps)) if radius is None else radius
    capsules = []
    for link in range(robot.n + 1):
        end = np.linalg.solve(homes[link], homes[link + 1])[:3, 3]
        if np.linalg.norm(end) > 1e-6:
            capsules.append(Capsule(link, np.zeros(3), end, size))
    return tuple(capsules)


def enclosing_all(
    link: int, points: Array, faces: NDArray[np.int64] | None = None, *, splits: int = 2
) -> list[Capsule]:
    """Return one capsule around points, or several where their volume is smaller.

    A mesh is cut in two across its longest direction; each triangle is inside one capsule.

    Parameters
    ----------
    link : int
    points : (N, 3)
        In the link's frame, m.
    faces : (F, 3), optional
        Triangles of a mesh.
    splits : int
        How often a part may be cut again.
    """
    whole = enclosing(link, points)
    if faces is None or splits == 0 or len(faces) < 8:
        return [whole]
    centred = points - points.mean(axis=0)
    axis = np.linalg.svd(centred, full_matrices=False)[2][0]
    middle = (centred @ axis)[faces].mean(axis=1)
    parts: list[Capsule] = []
    for chosen in (middle <= np.median(middle), middle > np.median(middle)):
        if not chosen.any():
            return [whole]
        used, renumbered = np.unique(faces[chosen], return_inverse=True)
        part = renumbered.reshape(-1, 3)
        parts += enclosing_all(link, points[used], part, splits=splits - 1)
    if sum(_volume(part) for part in parts) < SPLIT_VOLUME * _volume(whole):
        return parts
    return [whole]


def enclosing(link: int, points: Array) -> Capsule:
    """Return a small capsule that contains points (N, 3) of a link.

    The axis is the principal direction of the points with the smallest capsule; its ends are as
    close together as the spherical caps allow. No point is outside, but the capsule need not be
    the smallest one.
    """
    points = np.asarray(points, dtype=float)
    best: Capsule | None = None
    centred = points - points.mean(axis=0)
    _, _, directions = np.linalg.svd(centred, full_matrices=False)
    for axis in directions:
        capsule = _along(link, points, axis)
        if best is None or _volume(capsule) < _volume(best):
            best = capsule
    assert best is not None
    return best


def _along(link: int, points: Array, axis: Array) -> Capsule:
    along = points @ axis
    across = points - np.outer(along, axis)
    centre, radius = _enclosing_circle(across)
    gap = np.linalg.norm(across - centre, axis=1)
    cap = np.sqrt(np.maximum(radius**2 - gap**2, 0.0))
    low, high = float((along + cap).min()), float((along - cap).max())
    if low > high:  # a ball contains all points
        low = high = 0.5 * (low + high)
    ends = centre + low * axis, centre + high * axis
    slack = segment_distance_to_points(points, *ends).max()
    return Capsule(link, *ends, float(max(radius, slack)))


def _enclosing_circle(points: Array) -> tuple[Array, float]:
    """Return centre and radius of a nearly smallest ball (Ritter, then Badoiu-Clarkson steps)."""
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    for k in range(1, 200):
        gaps = np.linalg.norm(points - centre, axis=1)
        centre = centre + (points[np.argmax(gaps)] - centre) / (k + 1)
    return centre, float(np.linalg.norm(points - centre, axis=1).max())


def _volume(capsule: Capsule) -> float:
    length = float(np.linalg.norm(capsule.end - capsule.start))
    return np.pi * capsule.radius**2 * (length + 4.0 / 3.0 * capsule.radius)


def segment_distance_to_points(points: Array, start: Array, end: Array) -> Array:
    """Return the distances (N,) of points from a segment.

    Parameters
    ----------
    points : (N, 3)
        m.
    start, end : (3,)
        Ends of the segment, m.
    """
    direction = end - start
    squared = float(direction @ direction)
    share = np.zeros(len(points))
    if squared > 0.0:
        share = np.clip((points - start) @ direction / squared, 0.0, 1.0)
    return np.asarray(np.linalg.norm(points - start - share[:, None] * direction, axis=1))
