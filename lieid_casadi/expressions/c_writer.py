"""CasADi expressions as C: one statement for each instruction of a function.

CasADi eliminates common subexpressions and orders the work. A `Dialect` states how values are
declared and how operations are written: scalars in exported code, vectors in compiled batches.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache

import casadi as ca

from lieid_casadi.errors import LieidError

#: Operations that every dialect writes in the same way.
ARITHMETIC = {
    "ASSIGN": "{0}", "ADD": "{0} + {1}", "SUB": "{0} - {1}", "MUL": "{0} * {1}", "DIV": "{0} / {1}",
    "NEG": "-{0}", "SQ": "{0} * {0}", "TWICE": "{0} + {0}", "INV": "1.0 / {0}",
    "POW": "lieid_pow({0}, {1})", "CONSTPOW": "lieid_pow({0}, {1})",
}  # fmt: skip


class UnsupportedOperation(LieidError):
    """An expression uses an operation of CasADi that has no C form."""

    def __init__(self, operation: str) -> None:
        super().__init__(f"CasADi's operation {operation} has no C form")
        self.operation = operation


@dataclass(frozen=True)
class Dialect:
    """How C is written."""

    declaration: str  # before the name of a new value, such as const double
    patterns: Mapping[str, str]  # of CasADi's operations, with {0} and {1} for operands
    number: Callable[[float], str]  # returns the C of a constant


@dataclass(frozen=True)
class Input:
    """Element ``index`` of argument ``argument``, the name of its value and its C."""

    argument: int
    index: int
    name: str
    text: str


@dataclass(frozen=True)
class Statements:
    """The statements of a function: ``lines``, of so many ``operations``."""

    inputs: tuple[Input, ...]  # those that are used, in the order of their first use
    lines: tuple[str, ...]
    operations: int


def statements(
    function: ca.Function,
    dialect: Dialect,
    *,
    read: Callable[[int, int], tuple[str, str]],
    write: Callable[[int, str], str],
    inputs_in_place: bool = False,
) -> Statements:
    """Return the C statements that evaluate a function of SX with one vector result.

    ``read``: argument and element → the name of the value and the C that reads it; ``write``:
    element of the result and C of its value → the statement that writes it. ``inputs_in_place``:
    whether ``lines`` declare each input before its first use. Otherwise the caller declares them
    from ``inputs``, before all lines, so that results may overwrite arguments.
    """
    lines: list[str] = []
    inputs: dict[Input, None] = {}  # ordered, each once
    value: dict[int, str] = {}  # CasADi's work vector: what each slot holds now
    unused: dict[int, Input] = {}  # slots with inputs that no statement has used yet
    operations = 0
    for i in range(function.n_instructions()):
        operation = _operation_names()[function.instruction_id(i)]
        target, source = function.instruction_output(i), function.instruction_input(i)
        if operation == "INPUT":
            argument, index = source
            unused[target[0]] = Input(argument, index, *read(argument, index))
            value[target[0]] = unused[target[0]].name
            continue
        if operation == "CONST":
            unused.pop(target[0], None)
            value[target[0]] = dialect.number(function.instruction_constant(i))
            continue
        for slot in source:
            if slot in unused:
                given = unused.pop(slot)
                if inputs_in_place and given not in inputs:
                    lines.append(f"{dialect.declaration} {given.name} = {given.text};")
                inputs[given] = None
        if operation == "OUTPUT":
            lines.append(write(target[1], value[source[0]]))
            continue
        if operation not in dialect.patterns:
            raise UnsupportedOperation(operation)
        text = dialect.patterns[operation].format(*(value[k] for k in source))
        lines.append(f"{dialect.declaration} t{i} = {text};")
        unused.pop(target[0], None)
        value[target[0]] = f"t{i}"
        operations += 1
    return Statements(tuple(inputs), tuple(lines), operations)


@cache
def _operation_names() -> dict[int, str]:
    return {getattr(ca, name): name[3:] for name in dir(ca) if name.startswith("OP_")}
