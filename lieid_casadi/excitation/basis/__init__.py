"""Bases of trajectories and their coefficients."""
