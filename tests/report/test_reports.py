"""Reports: one file that loads nothing and executes nothing from names."""

import csv
from base64 import b64decode
from dataclasses import replace
from html.parser import HTMLParser

import pytest
from comparison import two_link_data as arm

import lieid_casadi as lieid
from lieid_casadi.comparison.comparison import HEADINGS
from lieid_casadi.diagnosis.extend import extend
from lieid_casadi.errors import LieidWarning
from lieid_casadi.report import (
    comparison_report,
    extension_report,
    premises_report,
    render,
)
from lieid_casadi.report.page import table_section
from lieid_casadi.report.reports import extension_tables
from lieid_casadi.tables import figures, value_text

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
        if name == "href":  # within the page, or a file that the page contains
            assert value.startswith(("#", "data:text/csv;charset=utf-8;base64,")), tag
        elif name in FETCHING:
            assert value.startswith("data:image/png;base64,"), (tag, name)
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
    assert not any("example.org" in link for link in page.values("href"))
    assert "onerror" not in [name for _, name, _ in page.attributes]
    assert page.tags.count("img") == 2
    text = "".join(page.text)
    assert EVIL in text
    assert str(warning) in text
    turned = Page(render("\u202eturned", [table_section("", sentences=["a\x1b\u2066b"])]))
    assert r"\u202eturned" in turned.text
    assert r"a\u001b\u2066b" in "".join(turned.text)


def test_every_table_can_be_saved_as_csv(page, comparison):
    files = [b64decode(h.partition(",")[2]).decode() for h in page.values("href") if h[0] != "#"]
    assert len(files) == page.tags.count("table")
    assert len(set(page.values("download"))) > 1
    rows = list(csv.reader(files[0].splitlines()))
    assert rows[0] == list(HEADINGS)
    assert [float(row[1]) for row in rows[1:]] == pytest.approx(comparison.rms_moving, rel=5e-3)
    assert rows[1][4] == ""  # joint 1 never rests


def test_an_extended_fit_and_premises_have_reports(fit):
    _, q, _, _ = arm.motion(12.0, seed=3)
    train = arm.recording(12.0, seed=3, noise=0.1, extra=2.0 * q, name="train")
    extension = extend(fit, "position_spring", train)
    page = Page(extension_report(extension))
    text = " ".join(page.text)
    assert "On unseen motion the error" in text
    assert "New parameters" in text
    # one number has the same digits in every table
    (row, *_), (parameter, *_) = (table.cells for table in extension_tables(extension))
    assert row[1:3] == [figures(errors[0]) for errors in extension.held_out]
    (own,) = {text for text in page.text if text == parameter[1]}
    assert own == value_text(*(extension.parameters[0][k] for k in ("value", "std")))
    turned = replace(train, tau=-train.tau)
    found = lieid.check(fit.model.robot, turned)
    text = " ".join(Page(premises_report(fit.model.robot, found)).text)
    assert found.findings
    assert found.findings[0].sentence in text
    assert found.findings[0].remedy in text
    text = " ".join(
        Page(premises_report(fit.model.robot, lieid.check(fit.model.robot, train))).text
    )
    for premise, why in lieid.check(fit.model.robot, train).not_checkable:
        assert premise in text
        assert f"not checked: {why}" in text


def test_effects_are_described_from_their_definitions(page, fit):
    text = " ".join(page.text)
    for placement in fit.model.placements:
        assert placement.effect.formula.replace("_", "") in "".join(page.text)
        assert placement.effect.revealed_by in text
    ids = page.values("id")
    assert {f"effect-{p.effect.label}" for p in fit.model.placements} <= set(ids)
    assert {link[1:] for link in page.values("href") if link.startswith("#")} <= set(ids)
