"""Families of trajectories and their coefficients."""
