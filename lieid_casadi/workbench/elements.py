"""Small elements that several views use: texts, actions, colours, charts."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from importlib import resources
from typing import Any, TypeVar

import msgspec
from markupsafe import Markup, escape
from nicegui import ui
from nicegui.element import Element

from lieid_casadi.comparison.comparison import AS_NOISE, BEYOND_NOISE
from lieid_casadi.plot_style import BACKWARD, ERROR, FORWARD, MEASURED, PREDICTED, REST
from lieid_casadi.workbench.workbench import Workbench

E = TypeVar("E", bound=Element)
UNKNOWN_COLOUR = "#b8bec4"
BAND, COMPARED, FIRST = "#9fb6c6", "#009e73", "#9aa5b1"
COLOURS = {
    "measured": MEASURED, "predicted": PREDICTED, "error": ERROR, "forward": FORWARD,
    "backward": BACKWARD, "rest": REST, "band": BAND, "compared": COMPARED,
}  # fmt: skip
#: Largest error over noise floor of each class and its colour; readable without red and green.
SCALE = (
    (AS_NOISE, "#7fb8dc"),
    (BEYOND_NOISE, "#e6d36a"),
    (5.0, "#e69f00"),
    (float("inf"), "#b03a00"),
)


def open_page() -> None:
    """Load the style and the functions of the page, ``page.css`` and ``page.js``."""
    files = resources.files("lieid_casadi.workbench")
    ui.add_css(files.joinpath("page.css").read_text("utf-8"))
    functions = files.joinpath("page.js").read_text("utf-8")
    ui.add_body_html(f"<script>const colours = {COLOURS};\n{functions}</script>")
    ui.colors(primary="#0b4f8a")


class View:
    """A part of the page; it is drawn again when what it shows has changed."""

    def __init__(self, workbench: Workbench) -> None:
        self.workbench = workbench
        self._shown: object = None

    def is_new(self, *shown: object) -> bool:
        """Return whether this differs from what was drawn last, and remember it."""
        new = shown != self._shown
        self._shown = shown
        return new

    def update(self) -> None:
        """Draw what has changed."""
        raise NotImplementedError


class Parts:
    """A list of the page as HTML; ``act`` is called with the action of the part that is clicked.

    Enter and space on a part that has the focus are a click. The list listens, not its parts:
    these may be drawn again between the click and its arrival.
    """

    def __init__(self, css: str, act: Callable[[str], Awaitable[None]]) -> None:
        self.element = ui.html("", sanitize=False).classes(f"parts {css}")
        for kind in ("click", "keydown.enter", "keydown.space"):
            self.element.on(
                kind, lambda event: act(event.args), js_handler="(event) => emitAction(event, emit)"
            )

    def show(self, *parts: Markup) -> None:
        """Show other parts."""
        content = Markup().join(parts)
        if self.element.content != content:
            self.element.set_content(content)


def part(
    css: str, *content: object, id: str = "", tip: str = "", action: str = "", **more: str
) -> Markup:
    """Return an HTML element; text in it is escaped.

    ``id`` is its identifier for tests, ``tip`` its tooltip, and ``action`` what a click on it does
    in its `Parts`.
    """
    facts = {"class": css, "data-testid": id, "title": tip, "data-action": action, **more}
    if action:
        facts |= {"role": "button", "tabindex": "0"}
    shown = Markup().join(Markup(' {}="{}"').format(k, v) for k, v in facts.items() if v)
    return Markup("<div{}>{}</div>").format(shown, Markup().join(map(escape, content)))


def cut_part(css: str, content: str, *, id: str = "") -> Markup:
    """Return a text whose whole is its tooltip, where the page may cut it."""
    return part(css, content, id=id, tip=content)


def icon_part(icon: str, action: str, meaning: str, *, id: str, css: str = "") -> Markup:
    """Return a small icon on which a click is an action."""
    return part(
        f"material-icons icon-part {css}", icon, id=id, tip=meaning, action=action,
        **{"aria-label": meaning},
    )  # fmt: skip


def named(element: E, test_id: str) -> E:
    """Return an element with an identifier for tests (``data-testid``)."""
    element.props["data-testid"] = test_id
    return element


def button(text: str, test_id: str, act: Callable[[], object], look: str = "flat") -> ui.button:
    """Return a small button with a text."""
    made = ui.button(text, on_click=act).props(f"dense no-caps {look}")
    return named(made, test_id)


def icon_button(icon: str, test_id: str, meaning: str, look: str = "size=sm") -> ui.button:
    """Return a round button with an icon, and its meaning as a tooltip."""
    made = ui.button(icon=icon).props(f"flat dense round {look}")
    made.props["aria-label"] = made.props["title"] = meaning
    return named(made, test_id)


def text(content: str, classes: str, test_id: str = "") -> ui.label:
    """Return a label whose whole text is its tooltip, where the page may cut it."""
    made = ui.label(content).classes(classes)
    made.props["title"] = content
    return named(made, test_id) if test_id else made


def set_text(label: ui.label, content: str) -> None:
    """Change the text of a label, and its tooltip."""
    if label.text != content:
        label.text = content
        label.props["title"] = content


def place(label: str) -> str:
    """Return ``NAME-J`` of a placed effect: its name and target joint, or ``arm``.

    Examples
    --------
    >>> place("stribeck:4"), place("transmission_coupling:5<6"), place("payload")
    ('stribeck-4', 'transmission_coupling-5', 'payload-arm')
    """
    name, _, joint = label.partition(":")
    return f"{name.partition('/')[0]}-{joint.partition('<')[0] or 'arm'}"


def ratio(error: float | None, floor: float | None) -> float | None:
    """Return an error in multiples of its noise floor, None where one is unknown."""
    return error / floor if error is not None and floor else None


def ratio_colour(multiple: float | None) -> str:
    """Return the colour of an error in multiples of the noise floor."""
    if multiple is None:
        return UNKNOWN_COLOUR
    return next(colour for most, colour in SCALE if multiple <= most)


def call(function: str, element: Element, *arguments: object) -> None:
    """Call a function of ``page.js`` for an element."""
    words = [msgspec.json.encode(each).decode() for each in (element.id, *arguments)]
    element.client.run_javascript(f"{function}({', '.join(words)})")


class Chart:
    """A chart, drawn by ``page.js`` from data that are not properties of the page's element.

    Properties are observed down to every sample, here and in the browser, and the whole page is
    rendered again after a change; both take longer than to draw the chart.
    """

    def __init__(self, name: str, **data: Any) -> None:
        self.element = named(ui.echart({}), name).classes(name)
        self._name, self._sent = name, dict[str, object]()
        self.show(**data)

    def show(self, *, whole: bool = False, **data: Any) -> None:
        """Show other data; ``whole`` forgets what the user has changed, such as the zoom."""
        changed = {k: v for k, v in data.items() if k not in self._sent or self._sent[k] != v}
        self._sent |= changed
        if changed or whole:
            self.call("draw", self._name, changed, whole)

    def call(self, function: str, *arguments: object) -> None:
        """Call a function of ``page.js`` for this chart."""
        call(function, self.element, *arguments)

    def run(self, method: str, *arguments: Any) -> None:
        """Run a method of the chart in the browser."""
        self.element.run_chart_method(method, *arguments)
