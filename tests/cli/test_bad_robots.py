"""Robots with faults: status 2 and one line that names the location."""

import json

import pytest
from cli.two_link_files import refused, urdf


def test_missing_robot(run, good):
    refused(run("identify", "no.urdf", good), "no.urdf", "no such file")
    refused(run("identify", "armadillo", good), "armadillo", "two_link")


@pytest.mark.parametrize("kind", ["floating", "planar", "ball"])
def test_joint_types(run, tmp_path, good, kind):
    path = tmp_path / "arm.urdf"
    path.write_text(urdf(kind=kind))
    refused(run("identify", path, good), "arm.urdf", "shoulder", kind)


def test_urdf_with_a_loop(run, tmp_path, good):
    path = tmp_path / "arm.urdf"
    closing = (
        '<joint name="bar" type="revolute"><parent link="base"/><child link="fore"/>'
        '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    )
    path.write_text(urdf(more=closing))
    refused(run("identify", path, good), "arm.urdf", "loop", "fore")


def test_not_xml(run, tmp_path, good):
    path = tmp_path / "arm.urdf"
    path.write_text("robot: arm")
    refused(run("identify", path, good), "arm.urdf", "not XML")


def test_a_urdf_without_inertias_identifies_all_the_same(run, tmp_path, good):
    path = tmp_path / "arm.urdf"
    path.write_text(urdf(inertial=""))
    status, _, err = run("identify", path, good, "--json", tmp_path / "a.json")
    assert status == 0, err
    assert json.loads((tmp_path / "a.json").read_text())["base_parameter_count"] == 12


@pytest.mark.parametrize(
    ("screw", "words"),
    [("[0, 2, 0, 0, 0, 0]", ["|ω| = 2", "expected 1"]), ("[0, 1, 0, 0, 1, 0]", ["screw"])],
)
def test_screws(run, tmp_path, good, screw, words):
    path = tmp_path / "arm.yaml"
    path.write_text(f"name: arm\njoints:\n  - {{name: a, screw: {screw}}}\n")
    refused(run("identify", path, good), "arm.yaml", "joints[0]", *words)


def test_a_xacro_file_is_to_be_expanded_first(run, tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(
        '<robot xmlns:xacro="http://ros.org/xacro"><xacro:include filename="a"/></robot>'
    )
    refused(run("show", path), "arm.urdf", "no links", "xacro")
