"""Docstrings of public functions state their parameters, with shapes and units."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "lieid_casadi"
FEWEST = 3  # arguments from which on a Parameters section is required
LEFT_OUT = ("cli",)  # its functions take the parsed command line


def public_functions(tree):
    """Yield name, node and whether a base class may document it; private ones are left out."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            yield node.name, node, False
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            for method in node.body:
                if isinstance(method, ast.FunctionDef) and not method.name.startswith("_"):
                    yield f"{node.name}.{method.name}", method, bool(node.bases)


def arguments(function):
    names = [a.arg for a in (*function.args.posonlyargs, *function.args.args)]
    names += [a.arg for a in function.args.kwonlyargs]
    return [name for name in names if name not in ("self", "cls")]


def documented(function):
    text = ast.get_docstring(function) or ""
    return "Parameters\n---" in text or text.startswith("See `")  # the place that has the section


def lacking():
    """Return the functions without the section; methods of base classes document overrides."""
    found, inherited = [], set()
    for path in sorted(PACKAGE.rglob("*.py")):
        module = path.relative_to(PACKAGE)
        if module.parts[0] in LEFT_OUT:
            continue
        for name, function, derived in public_functions(ast.parse(path.read_text("utf-8"))):
            if documented(function):
                inherited.add(function.name)
            elif len(arguments(function)) >= FEWEST:
                found.append(
                    (f"lieid_casadi/{module}:{function.lineno}: {name}", function, derived)
                )
    return [
        place for place, function, derived in found if not (derived and function.name in inherited)
    ]


def test_functions_with_three_or_more_arguments_have_a_parameters_section():
    places = lacking()
    assert not places, "\n".join(places)
