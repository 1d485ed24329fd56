"""Docstrings of public functions state their parameters, with shapes and units."""

import ast
from pathlib import Path

import lieid_casadi

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "lieid_casadi"
FEWEST = 3  # arguments from which on a Parameters section is required
PUBLIC = set(lieid_casadi.__all__)  # classes
LEFT_OUT = ("cli",)  # its functions take the parsed command line


def public_functions(tree):
    """Yield the public functions of a module, and the methods of its public classes.

    Methods without a docstring of their own, or with "See …", are documented in their base class.
    """
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            yield node.name, node
        if isinstance(node, ast.ClassDef) and node.name in PUBLIC:
            for method in node.body:
                if isinstance(method, ast.FunctionDef) and not method.name.startswith("_"):
                    yield f"{node.name}.{method.name}", method


def arguments(function):
    names = [a.arg for a in (*function.args.posonlyargs, *function.args.args)]
    names += [a.arg for a in function.args.kwonlyargs]
    return [name for name in names if name not in ("self", "cls")]


def lacking():
    for path in sorted(PACKAGE.rglob("*.py")):
        module = path.relative_to(PACKAGE)
        if module.parts[0] in LEFT_OUT:
            continue
        for name, function in public_functions(ast.parse(path.read_text("utf-8"))):
            text = ast.get_docstring(function) or ""
            if not text or text.startswith("See "):
                continue
            if len(arguments(function)) >= FEWEST and "Parameters\n---" not in text:
                yield f"lieid_casadi/{module}:{function.lineno}: {name}"


def test_functions_with_three_or_more_arguments_have_a_parameters_section():
    places = list(lacking())
    assert not places, "\n".join(places)
