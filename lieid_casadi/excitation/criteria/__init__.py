"""Excitation criteria, and the information matrix that they are functions of."""
