"""Solvers of the excitation problem, and the stages and starts they run through."""
