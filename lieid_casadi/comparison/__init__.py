"""Comparison of a fit with recordings: size of the error, and where it is large."""

from lieid_casadi.comparison.compare import compare
from lieid_casadi.comparison.comparison import Comparison
from lieid_casadi.comparison.series import LargeError, Series

__all__ = ["Comparison", "LargeError", "Series", "compare"]
