"""How messages write names and joints."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np


def joints_text(joints: Iterable[object]) -> str:
    """Return ``joint 2`` or ``joints 2, 3`` for a mask over the joints."""
    numbers = [str(index + 1) for index in np.nonzero(np.asarray(list(joints)))[0]]
    return f"joint{'s' if len(numbers) > 1 else ''} {', '.join(numbers)}"
