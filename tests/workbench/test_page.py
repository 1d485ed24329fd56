"""The page in a browser: see where the model fails, find what is missing, add it."""

import lieid_casadi as lieid
from lieid_casadi.tables import figures

# What the pointer can act on, as the elements that must have the focus for it; canvases apart: what
# they do has fields and buttons beside them.
ACTIONS = """
const focusable = 'a[href], button, input, summary, [tabindex]:not([tabindex="-1"])';
const acts = [...document.querySelectorAll('body *')].filter((e) => e.offsetParent
  && getComputedStyle(e).cursor === 'pointer' && !e.closest('canvas, .disabled, [disabled]'));
return [...new Set(acts.map((e) => e.closest(focusable)
  ?? e.closest('.q-field')?.querySelector(focusable) ?? e))];
"""


def test_the_missing_effect_is_found_and_added(start, browse, two_link_files):
    server = start("two_link", *map(str, two_link_files))
    page = browse(server.url)
    page.wait(lambda: page.number("error-1") > 0.0, "the first errors")
    before = page.number("error-1")
    page.wait(lambda: page.text("noise-1").startswith("noise"), "the noise floor")
    assert before > 4.5 * float(page.text("noise-1").split()[-1])  # 4.98 with all digits
    assert page.number("error-2") < before
    assert not page.elements("candidate-load_friction-1")
    the_keyboard_selects_a_joint(page)
    page.click("find-missing")
    page.wait(lambda: page.text("candidate-load_friction-1"), "the proposal")
    assert page.number("error-1") == before  # the search adds nothing by itself
    page.picture("two_link_proposal")
    label = page.text("candidate-load_friction-1").splitlines()[0]
    page.click("candidate-load_friction-1")
    after = float(figures(error_with(label, *two_link_files)))
    page.wait(lambda: page.number("error-1") == after, "the error with the effect")
    assert after < 0.5 * before
    page.wait(lambda: page.elements("effect-load_friction-1"), "the effect")
    page.click("undo")
    page.wait(lambda: page.number("error-1") == before, "undo")
    page.click("redo")
    page.wait(lambda: page.number("error-1") == after, "redo")
    the_first_model_is_compared_with_it(page, before, after)
    the_keyboard_reaches_every_action(page)
    the_atlas_describes_the_effect(page)
    page.check_layout("two_link_added")
    _only_own_requests(page, server)
    assert page.script_errors() == []
    assert server.stop() == (0, "")


def the_keyboard_selects_a_joint(page):
    """Enter and space select the joint that has the focus; it keeps it when it is drawn again."""
    for joint, key in (("joint-2", "\n"), ("joint-1", " ")):
        page.driver.execute_script("arguments[0].focus()", page.element(joint))
        page.driver.switch_to.active_element.send_keys(key)
        page.wait(lambda j=joint: "selected" in page.element(j).get_attribute("class"), joint)
        assert page.driver.switch_to.active_element.get_attribute("data-testid") == joint


def the_keyboard_reaches_every_action(page):
    """Tab visits all buttons, fields, joints, findings, steps and effects that can be seen."""
    actions, seen = page.driver.execute_script(ACTIONS), set()
    assert len(actions) > 25
    page.driver.execute_script("document.activeElement.blur()")
    for _ in range(3 * len(actions)):
        active = page.driver.switch_to.active_element
        seen.add(active)
        active.send_keys("\t")
        if seen.issuperset(actions):
            break
    missed = [e.get_attribute("outerHTML")[:120] for e in actions if e not in seen]
    assert missed == []


def the_first_model_is_compared_with_it(page, before, after):
    """The table has the numbers of the page, and the effect that one model lacks."""
    page.click("compare-1", done=lambda: page.elements("compared-1"))
    page.wait(lambda: "load_friction:1 – f_tau" in page.text("difference-table"), "the table")
    joint = page.text("difference-table").split("model 1 model 2 change\n1 ")[1].split()
    assert [float(figures(float(number))) for number in joint[:2]] == [before, after]
    page.click("compare-1", done=lambda: not page.elements("compared-1"))


def the_atlas_describes_the_effect(page):
    """The link of an effect opens its page, which the server serves."""
    page.driver.execute_script("scrollTo(0, 0)")  # the toolbar covers what is scrolled below it
    page.click("atlas-load_friction-1", done=lambda: len(page.driver.window_handles) > 1)
    first, atlas = page.driver.window_handles[:2]
    page.driver.switch_to.window(atlas)
    page.wait(lambda: "revealed by" in page.driver.page_source, "the description")
    page.driver.close()
    page.driver.switch_to.window(first)


def error_with(label, train, test):
    """Return the error of joint 1 with an effect, by the public functions."""
    model = lieid.Model(lieid.robots.two_link(), "coulomb,viscous,offset")
    train, test = lieid.Recording.load(train), lieid.Recording.load(test)
    first = lieid.identify(model, train)
    fit = lieid.identify(model.with_effect(label), train, processing=first.processing)
    return lieid.compare(fit, test).rms_moving[0]


def _only_own_requests(page, server):
    """Check that the browser asked no other machine for anything."""
    import json

    own = (f"http://127.0.0.1:{server.port}/", f"ws://127.0.0.1:{server.port}/", "data:", "blob:")
    log = [json.loads(e["message"])["message"] for e in page.driver.get_log("performance")]
    urls = [
        m["params"].get("request", m["params"]).get("url", "")
        for m in log
        if m["method"] in ("Network.requestWillBeSent", "Network.webSocketCreated")
    ]
    assert len(urls) > 5
    assert [url for url in urls if not url.startswith((*own, "chrome:"))] == []
