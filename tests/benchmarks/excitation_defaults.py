"""What the default limits of ``excite`` cost in condition number, checked by Pinocchio.

python tests/benchmarks/excitation_defaults.py [panda] [ur10e] [tx40] [ceiling]

Per arm, criterion ``condition``, three starts: the default limits, and joint and torque limits
alone (``--unchecked-workspace --margin 1 --acceleration 5``). Heights, speeds and torques are those
of Pinocchio at 1 kHz.
"""

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin

import lieid_casadi as lieid
from lieid_casadi.excitation import SelfCollision, Torque, capsules_of, default_limits
from lieid_casadi.robot.pinocchio_model import build_pinocchio

RECORDINGS = Path(__file__).parents[3] / "shared" / "recordings"
EFFECTS = ["coulomb", "viscous", "offset"]


def ceiling():
    """The Panda upside down on a ceiling."""
    return replace(lieid.robots.panda(), gravity=np.array([0.0, 0.0, 9.81]))


ARMS = {
    "panda": lieid.robots.panda,
    "ur10e": lambda: lieid.Robot.from_urdf(RECORDINGS / "ur10e" / "ur10e.urdf"),
    "tx40": lambda: lieid.Robot.from_urdf(RECORDINGS / "staubli_tx40" / "tx40.urdf"),
    "ceiling": ceiling,
}


def measured(robot, found):
    """Return height, speed, part of the torque limits and distance of capsules, by Pinocchio."""
    model = build_pinocchio(robot)
    data, tool = model.createData(), model.getFrameId("tool")
    motion = found.motion(1000.0)
    capsules = capsules_of(robot)
    checked = " ".join(SelfCollision(capsules=capsules).on(robot).labels)
    lowest, fastest, torque, nearest = np.inf, 0.0, 0.0, np.inf
    for k, (q, dq, ddq) in enumerate(zip(motion.q, motion.dq, motion.ddq, strict=True)):
        load = pin.rnea(model, data, q, dq, ddq)
        torque = max(torque, float(np.nanmax(np.abs(load) / robot.limit("torque"))))
        pin.forwardKinematics(model, data, q, dq)
        pin.updateFramePlacements(model, data)
        velocity = pin.getFrameVelocity(model, data, tool, pin.LOCAL_WORLD_ALIGNED)
        fastest = max(fastest, float(np.linalg.norm(velocity.linear)))
        if k % 10 == 0:
            placed = [
                (c.link, data.oMi[c.link].act(c.start), data.oMi[c.link].act(c.end), c.radius)
                for c in capsules
            ]
            lowest = min(lowest, *(min(a[2], b[2]) - r for link, a, b, r in placed if link >= 2))
            nearest = min(
                nearest,
                *(
                    gap(x, y)
                    for x in placed
                    for y in placed
                    if y[0] > x[0] + 1 and f"{name(x[0])} from {name(y[0])}" in checked
                ),
            )
    return lowest, fastest, torque, nearest


def name(link):
    return "the base" if link == 0 else f"link {link}"


def gap(x, y, steps=30):
    """Return the distance of two capsules, by points along both axes."""
    s = np.linspace(0.0, 1.0, steps)[:, None]
    one, two = x[1] + s * (x[2] - x[1]), y[1] + s * (y[2] - y[1])
    return np.linalg.norm(one[:, None] - two[None], axis=2).min() - x[3] - y[3]


def report(arm, starts=3):
    robot = ARMS[arm]()
    model = lieid.Model(robot, EFFECTS)
    floor = None if arm == "ceiling" else 0.0
    cases = {
        "defaults": {"limits": default_limits(robot, floor_height=floor)},
        "joint and torque limits": {
            "limits": [Torque()], "margin": 1.0, "acceleration": 5.0,
        },
    }  # fmt: skip
    for label, options in cases.items():
        began = time.process_time()
        found = lieid.excite(model, criterion="condition", starts=starts, **options)
        seconds = time.process_time() - began
        lowest, fastest, torque, nearest = measured(robot, found)
        median = np.median([s.condition_number for s in found.starts])
        sys.stdout.write(
            f"{arm:8} {label:24} cond {found.condition_number:6.1f}, median of starts "
            f"{median:6.1f}, {seconds:4.1f} s of a processor; lowest point of links 2 to n "
            f"{lowest:6.3f} m, tool {fastest:4.2f} m/s, rigid torque {torque:4.2f} of its limit, "
            f"nearest links {nearest:6.3f} m\n"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    for arm in sys.argv[1:] or ARMS:
        report(arm)
