"""A running ``lieid workbench``, and a browser that shows it."""

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

CHROMIUM, DRIVER = Path("/usr/bin/chromium"), Path("/usr/bin/chromedriver")
PICTURES = os.environ.get("LIEID_SCREENSHOTS")  # folder to keep pictures of the page in
PATIENCE = 300.0  # s until a wait fails: longer than anything takes on a busy machine
AGAIN = 5.0  # s after which a click is repeated whose effect is not seen
WORKBENCH = ("-m", "lieid_casadi.cli.main", "workbench")
PORTS = 5  # tried one after the other: another program may take a free one first


SIZES = ((1300, 900), (1920, 1080), (1024, 768))
# Texts that are cut without a tooltip, and texts outside of the panel that they belong to.
CUT = """
const texts = [...document.querySelectorAll('.panel *, .toolbar *, .verdict-panel *')].filter(
  (e) => e.offsetParent && [...e.childNodes].some((n) => n.nodeType === 3 && n.data.trim()));
const cut = (e) => getComputedStyle(e).overflowX !== 'visible'
  && e.scrollWidth > e.clientWidth + 1 && !e.closest('[title]');
const outside = (e) => {
  const panel = e.closest('.panel, .toolbar, .verdict-panel').getBoundingClientRect();
  const box = e.getBoundingClientRect();
  return box.right > panel.right + 1 || box.left < panel.left - 1;
};
return texts.filter((e) => cut(e) || outside(e)).map((e) => e.textContent.trim().slice(0, 60));
"""
# Texts whose contrast with their background is below 4.5 (WCAG 2.1), but those of disabled buttons.
FAINT = """
const parse = (c) => c.match(/[0-9.]+/g).map(Number);
const light = (c) => {
  const [r, g, b] = c.slice(0, 3).map((v) => v / 255).map(
    (v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
};
const background = (e) => {
  for (; e; e = e.parentElement) {
    const c = parse(getComputedStyle(e).backgroundColor);
    if (c.length === 3 || c[3] > 0.99) return c;
  }
  return [255, 255, 255];
};
const texts = [...document.querySelectorAll('body *')].filter((e) => e.offsetParent
  && !e.closest('.disabled, canvas, .material-icons, .q-icon')
  && [...e.childNodes].some((n) => n.nodeType === 3 && n.data.trim()));
const ratio = (e) => {
  const [a, b] = [light(parse(getComputedStyle(e).color)), light(background(e))].sort();
  return (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
};
return texts.filter((e) => ratio(e) < 4.5).map(
  (e) => `${e.textContent.trim().slice(0, 40)}: ${ratio(e).toFixed(2)}`);
"""
VIEWS = (
    "arm-view", "torque-plot", "residual-plot", "correlation-plot", "spectrum-plot", "waterfall",
    "overview", "error-1", "undo", "redo", "find-missing", "export",
)  # fmt: skip


class Server:
    """``lieid workbench WORDS``, or a program with a page, with its own folder of sessions."""

    def __init__(
        self, *words: str, folder: Path, program: Sequence[str] = WORKBENCH, port: int = 0
    ) -> None:
        for _ in range(PORTS):
            self.port = port or free_port()
            option = "--port" if program[-1] == "workbench" else "--page"
            port = (option, str(self.port), "--no-browser")
            self._start(*program, *words, *port, folder=folder)
            if self.url:
                return
            _, errors = self.ended()
            if "is in use" not in errors:
                break
        pytest.fail(f"no URL: {errors}")

    def _start(self, *words: str, folder: Path) -> None:
        """Start the process, and read its URL; it is empty if the process ended."""
        environment = os.environ | {"LIEID_WORKBENCH_DIR": str(folder)}
        self._errors = tempfile.TemporaryFile("w+")  # noqa: SIM115 - a pipe would fill
        self.process = subprocess.Popen(
            [sys.executable, *words],
            stdout=subprocess.PIPE, stderr=self._errors, env=environment, text=True,
        )  # fmt: skip
        assert self.process.stdout is not None
        self.url = self.process.stdout.readline().strip()

    def stop(self, number: int = signal.SIGTERM) -> tuple[int, str]:
        """End it; return its exit status, and what it wrote to stderr."""
        self.process.send_signal(number)
        return self.ended()

    def ended(self) -> tuple[int, str]:
        """Wait for its end; return its exit status, and what it wrote to stderr."""
        self.process.communicate(timeout=PATIENCE)
        with self._errors as file:
            file.seek(0)
            return self.process.returncode, file.read()


def free_port() -> int:
    """Return a port that nothing listens on now."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


class Page:
    """A browser tab on the page, in a window of its own."""

    def __init__(self, width: int = 1300, height: int = 1000, downloads: Path | None = None):
        from selenium import webdriver
        from selenium.webdriver.chrome.service import Service

        options = webdriver.ChromeOptions()
        for word in (
            "--headless=new", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader",
            "--disable-dev-shm-usage", f"--window-size={width},{height}",
        ):  # fmt: skip
            options.add_argument(word)
        options.binary_location = str(CHROMIUM)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
        if downloads is not None:
            options.add_experimental_option("prefs", {"download.default_directory": str(downloads)})
        self.downloads = downloads
        self.driver = webdriver.Chrome(options=options, service=Service(str(DRIVER)))
        self.driver.set_page_load_timeout(PATIENCE)

    def element(self, test_id: str):
        """Return the element with a ``data-testid``."""
        return self.driver.find_element("css selector", f'[data-testid="{test_id}"]')

    def elements(self, test_id: str):
        """Return all elements with a ``data-testid``."""
        return self.driver.find_elements("css selector", f'[data-testid="{test_id}"]')

    def click(self, test_id: str, done: Callable[[], object] | None = None) -> None:
        """Click an element once it can be clicked: shown, and behind no dialog that fades.

        With ``done``, the click is repeated until its effect is seen: the element may have moved or
        been drawn again under the pointer. Not for what a second click undoes.
        """

        def clicked():
            element = self.element(test_id)
            place = element.rect
            time.sleep(0.1)
            if element.rect != place:  # what is above it is still being drawn
                return False
            element.click()
            return True

        if done is None:
            self.wait(clicked, f"{test_id} cannot be clicked")
        else:
            self.repeat(clicked, done, f"effect of a click on {test_id}")

    def repeat(self, act: Callable[[], object], done: Callable[[], object], what: str) -> None:
        """Act, and act again after some seconds, until the effect ``what`` is seen."""

        def seen():
            if not done():  # what was clicked may be gone once it is
                act()
            end = time.monotonic() + AGAIN
            while time.monotonic() < end:
                if done():
                    return True
                time.sleep(0.2)
            return False

        self.wait(seen, what)

    def shown(self, test_id: str) -> bool:
        """Return whether an element with a ``data-testid`` can be seen."""
        return any(element.is_displayed() for element in self.elements(test_id))

    def text(self, test_id: str) -> str:
        """Return the text of an element, empty while there is none."""
        from selenium.common.exceptions import WebDriverException

        try:
            return self.element(test_id).text
        except WebDriverException:
            return ""

    def number(self, test_id: str) -> float:
        """Return the number at the start of an element's text, NaN if there is none."""
        try:
            return float(self.text(test_id).split()[0])
        except (ValueError, IndexError):
            return float("nan")

    def wait(self, condition, what: str = "", timeout: float = PATIENCE):
        """Return the first true value of a condition; while elements come and go it is not met."""
        from selenium.common.exceptions import WebDriverException

        last, end = None, time.monotonic() + timeout
        while time.monotonic() < end:
            try:
                if value := condition():
                    return value
            except WebDriverException as error:
                last = error.msg
            time.sleep(0.2)
        shown = "document.body ? document.body.innerText : ''"
        text = " | ".join(str(self.driver.execute_script(f"return {shown}")).split("\n"))
        every = (entry["message"][:200] for entry in self.driver.get_log("browser"))
        messages = list(dict.fromkeys(every))[:10]
        return pytest.fail(
            f"{what or 'condition'} not met in {timeout:.0f} s; {last}; {messages}; page: {text}"
        )

    def downloaded(self, name: str) -> Path:
        """Return a saved file once it is complete."""
        assert self.downloads is not None
        file = self.downloads / name

        def complete():
            unfinished = [*self.downloads.glob("*.crdownload"), *self.downloads.glob(".com.*")]
            return file.is_file() and file.stat().st_size > 0 and not unfinished

        self.wait(complete, name)
        return file

    def picture(self, name: str) -> None:
        """Keep a picture of the page where the environment asks for it."""
        if PICTURES:
            Path(PICTURES).mkdir(parents=True, exist_ok=True)
            self.driver.save_screenshot(str(Path(PICTURES) / f"{name}.png"))

    def check_layout(self, name: str) -> None:
        """Check at three sizes that no text is cut or faint, and no view is beside the window."""
        wide = "return [document.documentElement.scrollWidth, window.innerWidth]"
        for width, height in SIZES:
            size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
            self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
            self.wait(lambda w=width: self.driver.execute_script(wide)[1] == w, "the size")
            self.wait(lambda: self.driver.execute_script(CUT) == [], f"no text cut at {width}")
            assert self.driver.execute_script(FAINT) == []
            self.picture(f"{name}_{width}")
            page_width, available = self.driver.execute_script(wide)
            assert page_width <= available
            for view in VIEWS:
                box = self.element(view).rect
                assert box["width"] > 10
                assert box["x"] + box["width"] <= width
        self.driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})

    def script_errors(self) -> list[str]:
        """Return what the browser reported as errors of the page."""
        return [e["message"] for e in self.driver.get_log("browser") if e["level"] == "SEVERE"]
