"""The array type of signals, columns and parameters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Floating-point numbers; shapes are stated where the array is documented.
Array = NDArray[np.float64]
#: True and False.
Mask = NDArray[np.bool_]
#: Positions in an array.
Indices = NDArray[np.intp]
