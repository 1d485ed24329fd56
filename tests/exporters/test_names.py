"""Names of robots, joints and recordings stay text in everything that is exported."""

import dataclasses

import numpy as np
from exporters.c_arms import made_fit

import lieid_casadi as lieid
from lieid_casadi.exporters.export import export

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


def test_names_are_no_markup_in_the_readme(tmp_path):
    fit = named("<img src=x onerror=alert(1)> | `a` [b](javascript:c) # d")
    sources = tuple(
        dataclasses.replace(s, name="<b>|</b>\u202e") for s in fit.provenance.recordings
    )
    fit = dataclasses.replace(
        fit, provenance=dataclasses.replace(fit.provenance, recordings=sources)
    )
    assert np.isfinite(fit.values).all()
    export(fit, tmp_path / "arm", to="c")
    text = (tmp_path / "arm" / "README.md").read_text()
    assert "<img" not in text
    assert "<b>" not in text
    assert "\u202e" not in text
    assert "[b](" not in text
    title, row = text.splitlines()[0], next(x for x in text.splitlines() if "&lt;b&gt;" in x)
    assert title.startswith("# &lt;img")
    assert row.replace("\\|", "").count("|") == 3
