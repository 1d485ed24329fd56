"""Reports: one file that loads nothing and executes nothing from names."""

import re
from base64 import b64decode
from dataclasses import replace
from html.parser import HTMLParser

import pytest
from comparison import two_link_data as arm

import lieid_casadi as lieid
from lieid_casadi.errors import LieidWarning
from lieid_casadi.report import comparison_report, fit_report, render
from lieid_casadi.report.page import table_section
from lieid_casadi.report.reports import anchors, fit_sections, value_text

EVIL = "<script>alert(1)</script>"
FETCHING = {"src", "href", "srcset", "data", "action", "poster", "background", "xlink:href"}


class Page(HTMLParser):
    """Tags, attributes and visible text of a page."""

    def __init__(self, html):
        super().__init__()
        self.tags, self.attributes, self.text, self.style = [], [], [], ""
        self._inside = ""
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, name, value) for name, value in attrs]
        self._inside = tag

    def handle_endtag(self, tag):
        self._inside = ""

    def handle_data(self, data):
        if self._inside == "style":
            self.style += data
        else:
            self.text.append(data)

    def values(self, name):
        return [value for _, key, value in self.attributes if key == name]


@pytest.fixture(scope="module")
def fit():
    return arm.fit()


@pytest.fixture(scope="module")
def comparison(fit):
    return lieid.compare(fit, arm.recording(12.0, seed=2, noise=0.2, name="monday.csv"))


@pytest.fixture(scope="module")
def page(fit, comparison):
    return Page(comparison_report(fit, comparison))


def test_a_report_fetches_nothing(page):
    for tag, name, value in page.attributes:
        if name == "href":
            assert value.startswith("#"), tag  # within the page
        elif name in FETCHING:
            assert value.startswith("data:image/png;base64,"), (tag, name)
        if name == "style":
            assert re.fullmatch(r"--part: [\d.]+%", value)
    assert not {"script", "link", "iframe", "object", "embed", "base"} & set(page.tags)
    assert "url(" not in page.style
    assert "@import" not in page.style
    (policy,) = (v for v in page.values("content") if "default-src" in (v or ""))
    assert "default-src 'none'" in policy


def test_pictures_are_inside(page):
    pictures = [b64decode(uri.split(",", 1)[1]) for uri in page.values("src")]
    assert len(pictures) == 2
    for png in pictures:
        assert png.startswith(b"\x89PNG\r\n\x1a\n")
        width = int.from_bytes(png[16:20], "big")
        assert width > 1000
    assert all(page.values("alt"))


def test_verdict_comes_first_and_numbers_follow(page, comparison):
    text = " ".join(" ".join(page.text).split())
    verdict = text.index("monday.csv (11 s): the error in motion is")
    assert verdict < text.index("Warnings") < text.index("Error per joint")
    for rms in comparison.rms:
        assert f"{rms:.3g}" in text
    for source in comparison.recordings:
        assert source.sha256 in text


def test_names_are_text(fit, comparison):
    robot = fit.model.robot
    joints = tuple(replace(joint, name=EVIL) for joint in robot.joints)
    model = lieid.Model(replace(robot, name=EVIL, joints=joints), arm.EFFECTS)
    warning = LieidWarning('"><img src=x onerror=alert(1)>')
    evil_fit = replace(fit, model=model, warnings=(warning,))
    sources = tuple(replace(s, name="<a href='http://example.org'>") for s in comparison.recordings)
    worst = tuple(replace(moment, recording=EVIL) for moment in comparison.worst)
    evil = replace(
        comparison, joint_names=(EVIL, EVIL), recordings=sources, worst=worst, warnings=(warning,)
    )
    page = Page(comparison_report(evil_fit, evil))
    assert "script" not in page.tags
    assert "a" not in page.tags
    assert "onerror" not in [name for _, name, _ in page.attributes]
    assert page.tags.count("img") == 2
    text = "".join(page.text)
    assert EVIL in text
    assert str(warning) in text
    turned = Page(render("\u202eturned", [table_section("", sentences=["a\x1b\u2066b"])]))
    assert r"\u202eturned" in turned.text
    assert r"a\u001b\u2066b" in "".join(turned.text)


def test_effects_are_described_from_their_definitions(page, fit):
    text = " ".join(page.text)
    for placement in fit.model.placements:
        assert placement.effect.formula.replace("_", "") in "".join(page.text)
        assert placement.effect.revealed_by in text
    ids = page.values("id")
    assert {f"effect-{p.effect.label}" for p in fit.model.placements} <= set(ids)
    assert {link.removeprefix("#") for link in page.values("href")} <= set(ids)


def test_a_fit_without_a_test_has_a_report_too(fit):
    page = Page(fit_report(fit))
    text = " ".join(page.text)
    assert "cross-validated" in text
    assert "Error per joint" not in text
    for name in ("coulomb.f_c", "viscous.f_v"):
        assert name in text


def test_sections_join_in_their_order_and_fold():
    sections = [
        table_section("First", sentences=["one & only"]),
        table_section("Second", sentences=["two"], folded=True),
    ]
    html = render("a < b", sections)
    page = Page(html)
    assert "one &amp; only" in html
    text = " ".join(page.text)
    assert text.index("First") < text.index("one & only") < text.index("Second")
    assert page.tags.count("details") == 1
    assert page.values("id") == ["section-1", "section-2"]
    assert "a < b" in text


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (12.3456, 0.021, "12.346"),
        (-0.00001, 0.1, "0.00"),
        (1234.5, 30.0, "1234"),
        (1234.5, 130.0, "1234"),
        (0.5, None, "0.5"),
        (0.5, 0.0, "0.5"),
    ],
)
def test_digits_follow_the_standard_deviation(value, std, text):
    assert value_text(value, std) == text


def test_effects_that_the_fit_does_not_have_are_described_if_they_are_named(fit):
    page = Page(render("x", fit_sections(fit, named=["presliding", "stribeck/two_width", "no"])))
    ids = page.values("id")
    assert {"effect-presliding", "effect-stribeck-two_width", "effect-coulomb"} <= set(ids)
    assert "effect-no" not in ids
    assert anchors(["presliding", "no"]) == {"presliding": "effect-presliding"}
