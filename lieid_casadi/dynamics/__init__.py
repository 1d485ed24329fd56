"""Symbolic rigid-body dynamics of a serial arm by the product of exponentials."""
