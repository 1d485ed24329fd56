"""Physically consistent parameters by semidefinite programming."""
