"""Write the API reference: the public names, and one page for each package."""

import importlib
import pkgutil
import re
from pathlib import Path

import lieid_casadi

# In the order of the layers; packages that are not named follow by name.
ORDER = (
    "errors", "robot", "robots", "recording", "dynamics", "effects", "model", "expressions",
    "compiled", "identification", "excitation", "comparison", "payload", "gains",
    "friction_curves", "diagnosis", "discrimination", "experiments", "demo", "exporters",
    "report", "plant",
)  # fmt: skip
LEFT_OUT = ("cli",)  # reference/cli.rst is generated from its parser
BARS = re.compile(r"(``.*?``)|\|(?=\S)([^|`]*?\S)\|")


def packages():
    """Return the names of packages and modules directly below lieid_casadi."""
    names = [each.name for each in pkgutil.iter_modules(lieid_casadi.__path__)]
    names = [name for name in names if name not in LEFT_OUT and not name.startswith("_")]
    last = len(ORDER)
    return sorted(names, key=lambda n: (ORDER.index(n) if n in ORDER else last, n))


def modules(name):
    """Return a package and every module below it, depth first."""
    full = f"lieid_casadi.{name}"
    module = importlib.import_module(full)
    below = pkgutil.walk_packages(getattr(module, "__path__", []), full + ".")
    return [full, *(each.name for each in below if not each.name.rsplit(".")[-1].startswith("_"))]


def package_page(name):
    """Return the page of one package as reStructuredText."""
    lines = [name, "=" * len(name), ""]
    for full in modules(name):
        is_package = hasattr(importlib.import_module(full), "__path__")
        if full.count(".") > 1:
            underline = "-" if full.count(".") == 2 else "~"
            title = full.removeprefix("lieid_casadi.")
            lines += [title, underline * len(title), ""]
        lines += [f".. automodule:: {full}"]
        if not is_package:  # a package's __init__ repeats names of its modules
            lines += ["   :members:"]
        lines += [""]
    return "\n".join(lines) + "\n"


def public_page():
    """Return the page of the names in ``lieid_casadi.__all__``."""
    title = "Public names"
    lines = [
        title, "=" * len(title), "",
        "These names are imported from ``lieid_casadi``. Semantic versioning applies to them, to",
        "the command line, to the file formats and to the keys of JSON files.", "",
        ".. code-block:: python", "", "   import lieid_casadi as lieid", "",
    ]  # fmt: skip
    names = [n for n in lieid_casadi.__all__ if not n.startswith("_") and n != "robots"]
    kinds = {name: getattr(lieid_casadi, name) for name in names}
    for heading, wanted in (("Functions", False), ("Classes and errors", True)):
        lines += [heading, "-" * len(heading), ""]
        for name, value in sorted(kinds.items(), key=lambda item: item[0].lower()):
            if isinstance(value, type) is wanted:
                directive = "autofunction"
                if wanted:
                    directive = "autoexception" if issubclass(value, Exception) else "autoclass"
                lines += [f".. {directive}:: lieid_casadi.{name}"]
                lines += ["   :members:", ""] if wanted else [""]
    lines += ["Bundled robots", "--------------", "", ".. automodule:: lieid_casadi.robots"]
    return "\n".join([*lines, "   :members:", "   :no-index:", ""])


def write(app):
    """Write all pages below reference/api."""
    folder = Path(app.srcdir, "reference", "api")
    folder.mkdir(exist_ok=True)
    names = packages()
    pages = {name: package_page(name) for name in names} | {"public": public_page()}
    entries = "\n".join(f"   {name}" for name in names)
    pages["index"] = (
        "API reference\n=============\n\n"
        "The public names first, then every package in the order of the layers (see "
        "``CONTRIBUTING.md``).\nOnly the public names are covered by semantic versioning.\n\n"
        f".. toctree::\n   :maxdepth: 1\n\n   public\n{entries}\n"
    )
    for stale in folder.glob("*.rst"):
        if stale.stem not in pages:
            stale.unlink()
    for name, text in pages.items():
        path = folder / f"{name}.rst"
        if not path.exists() or path.read_text("utf-8") != text:
            path.write_text(text, "utf-8")


def keep_bars(_app, _what, _name, _obj, _options, lines):
    """Keep |q| an absolute value, which reStructuredText would read as a substitution."""
    lines[:] = [BARS.sub(lambda m: m[1] or rf"\|{m[2]}\|", line) for line in lines]


def setup(app):
    app.connect("builder-inited", write)
    app.connect("autodoc-process-docstring", keep_bars)
    return {"parallel_read_safe": True}
