"""What stays unexplained, with its shape and a formula."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from lieid_casadi.diagnosis.form import form_of
from lieid_casadi.diagnosis.remainder import Remainder
from lieid_casadi.diagnosis.shapes import shapes_of
from lieid_casadi.diagnosis.unexplained import Unexplained


def described(left: Sequence[Unexplained], remainder: Remainder) -> tuple[Unexplained, ...]:
    """Return unexplained parts with their shapes, and a formula where a short one is found."""
    return tuple(
        replace(u, shapes=shapes_of(u, remainder), form=form_of(u, remainder)) for u in left
    )
