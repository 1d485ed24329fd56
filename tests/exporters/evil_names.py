"""Names of robots and joints that are markup, and a fit with them."""

import dataclasses

from exporters.c_arms import made_fit

import lieid_casadi as lieid

NAMES = [
    "a--b",
    "a---><evil/>",
    "--",
    "-",
    "ends with -",
    "<![CDATA[ & ]]>",
    "\x07bell \x1b[2J \u202eturned",
    "new\nline",
    "<script>alert(1)</script>",
    "| `code` | ![x](y) | $z$",
]


def named(name):
    robot = lieid.robots.two_link()
    joints = tuple(
        dataclasses.replace(joint, name=f"{name}{k}") for k, joint in enumerate(robot.joints)
    )
    return made_fit(dataclasses.replace(robot, name=name, joints=joints), "coulomb,armature")
