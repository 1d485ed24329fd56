"""The default limits on whole arms: heights, speeds, torques and distances by Pinocchio."""

import pytest
from benchmarks.excitation_defaults import ceiling, measured
from real_arms import FOLDER

import lieid_casadi as lieid

URDF = {"ur10e": "ur10e/ur10e.urdf", "tx40": "staubli_tx40/tx40.urdf"}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["panda", "ceiling", "ur10e", "tx40"])
def test_a_design_within_the_default_limits(name):
    if name in URDF and not FOLDER.is_dir():
        pytest.skip(f"no recordings of real arms in {FOLDER.name}/ (set LIEID_RECORDINGS)")
    if name in URDF:
        robot = lieid.Robot.from_urdf(FOLDER / URDF[name])
    else:
        robot = {"panda": lieid.robots.panda, "ceiling": ceiling}[name]()
    floor = None if name == "ceiling" else 0.0
    limits = lieid.default_limits(robot, floor_height=floor)
    model = lieid.Model(robot, ["coulomb", "viscous", "offset"])
    found = lieid.excite(model, starts=1, limits=limits)
    lowest, fastest, torque, nearest = measured(robot, found)
    assert floor is None or lowest >= 0.0
    assert fastest <= 1.5
    assert torque <= 0.8
    assert nearest >= 0.02
    assert ("floor" in found.unchecked) == (floor is None)
