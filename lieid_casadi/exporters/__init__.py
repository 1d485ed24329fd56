"""Files for controllers and simulators: C, URDF, MJCF."""
