"""The ros2_control plug-in of the examples, built against the stub of the interface."""

import re
from pathlib import Path

import pytest
from exporters.c_arms import made_fit, run

import lieid_casadi as lieid
from lieid_casadi.exporters.export import export

FOLDER = Path(__file__).parents[2] / "examples" / "ros2_control"


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ros2_control")
    effects = "coulomb,viscous,offset,armature,presliding:2"
    export(made_fit(lieid.robots.two_link(), effects), folder / "arm", to="c")
    configure = ["cmake", "-S", str(FOLDER), "-B", "build", f"-DARM_DIR={folder / 'arm'}"]
    assert "no ROS 2: building against the stub" in run(configure, folder)
    run(["cmake", "--build", "build"], folder)
    return folder / "build"


def test_the_plug_in_moves_the_exported_arm(built):
    """Through the life cycle of a controller, with refusals of wrong parameters and of NaN."""
    shown = run([str(built / "move_arm")], built)
    assert float(re.search(r"largest tracking error: (\S+)", shown)[1]) < 1e-3


def test_the_package_names_the_library_and_the_class():
    description = (FOLDER / "identified_arm.xml").read_text()
    assert 'path="identified_arm"' in description
    assert 'type="identified_arm::Controller"' in description
    source = (FOLDER / "src" / "controller.cpp").read_text()
    assert "PLUGINLIB_EXPORT_CLASS(identified_arm::Controller" in source
    depends = re.findall(r"<depend>(\w+)</depend>", (FOLDER / "package.xml").read_text())
    cmake = (FOLDER / "CMakeLists.txt").read_text()
    assert all(f"find_package({name} REQUIRED)" in cmake for name in depends)
