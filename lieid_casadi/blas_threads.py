"""Linear algebra on one thread: for small matrices starting threads takes longer than it saves.

On a busy machine with two cores a diagnosis took a ninth of the processor time.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


def blas_on_one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function during which BLAS uses one thread; the previous setting is restored."""

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited
