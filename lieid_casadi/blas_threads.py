"""Linear algebra on one thread: our matrices are small, and threads then cost more than they give.

On a busy two-core machine a diagnosis took nine times less processor time this way.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


def blas_on_one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Let BLAS use one thread while a function runs; what was set before comes back."""

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited
