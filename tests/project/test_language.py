"""Text that people read is plain technical English: words of metaphors are found and named.

The glossary (docs/reference/glossary.md) has the terms to use in their place.
"""

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
BANNED = {
    r"told|tells?|telling|foretold": "identified, identifiable, distinguished, reported, stated",
    r"speaks? for|spokesm[ae]n": "the simplest of the equivalent candidates",
    r"knows": "has, contains, is given",
    r"nobody knows|known[- ]to": "unknown; state to which function or data",
    r"lives?": "is, is stored, is defined",
    r"rooms?|house": "package, module",
    r"of ours": "lieid-casadi's, or the name of the object",
    r"what remains|what is left(?! out)": "the residual, the error",
    r"is worth": "state the number or the reason",
    r"has to say": "state what it contains",
}
ALLOWED = {
    "`told`": "a former key of JSON files",
    "--room": "a former option",
    ".tell()": "position in a file",
}
FOLDERS = {
    "lieid_casadi": (".py", ".html", ".css", ".yaml", ".jinja"),
    "codegen": (".c", ".h", ".jinja", ".md", ".txt"),
    "examples": (".py", ".md", ".ipynb", ".yaml"),
    "docs": (".md", ".py", ".rst", ".css"),
    "tests": (".py",),
}
PAGES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "pyproject.toml", ".ci/run")
LEFT_OUT = (  # generated files, and the list of words itself
    "docs/_work",
    "docs/_build",
    "docs/effects",
    "docs/examples/find",
    "docs/method/_constants.md",
    "docs/reference/api",
    "docs/reference/cli.rst",
    "tests/project/test_language.py",
)


def files():
    for folder, kinds in FOLDERS.items():
        for path in sorted((ROOT / folder).rglob("*")):
            name = path.relative_to(ROOT).as_posix()
            if path.suffix in kinds and not name.startswith(LEFT_OUT):
                yield path
    yield from (ROOT / page for page in PAGES)


def text_of(path):
    """Return what a file says; of a notebook its source cells, without pictures."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".ipynb":
        return "\n".join("".join(cell["source"]) for cell in json.loads(text)["cells"])
    return text


def found(text, pattern):
    """Return the line numbers and matches of a pattern of whole words."""
    for number, line in enumerate(text.splitlines(), 1):
        for match in re.finditer(rf"\b(?:{pattern})\b", line, re.IGNORECASE):
            around = line[max(0, match.start() - 12) : match.end() + 12].lower()
            if not any(phrase in around for phrase in ALLOWED):
                yield number, match[0], line.strip()


@pytest.mark.parametrize("pattern", BANNED)
def test_no_banned_words(pattern):
    places = [
        f"{path.relative_to(ROOT)}:{number}: {word!r} in: {line}"
        for path in files()
        for number, word, line in found(text_of(path), pattern)
    ]
    assert not places, f"write {BANNED[pattern]} instead:\n" + "\n".join(places)
