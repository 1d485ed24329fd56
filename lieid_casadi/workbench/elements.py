"""Small elements that several views use: texts, actions, colours, charts."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any, TypeVar

import msgspec
from nicegui import ui
from nicegui.element import Element

from lieid_casadi.comparison.comparison import AS_NOISE, BEYOND_NOISE

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


UNKNOWN_COLOUR = "#b8bec4"
#: Largest error over noise floor of each class and its colour; readable without red and green.
SCALE = (
    (AS_NOISE, "#7fb8dc"),
    (BEYOND_NOISE, "#e6d36a"),
    (5.0, "#e69f00"),
    (float("inf"), "#b03a00"),
)
#: Lines for successive models and effects.
SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#6a51a3", "#555555")


def ratio_colour(ratio: float | None) -> str:
    """Return the colour of an error in multiples of the noise floor."""
    if ratio is None:
        return UNKNOWN_COLOUR
    return next(colour for most, colour in SCALE if ratio <= most)


# Waits for a chart that the browser has not made yet.
_SET_OPTIONS = """(function set(options, whole) {
  const chart = getElement(ID)?.chart;
  if (chart) chart.setOption(options, whole); else setTimeout(() => set(options, whole), 20);
})(OPTIONS, WHOLE);"""


class Chart:
    """An ECharts chart whose options are not properties of the page's element.

    Properties are observed down to every sample, here and in the browser, and the whole page is
    rendered again after a change; both take longer than to draw the chart.

    Parameters
    ----------
    name : str
        For tests (``data-testid``) and the style sheet.
    options : dict
        Its series, as those of later options, have an ``id``.
    """

    def __init__(self, name: str, options: dict[str, Any]) -> None:
        self.element = named(ui.echart({}), name).classes(name)
        self._shown: dict[str, Any] = {}
        self.show(options, whole=True)

    def show(self, options: dict[str, Any], *, whole: bool = False) -> None:
        """Show other options.

        Parameters
        ----------
        whole : bool
            Forget what the browser has changed, such as the zoom.
        """
        shown, self._shown = self._shown, options
        whole = whole or _names(options) != _names(shown)
        if not whole:
            options = {key: value for key, value in options.items() if shown.get(key) != value}
            if "series" in options:
                both = zip(options["series"], shown["series"], strict=True)
                options["series"] = [_difference(new, old) for new, old in both if new != old]
        if options:
            text = _SET_OPTIONS.replace("ID", str(self.element.id), 1)
            text = text.replace("WHOLE", str(whole).lower(), 1)
            self.element.client.run_javascript(
                text.replace("OPTIONS", msgspec.json.encode(options).decode(), 1)
            )

    def run(self, method: str, *arguments: Any) -> None:
        """Run a method of the chart in the browser."""
        self.element.run_chart_method(method, *arguments)


def _names(options: dict[str, Any]) -> list[str]:
    return [series["id"] for series in options.get("series", ())]


def _difference(new: dict[str, Any], old: dict[str, Any]) -> dict[str, Any]:
    """Return the entries of a series that have changed, with its ``id``."""
    changed = {key: value for key, value in new.items() if old.get(key) != value}
    return {"id": new["id"], **changed}
