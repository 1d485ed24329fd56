"""Solver of the excitation problem, and the stages and starts it runs through."""
