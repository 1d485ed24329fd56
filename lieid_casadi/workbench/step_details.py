"""What is computed after the exact fit of a step, and shown as it lands."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

from lieid_casadi.errors import LieidError
from lieid_casadi.workbench.computing.results import EffectCurve, SimulationError
from lieid_casadi.workbench.computing.worker import Worker
from lieid_casadi.workbench.state.inputs import WorkbenchInputs
from lieid_casadi.workbench.state.session import ModelStep

_NO_CURVES: dict[str, EffectCurve] = {}


class StepDetails:
    """Torque curves of the effects, and the simulation error, of the steps of a session.

    The page is complete without them; what fails is left out.

    Parameters
    ----------
    changed : callable
        Called after every result.
    """

    def __init__(self, changed: Callable[[], None]) -> None:
        self._changed = changed
        self._inputs = WorkbenchInputs()
        self._curves: dict[object, dict[str, EffectCurve]] = {}
        self._simulations: dict[object, SimulationError] = {}

    def reset(self, inputs: WorkbenchInputs) -> None:
        """Forget everything; further results are those of these inputs."""
        self._inputs, self._curves, self._simulations = inputs, {}, {}

    def curves(self, step: ModelStep) -> dict[str, EffectCurve]:
        """Return the torque of each effect by its label; empty until computed."""
        return self._curves.get(step.key, _NO_CURVES)

    def simulation(self, step: ModelStep) -> SimulationError | None:
        """Return the simulation error; None until computed."""
        return self._simulations.get(step.key)

    async def load_curves(self, worker: Worker, step: ModelStep, recording: int) -> None:
        """Compute the torque of each effect along a recording.

        Parameters
        ----------
        worker : Worker
            That has the exact fit.
        step : ModelStep
        recording : int
        """
        inputs = self._inputs
        if step.key in self._curves:
            return
        with contextlib.suppress(LieidError):
            curves = await worker.request("curves", inputs, step, recording=recording)
            if self._inputs is inputs:
                self._curves[step.key] = curves
                self._changed()

    async def simulate(self, worker: Worker, shown: Callable[[], ModelStep | None]) -> None:
        """Compute the simulation error of the step that is shown, unless the worker is busy.

        Parameters
        ----------
        worker : Worker
        shown : callable
            Returns the step; asked again after every result, so that none waits in between.
        """
        inputs = self._inputs
        with contextlib.suppress(LieidError):
            while (step := shown()) is not None and self._inputs is inputs and not worker.busy:
                if step.key in self._simulations:
                    return
                found = await worker.request("simulate", inputs, step)
                if self._inputs is inputs:
                    self._simulations[step.key] = found
                    self._changed()
