"""Random arms, and any robot as a model of Pinocchio and of MuJoCo.

Both are built from the robot's data (screws, home poses, links) with arithmetic of their own, so
that a mistake in the package's dynamics or inertia code is found.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from lieid_casadi.robot import Joint, Limits, Robot


def random_arm(rng, n, *, mixed=True, off_origin=True):
    """An arm of n joints with arbitrary axes.

    Some axes do not pass through the origin of their link frame (unless ``off_origin`` is false:
    URDF cannot express that). Revolute and prismatic joints (``mixed``, n > 1) or revolute ones
    only; physically possible inertias; gravity of any direction and size; a tool.
    """
    sliding = np.zeros(n, dtype=bool)
    if mixed and n > 1:
        sliding = rng.random(n) < 0.35
        sliding[rng.integers(n)] = True
        sliding[rng.integers(n)] = False
    on_origin = (rng.random(n) < 0.5) | (not off_origin)
    home, joints = np.eye(4), []
    for i in range(n):
        home = home @ random_pose(rng, 0.5)
        joints.append(
            Joint(
                name=f"joint{i + 1}",
                screw=_random_screw(rng, home, sliding[i], on_origin=on_origin[i]),
                home=home,
                limits=Limits(-2.5, 2.5, 2.0, 8.0, 100.0)
                if not sliding[i]
                else Limits(-0.4, 0.4, 0.5, 2.0, 300.0),
                link=random_link(rng),
                link_name=f"link{i + 1}",
            )
        )
    return Robot(
        name=f"random_{n}",
        joints=tuple(joints),
        gravity=5.0 * rng.normal(size=3),
        tool=random_pose(rng, 0.3),
    )


def random_pose(rng, size):
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    pose[:3, 3] = rng.uniform(-size, size, 3)
    return pose


def random_link(rng):
    """Ten link parameters of a cloud of point masses, which is physically possible."""
    masses, points = rng.uniform(0.1, 1.0, 8), rng.uniform(-0.3, 0.3, (8, 3))
    inertia = sum(
        m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, points, strict=True)
    )
    i = inertia
    sixth = [i[0, 0], i[0, 1], i[1, 1], i[0, 2], i[1, 2], i[2, 2]]
    return np.array([masses.sum(), *(masses @ points), *sixth])


def random_states(rng, robot, count):
    """q within the limits (else ±π), dq, ddq, (count, n) each."""
    lower = np.nan_to_num(robot.limit("position_lower"), nan=-np.pi)
    upper = np.nan_to_num(robot.limit("position_upper"), nan=np.pi)
    q = rng.uniform(lower, upper, (count, robot.n))
    return q, rng.normal(0.0, 1.5, q.shape), rng.normal(0.0, 3.0, q.shape)


def _random_screw(rng, home, slides, *, on_origin):
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    if slides:
        return np.concatenate([np.zeros(3), direction])
    point = home[:3, 3] + (0.0 if on_origin else rng.uniform(-0.3, 0.3, 3))
    return np.concatenate([direction, -np.cross(direction, point)])


def axis_in_link(joint):
    """Direction (3,) of a joint and a point (3,) on its axis, in its link frame."""
    rotation, origin = joint.home[:3, :3], joint.home[:3, 3]
    omega, v = joint.screw[:3], joint.screw[3:]
    if not omega.any():
        return rotation.T @ v, np.zeros(3)
    foot = np.cross(omega, v)  # the axis's point next to the base's origin
    nearest = foot + omega * (omega @ (origin - foot))
    return rotation.T @ omega, rotation.T @ (nearest - origin)


def mass_com_inertia(link):
    """Mass, centre of mass and central inertia (3, 3) of ten link parameters."""
    mass, com = link[0], link[1:4] / link[0]
    xx, xy, yy, xz, yz, zz = link[4:]
    about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return mass, com, about_origin - mass * (com @ com * np.eye(3) - np.outer(com, com))


def to_pinocchio(robot):
    """The robot as a pinocchio.Model with a frame ``tool``.

    Pinocchio's axes pass through the joint frame's origin. If an axis of the robot does not, the
    joint frame is the link frame shifted to the axis (see `shift_to_axes`).
    """
    import pinocchio as pin

    model = pin.Model()
    model.gravity = pin.Motion(np.array(robot.gravity), np.zeros(3))
    parent, before = 0, pin.SE3.Identity()
    for joint in robot.joints:
        direction, point = axis_in_link(joint)
        shift = pin.SE3(np.eye(3), point)
        here = pin.SE3(joint.home) * shift
        kind = (
            pin.JointModelRevoluteUnaligned(direction)
            if joint.screw[:3].any()
            else pin.JointModelPrismaticUnaligned(direction)
        )
        parent = model.addJoint(parent, kind, before.actInv(here), joint.name)
        if joint.link is not None:
            body = pin.Inertia(*mass_com_inertia(joint.link))
            model.appendBodyToJoint(parent, body, shift.inverse())
        before = here
    tool = shift.actInv(pin.SE3(robot.tool))
    model.addFrame(pin.Frame("tool", parent, tool, pin.FrameType.OP_FRAME))
    return model


def shift_to_axes(robot):
    """Matrix (10 n, 10 n): our link parameters → about the origins of `to_pinocchio`'s frames."""
    blocks = np.zeros((10 * robot.n, 10 * robot.n))
    for i, joint in enumerate(robot.joints):
        p = axis_in_link(joint)[1]
        columns = []
        for m, hx, hy, hz, *inertia in np.eye(10):
            h = np.array([hx, hy, hz])
            more = m * (p @ p * np.eye(3) - np.outer(p, p))
            more = more - 2 * (h @ p) * np.eye(3) + np.outer(h, p) + np.outer(p, h)
            six = [more[0, 0], more[0, 1], more[1, 1], more[0, 2], more[1, 2], more[2, 2]]
            columns.append([m, *(h - m * p), *(np.array(inertia) + six)])
        blocks[10 * i : 10 * i + 10, 10 * i : 10 * i + 10] = np.array(columns).T
    return blocks


def to_mujoco(robot):
    """The robot as a mujoco.MjModel with a site ``tool``; no contacts, limits or damping."""
    import mujoco

    head, tail, before = [], [], np.eye(4)
    for joint in robot.joints:
        direction, point = axis_in_link(joint)
        mass, com, inertia = mass_com_inertia(joint.link)
        # Principal axes are found here: older MuJoCo finds those of a fullinertia to 1e-6 only.
        moments, principal = np.linalg.eigh(inertia)
        axes = np.eye(4)
        axes[:3, :3], axes[:3, 3] = principal * np.linalg.det(principal), com
        kind = "hinge" if joint.screw[:3].any() else "slide"
        head.append(
            f'<body name="{joint.name}" {_placement(np.linalg.solve(before, joint.home))}>'
            f'<joint type="{kind}" axis="{_text(direction)}" pos="{_text(point)}"/>'
            f'<inertial {_placement(axes)} mass="{_text([mass])}" diaginertia="{_text(moments)}"/>'
        )
        tail.append("</body>")
        before = joint.home
    return mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian" autolimits="false"/>'
        f'<option gravity="{_text(robot.gravity)}"/>'
        f"<worldbody>{''.join(head)}"
        f'<site name="tool" {_placement(robot.tool)}/>'
        f"{''.join(tail)}</worldbody></mujoco>"
    )


def _placement(pose):
    quaternion = np.roll(Rotation.from_matrix(pose[:3, :3]).as_quat(), 1)  # w first
    return f'pos="{_text(pose[:3, 3])}" quat="{_text(quaternion)}"'


def _text(values):
    return " ".join(repr(float(value)) for value in values)
