"""Views that are informed of changes, and work beside what the user does."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any


class ChangeNotifier:
    """An object whose changes are shown by views."""

    def __init__(self) -> None:
        self._listeners: list[Callable[[], None]] = []
        self._tasks: set[asyncio.Task[Any]] = set()

    def listen(self, listener: Callable[[], None]) -> None:
        """Call ``listener`` after every change."""
        self._listeners.append(listener)

    def forget(self, listener: Callable[[], None]) -> None:
        """Do not call ``listener`` any more."""
        if listener in self._listeners:
            self._listeners.remove(listener)

    @property
    def has_viewers(self) -> bool:
        """Whether a page shows it."""
        return bool(self._listeners)

    def changed(self) -> None:
        """Inform all listeners."""
        for listener in list(self._listeners):
            listener()

    def background(self, work: Coroutine[Any, Any, None]) -> None:
        """Run a coroutine beside what the user does."""
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
