"""Information of a motion about the parameters: the Gram matrix of the base regressor."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from lieid_casadi.dynamics import recursion
from lieid_casadi.dynamics.lie import Motion as Symbols
from lieid_casadi.dynamics.regressor import regressor
from lieid_casadi.effects.signals import EffectSignals
from lieid_casadi.errors import ExcitationError
from lieid_casadi.excitation.basis.trajectory import MotionSamples
from lieid_casadi.excitation.criteria.design_model import follows_from_motion
from lieid_casadi.excitation.fitted_arm import FittedArm, load_parameters, shapes_of
from lieid_casadi.excitation.sample_functions import SampleKernel, reverse_derivative
from lieid_casadi.model import Model

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class StackedRegressor:
    """Base regressor Y_b of N samples, transposed: rows (p, n·N), one per base parameter."""

    motion: MotionSamples
    rows: Array

    def gram(self) -> Array:
        """Return YᵀY (p, p)."""
        return np.asarray(self.rows @ self.rows.T)


class InformationMatrix:
    """The base regressor of [Y, effect columns] along a motion, and gradients through it.

    The signs of velocities are smooth here, sgn(q̇) ≈ tanh(q̇/width), so that gradients exist. The
    quality of a design is evaluated with the model's own, sharp columns (see `quality`).

    Parameters
    ----------
    model : Model
    sign_width : (n,)
        Width of the smooth sign, rad/s.
    fit : FittedArm, optional
        Shape parameters, and link parameters for effects of the load. Default: the stated ones.

    Raises
    ------
    ExcitationError
        An effect whose columns do not follow from the motion and the time of one instant; see
        `design_model`.
    """

    def __init__(self, model: Model, *, sign_width: Array, fit: FittedArm | None = None) -> None:
        self.model = model
        symbols = Symbols.symbols(model.n)
        time = ca.SX.sym("time")
        self._timed = any("time" in p.effect.signals for p in model.placements)
        further = {"time": time} if self._timed else {}
        matrix = base_regressor(model, symbols, sign_width, time, fit)
        kept = model.base.count
        self._values = SampleKernel("base_columns", symbols, matrix, further)
        seed = ca.SX.sym("seed", len(self._values.rows))
        # nonzeros in the kernel's order: row after row
        flat = ca.vertcat(
            *(
                matrix[int(i), int(j)]
                for i, j in zip(self._values.rows, self._values.columns, strict=True)
            )
        )
        reverse = reverse_derivative(flat, seed, symbols)
        self._reverse = SampleKernel(
            "base_columns_reverse", symbols, reverse, {"seed": seed, **further}
        )
        self._columns, self._rows = self._values.columns, self._values.rows
        self.size = kept

    def at(self, motion: MotionSamples) -> StackedRegressor:
        """Return the stacked base regressor of a motion."""
        n, samples = self.model.n, len(motion)
        stacked = np.zeros((self.size, n, samples))
        stacked[self._columns, self._rows] = self._values.values(motion, **self._time(motion))
        return StackedRegressor(motion, stacked.reshape(self.size, n * samples))

    def gradient(self, stacked: StackedRegressor, slope: Array) -> Array:
        """Return the gradient of a function f(G) with respect to the motion.

        Parameters
        ----------
        stacked : StackedRegressor
        slope : (p, p)
            ∂f/∂G, symmetric.

        Returns
        -------
        (n, 3, N)
            ∂f/∂(q, dq, ddq).
        """
        n, samples = self.model.n, len(stacked.motion)
        seeds = (2.0 * slope @ stacked.rows).reshape(self.size, n, samples)
        seed = np.ascontiguousarray(seeds[self._columns, self._rows].T)
        reverse = self._reverse.dense(stacked.motion, seed=seed, **self._time(stacked.motion))[
            :, 0, :
        ]
        return np.ascontiguousarray(reverse.reshape(3, n, samples).transpose(1, 0, 2))

    def _time(self, motion: MotionSamples) -> dict[str, Array]:
        return {"time": motion.t[:, None]} if self._timed else {}


def base_regressor(
    model: Model, symbols: Symbols, sign_width: Array, time: ca.SX, fit: FittedArm | None = None
) -> ca.SX:
    """Return the base columns (n, p) of [Y, effect columns] with a smooth sign.

    Parameters
    ----------
    model : Model
    symbols : Symbols
        Of the motion.
    sign_width : (n,)
        Width of the smooth sign, rad/s.
    time : SX
        Symbol of the time, s.
    fit : FittedArm, optional
        See `InformationMatrix`.
    """
    unreachable = [p.label for p in model.placements if not follows_from_motion(p.effect)]
    if unreachable:
        raise ExcitationError(
            f"{', '.join(unreachable)}: depends on temperature, the past or the whole arm, "
            "not on the motion of one instant; leave it out of the design"
        )
    n = model.n
    sign = ca.tanh(symbols.dq / ca.DM(sign_width))
    load = ca.SX(n, 1)
    if any("load" in p.effect.signals for p in model.placements):
        parameters = ca.SX(ca.DM(load_parameters(model, fit)))
        load = recursion.inverse_dynamics(model.robot, symbols, parameters)
    signals = EffectSignals(symbols.q, symbols.dq, symbols.ddq, sign, load, ca.SX(n, 1), time)
    shapes = ca.SX(ca.DM(shapes_of(model, fit)))
    every = ca.horzcat(regressor(model.robot, symbols), model.effect_columns(signals, shapes))
    return every[:, [int(k) for k in model.base.kept]]
