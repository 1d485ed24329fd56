"""The plant shares no dynamics and no effects with the rest, so that mistakes show."""

import ast
from pathlib import Path

import pytest

import lieid_casadi.plant

ALLOWED = tuple(f"lieid_casadi.{room}" for room in ("plant", "robot", "recording", "errors"))
FILES = sorted(Path(lieid_casadi.plant.__file__).parent.glob("*.py"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_imports(file):
    found = []
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom):
            found.append(node.module or "")
            assert node.level == 0
        elif isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
    own = [name for name in found if name.startswith("lieid_casadi")]
    assert all(name.startswith(ALLOWED) for name in own), own
    assert not any(name.startswith("casadi") for name in found)
