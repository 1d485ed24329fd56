"""The page under the pointer: clicks on the arm, wheel and dragging on the plot, dropped files."""

import time

import pytest

pytestmark = pytest.mark.slow

CENTRE = """
const view = document.querySelector('[data-testid="arm-view"]');
const arm = getElement(view.id.slice(1)), canvas = view.querySelector('canvas');
let link = null;
arm.scene.traverse((part) => {
  if (!link && part.parent?.name === arguments[0] && part.geometry) link = part;
});
if (!link || canvas.getBoundingClientRect().width < 10) return null;
link.geometry.computeBoundingSphere();
const at = link.localToWorld(link.geometry.boundingSphere.center.clone()).project(arm.camera);
return [0.5 * at.x * canvas.clientWidth, -0.5 * at.y * canvas.clientHeight];
"""
SAME = 20  # equal values one after the other
CURSOR = """
const chart = getElement(document.querySelector('[data-testid="torque-plot"]').id.slice(1)).chart;
return chart.getOption().series.find((s) => s.id === 'cursor').markLine.data[0]?.xAxis ?? null;
"""


FRAMES = """
const scene = getElement(document.querySelector('[data-testid="arm-view"]').id.slice(1));
return scene.renderer.info.render.frame;
"""
STILL = 1.0  # s, of ten looks of the timer of the scene


def opened(page):
    page.wait(lambda: page.number("error-1") > 0.0, "the first errors")
    page.wait(lambda: "joint 1" in page.text("effects-title"), "the effects")


def span(page):
    """Return the ends of the scrubber's range, s."""
    slider = page.element("scrubber")
    ends = [slider.get_attribute(f"aria-value{end}") for end in ("min", "max")]
    if None in ends:
        slider = slider.find_element("css selector", "[role=slider]")
        ends = [slider.get_attribute(f"aria-value{end}") for end in ("min", "max")]
    return tuple(map(float, ends))


def test_a_click_on_the_arm_and_the_wheel_on_the_plot(start, browse, two_link_files):
    server = start("two_link", *map(str, two_link_files))
    page = browse(server.url)
    opened(page)
    the_arm_is_drawn_when_it_changes(page)
    a_click_on_a_link_selects_its_joint(page)
    the_wheel_zooms_and_the_replay_follows(page)
    a_range_that_is_typed_is_selected(page)
    a_peak_of_the_spectrum_is_shown_on_the_arm(page)
    assert page.script_errors() == []


def the_arm_is_drawn_when_it_changes(page):
    """Otherwise the processor is free for the fit."""

    def drawn():
        return page.driver.execute_script(FRAMES)

    def still():
        before = drawn()
        time.sleep(STILL)
        return 0 < before == drawn()

    page.wait(still, "the end of drawing")
    before = drawn()
    page.click("joint-2", done=lambda: drawn() > before)  # its drum is shown


def a_range_that_is_typed_is_selected(page):
    field = page.element("range")
    whole = span(page)
    field.send_keys("1 2.5\n")
    page.wait(lambda: span(page) == (1.0, 2.5), "the range")
    assert page.element("exclude-selection").is_enabled()
    field.send_keys("\b" * 12 + "\n")
    page.wait(lambda: span(page) == whole, "the whole recording")


def a_click_on_a_link_selects_its_joint(page):
    from selenium.webdriver import ActionChains

    def clicked():
        view = page.element("arm-view")
        x, y = page.driver.execute_script(CENTRE, "joint2")
        ActionChains(page.driver).move_to_element_with_offset(view, x, y).click().perform()

    page.repeat(clicked, lambda: "joint 2" in page.text("effects-title"), "the selection")
    page.wait(lambda: "selected" in page.element("joint-2").get_attribute("class"), "the row")


def the_wheel_zooms_and_the_replay_follows(page):
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.actions.wheel_input import ScrollOrigin

    plot = page.element("torque-plot")
    page.driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", plot)
    whole = span(page)

    def turned():
        origin = ScrollOrigin.from_element(page.element("torque-plot"), 0, -60)
        ActionChains(page.driver).scroll_from_origin(origin, 0, -240).perform()

    page.repeat(turned, lambda: width(span(page)) < 0.99 * width(whole), "zoom")
    page.wait(lambda: whole[0] <= page.driver.execute_script(CURSOR) > 0.0, "the cursor")

    zoomed = settled(page)
    assert not page.element("exclude-selection").is_enabled()  # nothing is selected
    assert zoomed[0] - 0.01 <= page.number("instant") <= zoomed[1]
    page.click("whole-recording", done=lambda: span(page) == whole)


def a_peak_of_the_spectrum_is_shown_on_the_arm(page):
    page.wait(lambda: "click a peak" in page.text("spectrum-title"), "the spectrum")
    page.click("spectrum-peak", done=lambda: "largest at" in page.text("spectrum-title"))
    peak = float(page.text("spectrum-title").rpartition("largest at ")[2].split()[0])
    page.wait(lambda: abs(page.number("instant") - peak) < 0.011, "the instant")
    page.driver.execute_script("arguments[0].scrollIntoView()", page.element("spectrum-plot"))
    page.picture("spectrum")
    title = page.text("spectrum-title")

    def clicked():
        plot = page.element("spectrum-plot")
        ActionChains(page.driver).move_to_element_with_offset(plot, -150, 0).click().perform()

    from selenium.webdriver import ActionChains

    page.repeat(clicked, lambda: page.text("spectrum-title") != title, "another peak")


def width(ends):
    return ends[1] - ends[0]


def settled(page):
    """Return the range of the scrubber once no further event of the wheel or a drag changes it."""
    last = []

    def same():
        last.append(span(page))
        return len(last) > SAME and len(set(last[-SAME:])) == 1

    page.wait(same, "the end of the events")
    return last[-1]
