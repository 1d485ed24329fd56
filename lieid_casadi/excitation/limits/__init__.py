"""Constraint sets: joint, torque, Cartesian and workspace limits."""
