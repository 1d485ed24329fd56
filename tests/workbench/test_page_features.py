"""The page in a browser: selecting and excluding time, files, tabs, reloads, and changes."""

import math
import signal
import zipfile

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi.report import diagnosis_report
from lieid_casadi.tables import figures

pytestmark = pytest.mark.slow

COMPLETE = '[data-testid="verdict"][data-complete="true"]'


def brush(page):
    """Drag over a part of the torque plot."""
    from selenium.webdriver import ActionChains

    def dragged():
        plot = page.element("torque-plot")
        page.driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", plot)
        drag = ActionChains(page.driver).move_to_element_with_offset(plot, -100, -50)
        drag.click_and_hold().move_by_offset(50, 0).move_by_offset(50, 0).release().perform()

    page.repeat(dragged, lambda: page.element("exclude-selection").is_enabled(), "the selection")


def opened(page, joint=1):
    page.wait(lambda: page.number(f"error-{joint}") > 0.0, "the first errors")
    return page.number(f"error-{joint}")


def test_the_demo_names_the_hidden_effect(start, browse):
    """Of seven joints, in two clicks."""
    server = start()
    page = browse(server.url)
    assert opened(page, 2) > 0.5
    page.wait(lambda: noise(page, 7) > 0.0, "the noise floor")
    worst = max(range(1, 8), key=lambda j: page.number(f"error-{j}") / noise(page, j))
    assert worst == 2
    page.click("find-missing")  # the first click
    page.wait(lambda: page.text("candidate-load_friction-2"), "the proposal")
    page.picture("demo_proposal")
    page.click("candidate-load_friction-2")  # the second
    page.wait(lambda: page.number("error-2") < 0.2, "an error below 0.2 N·m")
    page.wait(lambda: "τload" in page.text("effect-load_friction-2"), "the formula")
    page.wait(lambda: "±" in page.text("effect-load_friction-2"), "the standard deviation")
    page.wait(lambda: page.driver.find_elements("css selector", COMPLETE), "the noise floor")
    page.wait(lambda: "% fit" in page.text("fit-percent-7"), "the fit of joint 7")
    page.check_layout("demo_added")
    assert page.script_errors() == []
    assert server.stop() == (0, "")


def noise(page, joint):
    """Return the noise floor of a joint, NaN while it is not shown."""
    try:
        return float(page.text(f"noise-{joint}").split()[-1])
    except (ValueError, IndexError):
        return math.nan


def test_a_range_is_excluded_all_effects_are_added_and_files_are_saved(
    start, browse, two_link_files
):
    server = start("two_link", *map(str, two_link_files))
    page = browse(server.url)
    before = opened(page)
    brush(page)

    def another():
        error = page.number("error-1")
        return error > 0.0 and error != before

    page.click("exclude-selection", done=another)
    command = "lieid identify two_link"
    page.click("copy-command", done=lambda: command in page.text("command-shell"))
    assert "test.npz@" in page.text("command-shell")
    page.click("close-commands", done=lambda: not page.shown("command-shell"))
    page.click("compare-1")
    page.wait(lambda: page.number("compared-1") == before, "the compared error")
    page.click("undo")
    page.wait(lambda: page.number("error-1") == before, "undo")
    page.click("find-missing", done=lambda: page.shown("stop"))
    page.click("stop", done=lambda: page.shown("find-missing"))
    assert not page.shown("add-all")  # a search that is stopped shows nothing
    page.click("find-missing")
    page.wait(lambda: page.shown("add-all"), "the findings")
    assert page.text("status-load_friction-1") in ("named", "one of")
    page.click("add-all", done=lambda: page.number("error-1") < 0.5 * before)
    shown = page.text("error-1")
    page.wait(lambda: page.elements("step-2"), "one step in the history")
    assert not page.elements("step-3")
    page.click("save-fit")
    fit = lieid.Fit.load(page.downloaded("fit.json"))
    saved = lieid.compare(fit, lieid.Recording.load(two_link_files[1]))
    assert f"{figures(saved.rms_moving[0])} N·m" == shown  # the page and the file agree
    for kind in ("c", "mjcf"):
        page.click("export", done=lambda kind=kind: page.shown(f"save-{kind}"))
        page.click(f"save-{kind}")
        page.downloaded(f"two_link_{kind}.zip")
        page.wait(lambda kind=kind: not page.shown(f"save-{kind}"), "the end of the menu")
    with zipfile.ZipFile(page.downloaded("two_link_mjcf.zip")) as archive:
        assert "mjcf/two_link.xml" in archive.namelist()


def test_tabs_reload_and_a_killed_server(start, browse, two_link_files):
    server = start("two_link", *map(str, two_link_files))
    first, second = browse(server.url), browse(server.url)
    before = opened(first)
    assert opened(second) == before
    first.click("remove-viscous-1", done=lambda: first.number("error-1") > 1.2 * before)
    larger = first.number("error-1")
    assert second.number("error-1") == before
    assert second.elements("effect-viscous-1")
    an_effect_is_searched_and_the_tab_is_closed_during_an_export(second)
    first.driver.refresh()
    first.wait(lambda: first.number("error-1") == larger, "the session after a reload")
    first.click("save-fit")
    first.downloaded("fit.json")
    _, errors = server.stop(signal.SIGKILL)
    assert errors == ""
    start("two_link", *map(str, two_link_files), port=server.port)
    first.driver.refresh()
    first.wait(lambda: first.number("error-1") == larger, "the session after the server was killed")
    first.wait(lambda: first.elements("effect-coulomb-1"), "the effects")
    assert not first.elements("effect-viscous-1")


def an_effect_is_searched_and_the_tab_is_closed_during_an_export(page):
    page.click("add-effect", done=lambda: page.shown("search-effect"))
    page.element("search-effect").send_keys("gravity rotated")
    page.wait(lambda: not page.elements("library-viscous"), "the effects that match")
    page.click("library-base_tilt", done=lambda: page.elements("effect-base_tilt-arm"))
    page.click("export", done=lambda: page.shown("save-mjcf"))
    page.click("save-mjcf")
    page.driver.get("about:blank")


def choose(page, test_id, item):
    """Choose an item of a select, which the text of the dialog then contains."""
    items = f"//div[contains(@class, 'q-menu')]//*[text()='{item}']"
    page.click(test_id, done=lambda: page.driver.find_elements("xpath", items))
    page.repeat(
        lambda: page.driver.find_element("xpath", items).click(),
        lambda: item in page.text("columns-text"),
        item,
    )


def test_files_are_dropped_and_their_columns_assigned(start, browse, two_link_files, tmp_path):
    files = [tmp_path / "a.csv", tmp_path / "b.csv"]
    for path, file in zip(files, two_link_files, strict=True):
        r = lieid.Recording.load(file)
        rows = np.column_stack([1e3 * r.t, np.degrees(r.q), np.degrees(r.dq), r.tau])
        names = "stamp_ms,my_angle1,my_angle2,my_vel1,my_vel2,load_cell1,load_cell2"
        np.savetxt(path, rows, "%.9g", ",", header=names, comments="")
    server = start("panda")
    page = browse(server.url)
    page.wait(lambda: "no recordings" in page.text("open-error"), "the form")
    page.click("close-form", done=lambda: not page.shown("open-robot"))
    for k, file in enumerate(files, start=1):
        for kind in ("dragEnter", "dragOver", "drop"):
            data = {"items": [], "files": [str(file)], "dragOperationsMask": 1}
            page.driver.execute_cdp_cmd(
                "Input.dispatchDragEvent", {"type": kind, "x": 600, "y": 500, "data": data}
            )
        page.wait(lambda k=k: page.elements(f"role-{k}"), "the recording")
    page.element("open-robot").clear()
    page.element("open-robot").send_keys("two_link")
    page.click("map-columns", done=lambda: page.shown("columns-text"))
    assert "--columns t=stamp_ms,q=my_angle*,dq=my_vel*" in page.text("columns-text")
    choose(page, "column-tau", "load_cell*")
    assert "tau=load_cell*" in page.text("columns-text")
    choose(page, "unit-angle", "deg")
    assert "--units deg,ms" in page.text("columns-text")
    page.picture("columns")
    page.click("use-columns", done=lambda: not page.shown("columns-text"))
    page.click("open")
    before = opened(page)
    assert page.driver.current_url.startswith(server.url.partition("?")[0])
    a_bad_file_is_one_line_beside_the_field(page, tmp_path)
    assert page.number("error-1") == before  # what was open stays
    assert server.stop() == (0, "")


def a_bad_file_is_one_line_beside_the_field(page, folder):
    bad = folder / "bad.csv"
    bad.write_text("t,q1,q2\n0,1,nan\n1,2,3\n")
    page.wait(lambda: not page.shown("open-recording"), "the form that fades away")
    page.click("open-files-panel", done=lambda: page.shown("open-recording"))
    for path, found in ((str(bad), "bad.csv"), ("/no/such.csv", "/no/such.csv")):
        page.element("open-recording").send_keys(path)
        page.click("add-recording")
        page.click("open")
        page.wait(lambda found=found: found in page.text("open-error"), "the error")
        assert "\n" not in page.text("open-error")
        page.click("remove-recording-3")
        page.wait(lambda: not page.elements("remove-recording-3"), "the shorter list")
    page.element("open-robot").clear()
    page.element("open-robot").send_keys("/etc/passwd")
    page.click("open")
    page.wait(lambda: "/etc/passwd" in page.text("open-error"), "the error")


def test_tables_of_reports_fit_1000_pixels_and_a_printed_page(browse, two_link_files, tmp_path):
    train, test = map(lieid.Recording.load, two_link_files)
    model = lieid.Model(lieid.robots.two_link(), "coulomb,viscous,offset")
    found = lieid.diagnose(model, train, test)
    file = tmp_path / "report.html"
    file.write_text(diagnosis_report(found, lieid.compare(found.fit, test)))
    page = browse(file.as_uri(), width=1000, height=900)
    wide = """document.querySelectorAll('details').forEach((e) => { e.open = true; });
    return [...document.querySelectorAll('body, section, details, td, pre')].filter(
      (e) => e.scrollWidth > e.clientWidth + 1).map((e) => e.textContent.slice(0, 60));"""
    assert len(page.driver.find_elements("css selector", "table")) > 4
    assert page.driver.execute_script(wide) == []
    page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    paper = {"width": 718, "height": 1040, "deviceScaleFactor": 1, "mobile": False}  # A4, 96 dpi
    page.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", paper)
    page.wait(lambda: page.driver.execute_script("return innerWidth") == 718, "the paper")
    assert page.driver.execute_script(wide) == []
