"""Small elements that several views use."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import TypeVar

from nicegui.element import Element

E = TypeVar("E", bound=Element)
UNKNOWN = "–"
_EMIT_ACTION = """(event) => {
  const part = event.target.closest('[data-action]');
  const twice = event.type === 'keydown' && part?.tagName === 'BUTTON';  // Enter clicks it, too
  if (part && !twice) emit(part.dataset.action);
}"""


def named(element: E, test_id: str) -> E:
    """Return an element with an identifier for tests (``data-testid``)."""
    element.props["data-testid"] = test_id
    return element


def acting(element: E, action: str) -> E:
    """Return an element on which a click is an action of the list that contains it."""
    element.props["data-action"] = action
    return element


def on_action(container: Element, handle: Callable[[str], Awaitable[None]]) -> None:
    """Call a coroutine with the action of the part of a list that is clicked, or Enter pressed on.

    The list listens, not its parts: parts may be drawn again between the click and its arrival,
    and events of deleted parts are dropped.

    Parameters
    ----------
    container : Element
        Its parts are marked by `acting`.
    handle : coroutine function
    """
    for kind in ("click", "keydown.enter"):
        container.on(kind, lambda event: handle(event.args), js_handler=_EMIT_ACTION)


def figures(value: float | None, *, digits: int = 3) -> str:
    """Return a number with some significant digits, a dash if it is unknown.

    Examples
    --------
    >>> figures(0.19843), figures(12.3456), figures(12.3456, digits=2), figures(None)
    ('0.198', '12.3', '12', '–')
    """
    if value is None or value != value:
        return UNKNOWN
    if value == 0.0 or 1e-3 <= abs(value) < 1e4:
        exponent = int(f"{value:.{digits - 1}e}".partition("e")[2])
        return f"{value:.{max(0, digits - 1 - exponent)}f}"
    return f"{value:.{digits - 1}e}"


def place(label: str) -> str:
    """Return ``NAME-J`` of a placed effect: its name and target joint, or ``arm``.

    Examples
    --------
    >>> place("stribeck:4"), place("transmission_coupling:5<6"), place("payload")
    ('stribeck-4', 'transmission_coupling-5', 'payload-arm')
    """
    name, _, joint = label.partition(":")
    return f"{name.partition('/')[0]}-{joint.partition('<')[0] or 'arm'}"
