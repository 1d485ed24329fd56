"""A fit against recordings it has not seen: how large the error is, and where."""

from lieid_casadi.comparison.compare import compare
from lieid_casadi.comparison.comparison import Comparison
from lieid_casadi.comparison.moments import Moment
from lieid_casadi.comparison.series import Series

__all__ = ["Comparison", "Moment", "Series", "compare"]
