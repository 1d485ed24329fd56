"""API reference: one page a room, made from the docstrings."""

import importlib
import pkgutil
import re
from pathlib import Path

import lieid_casadi

project = "lieid-casadi"
author = "The lieid-casadi developers"
copyright = author
version = release = lieid_casadi.__version__

extensions = ["sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax"]
exclude_patterns = ["_build"]
html_theme = "alabaster"
html_theme_options = {"description": "Identification and diagnosis of robot arm dynamics"}
html_sidebars = {"**": ["about.html", "navigation.html", "searchbox.html"]}
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_type_aliases = {"ArrayLike": "ArrayLike", "NDArray": "NDArray"}
autodoc_mock_imports = ["rosbags", "pyarrow", "pandas"]
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_param = False  # shapes such as (n,) stand where types do, and are not names to link
napoleon_use_rtype = False
suppress_warnings = ["ref.python"]  # the same, for attributes

# In the order in which data flows; what is not named comes after, by name.
ORDER = (
    "robots",
    "robot",
    "dynamics",
    "effects",
    "model",
    "compiled",
    "excitation",
    "recording",
    "identification",
    "comparison",
    "diagnosis",
    "discrimination",
    "payload",
    "gains",
    "report",
    "plant",
    "errors",
)
LEFT_OUT = ("cli",)  # `lieid --help` is its reference


def _modules(room):
    module = importlib.import_module(f"lieid_casadi.{room}")
    inside = pkgutil.iter_modules(getattr(module, "__path__", []))
    return [f"lieid_casadi.{room}", *(f"lieid_casadi.{room}.{each.name}" for each in inside)]


def _page(room):
    lines = [room, "=" * len(room), ""]
    for name in _modules(room):
        if name.rsplit(".", 1)[1].startswith("_"):
            continue
        is_room = name.count(".") == 1
        if not is_room:
            lines += [name, "-" * len(name), ""]
        lines += [f".. automodule:: {name}", ""]
        if not (is_room and len(_modules(room)) > 1):
            # A room's __init__ only repeats names of its files: its docstring is enough.
            lines.insert(-1, "   :members:")
    return "\n".join(lines) + "\n"


def write_rooms(_app):
    """Write one page a room, so that a new file cannot be forgotten."""
    found = [each.name for each in pkgutil.iter_modules(lieid_casadi.__path__)]
    rooms = [name for name in found if name not in LEFT_OUT and not name.startswith("_")]
    rooms.sort(key=lambda name: (ORDER.index(name) if name in ORDER else len(ORDER), name))
    folder = Path(__file__).parent / "rooms"
    folder.mkdir(exist_ok=True)
    for stale in folder.glob("*.rst"):
        stale.unlink()
    for room in rooms:
        (folder / f"{room}.rst").write_text(_page(room), encoding="utf-8")
    toctree = ["Rooms", "=====", "", ".. toctree::", "   :maxdepth: 1", ""]
    toctree += [f"   {room}" for room in rooms]
    (folder / "index.rst").write_text("\n".join(toctree) + "\n", encoding="utf-8")


def keep_bars(_app, _what, _name, _obj, _options, lines):
    """Make |q| an absolute value, which reStructuredText would take for a substitution."""
    bars = re.compile(r"(``.*?``)|\|(?=\S)([^|`]*?\S)\|")
    lines[:] = [bars.sub(lambda m: m[1] or rf"\|{m[2]}\|", line) for line in lines]


def setup(app):
    app.connect("builder-inited", write_rooms)
    app.connect("autodoc-process-docstring", keep_bars)
