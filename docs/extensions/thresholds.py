"""Write the table of the constants in the source, each with the comment that explains it."""

import re
from pathlib import Path

import lieid_casadi

NAME = r"([A-Z][A-Z0-9_]+)(?:: [^=\n]+)? = "
BEHIND = re.compile(rf"^{NAME}([^#\n]{{1,60}}?)  # (.+)$", re.MULTILINE)
ABOVE = re.compile(rf"^((?:#: .+\n)+){NAME}([^#\n]{{1,60}})$", re.MULTILINE)
FIELD = re.compile(r"^((?:    #: .+\n)+)    ([a-z_]+): [^=\n]+ = (.{1,60})$", re.MULTILINE)
PACKAGES = (
    "recording", "effects", "dynamics", "identification", "comparison", "payload", "gains",
    "friction_curves", "excitation", "diagnosis", "discrimination",
)  # fmt: skip


def rows(package):
    """Yield module, name, value and comment of each constant of a package."""
    root = Path(lieid_casadi.__file__).parent
    for path in sorted((root / package).rglob("*.py")):
        text = path.read_text("utf-8")
        module = ".".join(path.relative_to(root).with_suffix("").parts)
        for name, value, comment in BEHIND.findall(text):
            if not comment.startswith(("fmt:", "noqa", "type:")):
                yield module, name, value, comment
        for comment, name, value in (*ABOVE.findall(text), *FIELD.findall(text)):
            if value[-1] in "([{":  # a table that continues on further lines
                continue
            yield module, name, value, " ".join(comment.replace("#:", "").split())


def write(app):
    """Write method/_constants.md, which method/thresholds.md includes."""
    lines = []
    for package in PACKAGES:
        found = [row for row in rows(package) if not row[1].startswith("_")]
        if found:
            lines += [f"## `{package}`", ""]
            lines += ["| constant | value | meaning |", "| --- | --- | --- |"]
        for module, name, value, comment in found:
            cells = [
                f"`{module}.{name}`",
                f"`{value}`",
                comment.replace("|", "\\|").replace("*", "\\*"),
            ]
            lines.append("| " + " | ".join(cells) + " |")
        lines.append("")
    Path(app.srcdir, "method", "_constants.md").write_text("\n".join(lines), "utf-8")


def setup(app):
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True}
