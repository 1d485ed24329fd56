"""A fit against recordings it has not seen: how large the error is, and where."""

from lieid_casadi.comparison.compare import compare
from lieid_casadi.comparison.comparison import Comparison
from lieid_casadi.comparison.time_series import Series
from lieid_casadi.comparison.worst_moments import Moment

__all__ = ["Comparison", "Moment", "Series", "compare"]
