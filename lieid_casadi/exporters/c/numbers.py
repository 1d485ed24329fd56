"""Numbers and operations of exported C in double or single precision."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.errors import ExportError
from lieid_casadi.expressions.c_writer import ARITHMETIC, Dialect

_CONDITIONS = {
    "LT": "{0} < {1} ? 1.0 : 0.0", "LE": "{0} <= {1} ? 1.0 : 0.0",
    "EQ": "{0} == {1} ? 1.0 : 0.0", "NE": "{0} != {1} ? 1.0 : 0.0",
    "NOT": "{0} == 0.0 ? 1.0 : 0.0",
    "AND": "{0} != 0.0 && {1} != 0.0 ? 1.0 : 0.0", "OR": "{0} != 0.0 || {1} != 0.0 ? 1.0 : 0.0",
    "IF_ELSE_ZERO": "{0} != 0.0 ? {1} : 0.0",
}  # fmt: skip
_LIBRARY = ("SIN", "COS", "EXP", "TANH", "SQRT", "FABS")  # all that is used of libm
_RUNTIME = (  # codegen/export/lieid_runtime.h
    "SIGN", "EXPM1", "LOG", "LOG1P", "TAN", "SINH", "COSH", "ASIN", "ACOS", "ATAN", "FLOOR",
    "CEIL",
)  # fmt: skip
_RUNTIME_OF_TWO = ("FMIN", "FMAX", "COPYSIGN", "ATAN2", "HYPOT")


@dataclass(frozen=True)
class Precision:
    """A floating-point type of C.

    Attributes
    ----------
    real : str
        The type, ``double`` or ``float``.
    suffix : str
        Of literals and of functions of the mathematical library.
    tolerance : float
        Error that the self-test accepts, relative to the size of each result.
    """

    real: str
    suffix: str
    tolerance: float

    def number(self, value: float) -> str:
        """Return a number as C reads it back, bit by bit.

        Numbers beyond the range of the type, such as thresholds, become its largest or least.

        Raises `ExportError`: it is infinite or NaN.
        """
        if not math.isfinite(value):
            raise ExportError(f"the fit has a number that is {value}; expected finite ones")
        text = repr(float(value))
        if self.suffix and value != 0.0:
            info = np.finfo(np.float32)
            size = np.float32(np.clip(abs(value), info.tiny, info.max))
            text = f"{'-' if value < 0.0 else ''}{_with_point(str(size))}"
        text += self.suffix
        return f"({text})" if text.startswith("-") else text

    def rounded(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the nearest values of the type."""
        return values.astype(np.float32 if self.suffix else np.float64).astype(np.float64)

    def call(self, name: str) -> str:
        """Return the name of a function of the mathematical library or of the runtime header."""
        return name + self.suffix

    @cached_property
    def dialect(self) -> Dialect:
        """How CasADi's operations are written."""
        functions = {name: f"{self.call(name.lower())}({{0}})" for name in _LIBRARY}
        functions |= {name: f"{self.call('lieid_' + name.lower())}({{0}})" for name in _RUNTIME}
        functions |= {
            name: f"{self.call('lieid_' + name.lower())}({{0}}, {{1}})" for name in _RUNTIME_OF_TWO
        }
        literal = re.compile(r"(?<![\w.])([01]\.0)(?!\w)")
        shared = {
            name: literal.sub(rf"\g<1>{self.suffix}", pattern).replace(
                "lieid_pow(", f"lieid_pow{self.suffix}("
            )
            for name, pattern in (ARITHMETIC | _CONDITIONS).items()
        }
        return Dialect(f"const {self.real}", shared | functions, self.number)


def _with_point(text: str) -> str:
    """Return a number as a floating-point literal: with a point or an exponent."""
    return text if re.search(r"[.e]", text) else f"{text}.0"


DOUBLE = Precision("double", "", 1e-12)
SINGLE = Precision("float", "f", 1e-5)
