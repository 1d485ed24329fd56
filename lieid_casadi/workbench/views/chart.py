"""A chart to which only what has changed is sent."""

from __future__ import annotations

from typing import Any

import msgspec
from nicegui import ui

from lieid_casadi.workbench.views.elements import named

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
        options : dict
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
