"""Robots: joints as screws, home poses, limits and inertias."""

from lieid_casadi.robot.joint import Joint, Limits, RobotSource
from lieid_casadi.robot.robot import Robot

__all__ = ["Joint", "Limits", "Robot", "RobotSource"]
