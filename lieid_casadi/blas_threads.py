"""Linear algebra on one thread: for small matrices starting threads takes longer than it saves.

On a busy machine with two cores a diagnosis took a ninth of the processor time.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

P = ParamSpec("P")
R = TypeVar("R")


def blas_on_one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function during which BLAS uses one thread; the previous setting is restored."""

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with _libraries().limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited


@cache
def _libraries() -> ThreadpoolController:
    """Return the libraries that are loaded at the first call; to look for them takes 4 ms."""
    return ThreadpoolController()
