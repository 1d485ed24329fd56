"""What leaves the package: files for controllers and simulators."""
