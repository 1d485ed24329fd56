"""Robots: joints as screws, home poses, limits and inertias."""

from lieid_casadi.robot.description import Joint, Limits, RobotSource
from lieid_casadi.robot.drive import Drive, servo_drive
from lieid_casadi.robot.robot import Robot

__all__ = ["Drive", "Joint", "Limits", "Robot", "RobotSource", "servo_drive"]
