"""The search for missing effects, with what it has found so far."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from lieid_casadi.workbench.computing.worker import Worker
from lieid_casadi.workbench.state.inputs import WorkbenchInputs
from lieid_casadi.workbench.state.proposals import FoundEffects
from lieid_casadi.workbench.state.session import ModelStep

if TYPE_CHECKING:
    from lieid_casadi.diagnosis import Proposal


class EffectSearch:
    """A diagnosis in a worker process.

    Parameters
    ----------
    worker : Worker
        Stopping it ends the search.
    changed : callable
        Called after every progress.

    Attributes
    ----------
    activity : (str, float) or None
        Stage and fraction of the search that runs, None if none runs.
    arriving : list of Proposal
        What it has found so far.
    """

    def __init__(self, worker: Worker, changed: Callable[[], None]) -> None:
        self._worker, self._changed = worker, changed
        self.activity: tuple[str, float] | None = None
        self.arriving: list[Proposal] = []

    async def run(self, inputs: WorkbenchInputs, step: ModelStep) -> FoundEffects:
        """Return what a diagnosis of a step's model proposes.

        Raises
        ------
        WorkerError
            It failed.
        WorkerStopped
            The worker was stopped.
        """
        self.activity, self.arriving = ("start", 0.0), []
        self._changed()
        try:
            found: FoundEffects = await self._worker.request(
                "find", inputs, step, progress=self._progress, found=self._arrived
            )
        finally:
            self.activity = None
        return found

    def _progress(self, stage: str, fraction: float) -> None:
        self.activity = (stage, fraction)
        self._changed()

    def _arrived(self, proposal: Proposal) -> None:
        self.arriving.append(proposal)
        self._changed()
