"""The public functions and methods describe each of their arguments."""

import inspect
import re

import lieid_casadi


def public_functions():
    """Yield name, function and its documentation: of a method also that of the class."""
    for name in lieid_casadi.__all__:
        each = getattr(lieid_casadi, name)
        if inspect.isfunction(each):
            yield name, each, each.__doc__ or ""
        if not inspect.isclass(each) or issubclass(each, Exception):
            continue
        shared = inspect.getdoc(each) or ""
        for method, member in inspect.getmembers(each):
            function = getattr(member, "__func__", member)
            own = str(getattr(function, "__module__", "")).startswith("lieid_casadi")
            if inspect.isfunction(function) and own and not method.startswith("_"):
                text = inspect.getdoc(getattr(each, method)) or ""
                if not text.startswith("See `"):  # the place that describes them
                    yield f"{name}.{method}", function, f"{text}\n{shared}"


def undescribed():
    for name, function, text in public_functions():
        arguments = [
            parameter.name
            for parameter in inspect.signature(function).parameters.values()
            if parameter.kind is not parameter.VAR_KEYWORD and parameter.name not in ("self", "cls")
        ]
        if len(arguments) >= 3:
            yield from (
                f"{name}: {argument}"
                for argument in arguments
                if not re.search(rf"\b{argument}\b", text)
            )


def test_public_functions_with_three_or_more_arguments_describe_them():
    lacking = list(undescribed())
    assert not lacking, "\n".join(lacking)
