"""Docstrings of the public API state their parameters, with shapes and units."""

import inspect
import re

import pytest

import lieid_casadi as lieid

FEWEST = 3  # arguments from which on a Parameters section is required


def functions(name):
    """Yield name and function: the public object itself, or the public methods of a class."""
    found = getattr(lieid, name)
    if inspect.isfunction(found):
        yield name, found
    if inspect.isclass(found):
        for method, value in inspect.getmembers(found):
            function = inspect.unwrap(getattr(value, "__func__", value))
            own = inspect.isfunction(function) and function.__module__.startswith("lieid_casadi")
            if own and not method.startswith("_"):
                yield f"{name}.{method}", function


@pytest.mark.parametrize("name", [n for n in lieid.__all__ if n not in ("__version__", "robots")])
def test_public_functions_with_three_or_more_arguments_have_a_parameters_section(name):
    assert (inspect.getdoc(getattr(lieid, name)) or "").strip()
    for place, function in functions(name):
        text = inspect.getdoc(function) or ""
        assert text, place
        arguments = [
            a.name
            for a in inspect.signature(function).parameters.values()
            if a.name not in ("self", "cls") and a.kind is not a.VAR_KEYWORD
        ]
        shared = inspect.getdoc(getattr(lieid, name)) if "." in place else ""  # for all methods
        if len(arguments) >= FEWEST and not all(
            re.search(rf"\b{argument}\b", f"{text}\n{shared}") for argument in arguments
        ):
            assert "Parameters\n---" in text or text.startswith("See `"), place
