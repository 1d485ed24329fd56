"""Identification of drive gains in N·m/A from motor currents and a payload of known mass."""

from lieid_casadi.gains.identify import DriveGains, GainNotIdentified, drive_gains

__all__ = ["DriveGains", "GainNotIdentified", "drive_gains"]
