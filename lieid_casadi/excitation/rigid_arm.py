"""The arm by Pinocchio and coal, which share nothing with the symbolic dynamics of the search."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from lieid_casadi.arrays import Array
from lieid_casadi.excitation.links import Capsule, Shape, arm_length
from lieid_casadi.excitation.trajectory import MotionSamples
from lieid_casadi.robot import Robot
from lieid_casadi.robot.pinocchio_model import build_pinocchio, point_on_axis

CHANGE = (1e-3, 1e-3, 1e-2)  # of q, dq, ddq (SI), below which samples of a motion are the same


class RigidArm:
    """The rigid arm by Pinocchio, with joint coordinates as the robot's.

    ``offsets`` (n + 1, 3) are the origins of the link frames, the base first, in Pinocchio's joint
    frames: the latter are on the joints' axes.
    """

    def __init__(self, robot: Robot) -> None:
        links = [np.zeros(10) if joint.link is None else joint.link for joint in robot.joints]
        self.robot, self.model = robot, build_pinocchio(robot, np.concatenate(links))
        self.offsets = np.array([np.zeros(3), *(-point_on_axis(j.axis) for j in robot.joints)])
        self.data = self.model.createData()

    def frames(self, pose: Array) -> Array:
        """Return the link frames (n + 1, 4, 4), the base first, in a pose (n,)."""
        pin.forwardKinematics(self.model, self.data, pose)
        frames = np.array([place.homogeneous for place in self.data.oMi])
        frames[:, :3, 3] += np.einsum("iab,ib->ia", frames[:, :3, :3], self.offsets)
        return frames

    def jacobians(self, q: Array) -> Array:
        """Return the Jacobians (N, 6, n) of the tool in poses: linear, then angular velocity."""
        place = self.offsets[-1] + np.asarray(self.robot.tool[:3, 3], dtype=float)
        found = np.empty((len(q), 6, self.robot.n))
        for k, pose in enumerate(q):
            own = pin.computeJointJacobian(self.model, self.data, pose, self.robot.n)
            found[k] = own.reshape(6, -1)
        found[:, :3] += np.cross(found[:, 3:], place, axisa=1, axisc=1)
        return found


def nearness_to_singular(robot: Robot, poses: Array) -> Array:
    """Return σ_min of the tool's Jacobian in poses (N, n), in parts of its typical value.

    The Jacobian is that of the tool's position for up to three joints, otherwise that of its
    position and orientation, with lengths in units of the arm's; the typical value is the median
    over random poses. σ_min is the smallest singular value that is not zero in every pose.
    """
    arm = RigidArm(robot)
    rows = 3 if robot.n <= 3 else 6
    unit = np.array([1.0 / (arm_length(robot) or 1.0)] * 3 + [1.0] * 3)[:rows, None]
    random = np.random.default_rng(0).uniform(-np.pi, np.pi, (200, robot.n))
    sizes = np.linalg.svd(unit * arm.jacobians(random)[:, :rows], compute_uv=False)
    typical = np.median(sizes, axis=0)
    rank = int(np.sum(typical > 1e-6 * typical[0]))
    own = np.linalg.svd(unit * arm.jacobians(poses)[:, :rows], compute_uv=False)
    return np.asarray(own[:, rank - 1] / max(typical[rank - 1], 1e-300))


class ArmAlong:
    """The arm along a motion: torques, speeds, and how near its shapes come to others.

    After a distance the arm must move by the part of it beyond what is required before it can be
    too near: the samples in between are not evaluated.
    """

    def __init__(self, robot: Robot, motion: MotionSamples) -> None:
        self.robot, self.motion, self._arm = robot, _distinct(motion), RigidArm(robot)
        self._frames: dict[int, Array] = {}
        length = (arm_length(robot) or 1.0) + float(np.linalg.norm(self._arm.offsets, axis=1).sum())
        slides = ~np.array([joint.revolute for joint in robot.joints])
        # no point of the arm is farther from the axis of a joint
        self._reach = length + float(np.abs(motion.q[:, slides]).max(axis=0).sum())
        self._slides = slides

    def torque(self) -> Array:
        """Return the rigid torque (N, n) of the stated inertias, N·m."""
        m, arm = self.motion, self._arm
        signals = zip(m.q, m.dq, m.ddq, strict=True)
        return np.array([pin.rnea(arm.model, arm.data, *x).copy() for x in signals])

    def speeds(self, points: Sequence[tuple[int, Array]], limit: float) -> Array:
        """Return the speeds (N, k) of points (3,) of links, m/s; bounds of those below a half."""
        arm, farthest = self._arm, max(float(np.linalg.norm(point)) for _, point in points)
        bound = np.abs(self.motion.dq) @ self._levers(farthest)
        found = np.repeat(bound[:, None], len(points), axis=1)
        links = [link for link, _ in points]
        places = np.array([point for _, point in points]) + arm.offsets[links]
        fast = np.flatnonzero(bound > 0.5 * limit)
        twists = np.empty((len(fast), len(points), 6))
        for row, k in zip(twists, fast, strict=True):
            pin.forwardKinematics(arm.model, arm.data, self.motion.q[k], self.motion.dq[k])
            row[:] = [arm.data.v[link].vector for link in links]
        velocities = twists[:, :, :3] + np.cross(twists[:, :, 3:], places)
        found[fast] = np.linalg.norm(velocities, axis=2)
        return found

    def beyond_plane(
        self, body: Shape, normal: Array, offset: float, rounding: float
    ) -> tuple[float, float]:
        """Return by how much a shape is beyond normal·x = offset at most, m, and when, s."""

        def slack(k: int) -> float:
            frame = self._at(k)[body.link]
            highest = float((body.points @ (normal @ frame[:3, :3])).max())
            return offset - highest - float(normal @ frame[:3, 3]) - body.radius

        return self._least(slack, [body], rounding)

    def nearest(
        self, one: Sequence[Shape], other: Sequence[Shape], clearance: float, rounding: float
    ) -> tuple[float, float]:
        """Return by how much shapes of two links come nearer than a clearance, m, and when, s."""
        worst = -np.inf, 0.0
        for a, b in product(one, other):
            distance = _Distance(a, b)

            def slack(k: int, a: Shape = a, b: Shape = b, distance: _Distance = distance) -> float:
                one, other = (_placed(self._at(k)[body.link], body) for body in (a, b))
                return distance.at(one, other, clearance) - clearance

            worst = max(worst, self._least(slack, [a, b], rounding))
        return worst

    def _least(self, slack: Any, bodies: Sequence[Shape], rounding: float) -> tuple[float, float]:
        """Return the largest −slack(k) over the samples, and when; the first violation ends it."""
        farthest = max(float(np.linalg.norm(b.points, axis=1).max()) + b.radius for b in bodies)
        dq, t = np.abs(self.motion.dq), self.motion.t
        steps = np.diff(t) * (np.maximum(dq[1:], dq[:-1]) @ self._levers(farthest))
        travel = np.append(0.0, np.cumsum(steps))
        worst, when, k = -np.inf, 0.0, 0
        while k < len(t):
            here = slack(k)
            if -here > worst:
                worst, when = -here, float(t[k])
            if here < -rounding:
                break
            k = max(k + 1, int(np.searchsorted(travel, travel[k] + max(here, 0.0))))
        return worst, when

    def _levers(self, farthest: float) -> Array:
        """Return the largest speed (n,) per speed of each joint, of points so far from a frame."""
        return np.where(self._slides, 1.0, self._reach + farthest)

    def _at(self, k: int) -> Array:
        if k not in self._frames:
            self._frames[k] = self._arm.frames(self.motion.q[k])
        return self._frames[k]


def _distinct(motion: MotionSamples) -> MotionSamples:
    """Return the samples at which the state has changed noticeably since those before."""
    signals = zip((motion.q, motion.dq, motion.ddq), CHANGE, strict=True)
    changes = [np.abs(np.diff(x, axis=0)).max(axis=1) / size for x, size in signals]
    passed = np.append(0.0, np.cumsum(np.max(changes, axis=0, initial=0.0)))
    _, first = np.unique(np.floor(passed), return_index=True)
    return motion.at(np.unique(np.append(first, len(motion) - 1)))


def capsule_shape(capsule: Capsule) -> Shape:
    """Return a capsule as a shape."""
    along, middle = capsule.end - capsule.start, 0.5 * (capsule.start + capsule.end)
    length, rotation = float(np.linalg.norm(along)), np.eye(3)
    if length > 1e-12:
        z = along / length
        x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
        x = x / np.linalg.norm(x)
        rotation = np.column_stack([x, np.cross(z, x), z])
    ends = np.array([capsule.start, capsule.end])
    geometry = coal.Capsule(capsule.radius, length)
    return Shape(capsule.link, geometry, rotation, middle, ends, capsule.radius)


def box_shape(lower: Array, upper: Array) -> Shape:
    """Return a box along the axes of the base."""
    middle = 0.5 * (lower + upper)
    return Shape(0, coal.Box(*(upper - lower)), np.eye(3), middle, middle[None], 0.0)


def _placed(frame: Array, body: Shape) -> Any:
    rotation = frame[:3, :3]
    return coal.Transform3s(rotation @ body.rotation, rotation @ body.origin + frame[:3, 3])


class _Distance:
    """Distance of two shapes by coal: of their hulls, or exactly where those are too near."""

    def __init__(self, a: Shape, b: Shape) -> None:
        self._exact, self._hulls = (a.geometry, b.geometry), (_hull(a), _hull(b))
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()

    def at(self, a: Any, b: Any, enough: float) -> float:
        """Return the distance with the shapes at two places, or a smaller one above ``enough``."""
        found = self._between(self._hulls, a, b)
        if found < enough and self._hulls != self._exact:
            found = self._between(self._exact, a, b)
        return found

    def _between(self, shapes: tuple[Any, Any], a: Any, b: Any) -> float:
        self._result.clear()
        return float(coal.distance(shapes[0], a, shapes[1], b, self._request, self._result))


def _hull(shape: Shape) -> Any:
    """Return the convex hull of a mesh; other shapes are convex."""
    if not hasattr(shape.geometry, "vertices"):
        return shape.geometry
    try:
        shape.geometry.buildConvexRepresentation(False)
    except RuntimeError:  # flat meshes have none
        return shape.geometry
    return shape.geometry.convex
