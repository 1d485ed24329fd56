"""CasADi functions as files: serialized, or as C."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import casadi as ca

from lieid_casadi.errors import ModelError


def write_functions(path: Path, functions: Sequence[ca.Function]) -> None:
    """Write functions into one file by its suffix, ``.casadi`` or ``.c``.

    Raises `ModelError` if the name ends in neither.
    """
    from lieid_casadi.atomic_file import atomic_binary

    if path.suffix not in (".casadi", ".c"):
        raise ModelError(f"{path}: expected a name that ends in .casadi or .c")
    with tempfile.TemporaryDirectory() as scratch:
        made = Path(scratch) / f"{path.stem}{path.suffix}"
        if path.suffix == ".casadi":
            serializer = ca.FileSerializer(str(made))
            for function in functions:
                serializer.pack(function)
            del serializer  # closes the file
        else:
            generator = ca.CodeGenerator(made.name, {"with_header": False})
            for function in functions:
                generator.add(function)
            generator.generate(f"{scratch}/")
        with atomic_binary(path) as file:
            file.write(made.read_bytes())
