"""Robots: joints as screws, home poses, limits and inertias."""

from lieid_casadi.robot.robot import Joint, Limits, Robot, RobotSource

__all__ = ["Joint", "Limits", "Robot", "RobotSource"]
