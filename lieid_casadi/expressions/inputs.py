"""Inputs of symbolic functions beside the motion: parameters, and symbols of the geometry."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from lieid_casadi.arrays import Array
from lieid_casadi.errors import ModelError
from lieid_casadi.model import Model
from lieid_casadi.robot.robot import Robot

INPUT_NAMES = (
    "q", "dq", "ddq", "tau", "load", "states", "temperature", "time", "payload", "parameters",
    "effects", "shapes", "x", "xdot", "u",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Values:
    """Link parameters (10 n,), effect coefficients (m,) and shapes (s,): numbers or symbols.

    ``temperature_mean`` (n,) in °C is subtracted from the temperature; None: it is relative.
    """

    parameters: ca.SX
    effects: ca.SX
    shapes: ca.SX
    numeric: bool
    temperature_mean: Array | None = None

    @classmethod
    def numbers(
        cls,
        parameters: Array,
        effects: Array,
        shapes: Array,
        temperature_mean: Array | None = None,
    ) -> Values:
        """Return constants.

        ``parameters`` (10 n,): link parameters, SI; ``effects`` (m,): effect coefficients;
        ``shapes`` (s,): shape parameters; ``temperature_mean`` (n,): mean temperature of the
        training recordings, °C.
        """
        links, coefficients, shape = (ca.SX(ca.DM(x)) for x in (parameters, effects, shapes))
        return cls(links, coefficients, shape, True, temperature_mean)

    @classmethod
    def symbols(cls, model: Model, temperature_mean: Array | None = None) -> Values:
        """Return symbols in the sizes of a model."""
        links = ca.SX.sym("parameters", 10 * model.n)
        coefficients = ca.SX.sym("effects", len(model.columns))
        shapes = ca.SX.sym("shapes", len(model.shapes))
        return cls(links, coefficients, shapes, False, temperature_mean)

    @property
    def inputs(self) -> dict[str, ca.SX]:
        """The symbols among them by name, those of size 0 left out."""
        if self.numeric:
            return {}
        named = {"parameters": self.parameters, "effects": self.effects, "shapes": self.shapes}
        return {name: symbol for name, symbol in named.items() if symbol.size1()}


def geometry_inputs(robot: Robot) -> dict[str, ca.SX]:
    """Return the symbols of a robot's geometry by name.

    Raises `ModelError`: a symbol has the name of an input of the functions.
    """
    clash = [str(symbol) for symbol in robot.symbols if str(symbol) in INPUT_NAMES]
    if clash:
        raise ModelError(
            f"robot {robot.name!r}: the symbol {clash[0]!r} has the name of an input of the "
            "functions; expected another name"
        )
    return {str(symbol): symbol for symbol in robot.symbols}
