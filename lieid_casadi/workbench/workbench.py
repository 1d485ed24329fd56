"""One page's session, its computations, and who is informed of changes."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Coroutine
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from lieid_casadi.errors import LieidError
from lieid_casadi.workbench.arm import ArmMotion
from lieid_casadi.workbench.evaluation import EffectCurve, Evaluation, OpenedInputs, SimulationError
from lieid_casadi.workbench.recordings import WorkerSetup
from lieid_casadi.workbench.session import (
    FoundEffects,
    ModelStep,
    PlotView,
    Session,
    WorkbenchInputs,
    save_session,
)
from lieid_casadi.workbench.worker import Failure, Worker, WorkerError, WorkerStopped

if TYPE_CHECKING:
    from lieid_casadi.diagnosis import Proposal


class ChangeNotifier:
    """An object whose changes are shown by views."""

    def __init__(self) -> None:
        self._listeners: list[Callable[[], None]] = []
        self._tasks: set[asyncio.Task[Any]] = set()

    def listen(self, listener: Callable[[], None]) -> None:
        """Call ``listener`` after every change."""
        self._listeners.append(listener)

    def forget(self, listener: Callable[[], None]) -> None:
        """Do not call ``listener`` any more."""
        if listener in self._listeners:
            self._listeners.remove(listener)

    @property
    def has_viewers(self) -> bool:
        """Whether a page shows it."""
        return bool(self._listeners)

    def changed(self) -> None:
        """Inform all listeners."""
        for listener in list(self._listeners):
            listener()

    def background(self, work: Coroutine[Any, Any, None]) -> None:
        """Run a coroutine beside what the user does."""
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


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


KEPT_EVALUATIONS = 24


class Workbench(ChangeNotifier):
    """A session with its two worker processes.

    Fits that the user waits for run in one; the search for missing effects and exact fits after
    quick ones run in the other, which can be stopped.

    Parameters
    ----------
    name : str
        Under which the session is saved.
    worker : Worker, optional
        A process that runs already.

    Attributes
    ----------
    error : str
        Of the last action, one line; empty if it succeeded.
    failure : Failure or None
        Why the last opening failed.
    started : bool
        Whether something was opened, or the form was shown.
    computing : bool
        Whether a fit that the user waits for is computed.
    motion : ArmMotion or None
        Of the arm along the recording that is shown.
    """

    def __init__(self, name: str, setup: WorkerSetup, *, worker: Worker | None = None) -> None:
        super().__init__()
        self.name = name
        self.session = Session()
        self.opened: OpenedInputs | None = None
        self.error = ""
        self.failure: Failure | None = None
        self.started = False
        self.computing = True  # until `open` has ended
        self.view = PlotView()
        self.motion: ArmMotion | None = None
        self._evaluations: dict[object, Evaluation] = {}
        self._front = worker or Worker(setup)
        self._back = Worker(setup)
        self._closed = False
        self.search = EffectSearch(self._back, self.changed)
        self.details = StepDetails(self.changed)

    @property
    def evaluation(self) -> Evaluation | None:
        """Of the step that is shown; None while it is computed."""
        step = self.session.step
        return None if step is None else self._evaluations.get(step.key)

    @property
    def compared(self) -> Evaluation | None:
        """Of the step that the current one is compared with; None without, or while computed."""
        position, history = self.view.compared, self.session.history
        if position is None or position >= len(history) or position == self.session.position:
            return None
        return self._evaluations.get(history[position].key)

    async def open(self, inputs: WorkbenchInputs, saved: Session | None = None) -> bool:
        """Open a robot or fit and recordings; return whether it succeeded.

        With a saved session of these inputs, its history is restored.
        """
        self.stop()
        opened = await self._opened(inputs)
        if opened is None:
            return False
        self.opened, self.motion = opened, None
        self._evaluations = {}
        self.details.reset(inputs)
        self.view = PlotView()
        self.session = saved or self.session.opened(inputs, opened.effects)
        await self._evaluate()
        if saved is None:
            self.show(self.session.at_worst_joint())
        self._back.start()  # before it is needed
        await self._load_motion()
        return True

    async def apply(self, session: Session) -> None:
        """Show a session with another step, and fit it."""
        if session is self.session:
            return
        self.session, self.error = session, ""
        await self._evaluate()

    def show(self, session: Session) -> None:
        """Show a session whose model is the same: another joint, recording or unit."""
        moved = session.recording != self.session.recording
        self.session = session
        if moved:
            self.view, self.motion = PlotView(), None
        self._save()
        self.changed()
        if moved:
            self.background(self._load_motion())

    def look(self, view: PlotView) -> None:
        """Show another range or instant of time."""
        self.view = view
        self.changed()

    async def compare_with(self, position: int | None) -> None:
        """Show a step of the history beside the current one; None ends the comparison."""
        self.look(replace(self.view, compared=position))
        if position is None or self.compared is not None:
            return
        step = self.session.history[position]
        made = await self._evaluated(self._front, step, quick=True)
        if made is not None:
            self._evaluations[step.key] = made
            self.changed()

    async def find_missing(self) -> None:
        """Search for missing effects, or for changes since the fit."""
        step = self.session.step
        if step is None or self.search.activity is not None:
            return
        self.error = ""
        try:
            found = await self.search.run(self.session.inputs, step)
            self.session = replace(self.session, found=found)
            self._save()
        except WorkerStopped:
            pass
        except LieidError as error:
            self.error = str(error)
        self.changed()
        await self.details.simulate(self._back, self._exact_step)

    def stop(self) -> None:
        """Stop the search for missing effects and fits in the background."""
        if self._back.busy:
            self._back.stop()

    async def save(self, kind: str) -> tuple[str, bytes] | None:
        """Return the name and content of a file: ``fit``, ``report``, ``c``, ``urdf``."""
        step = self.session.step
        if step is None:
            return None
        self.error, self.computing = "", True
        self.changed()
        made: tuple[str, bytes] | None = None
        try:
            made = await self._front.request("save", self.session.inputs, step, kind=kind)
        except LieidError as error:
            self.error = str(error)
        self.computing = False
        self.changed()
        return made

    def close(self) -> None:
        """End both processes."""
        self._closed = True
        self._front.stop()
        self._back.stop()

    async def _opened(self, inputs: WorkbenchInputs) -> OpenedInputs | None:
        """Return what was opened; None, with ``failure``, if it cannot be."""
        self.computing, self.error, self.failure = True, "", None
        self.changed()
        opened: OpenedInputs | None = None
        try:
            if inputs.lacking is not None:
                raise WorkerError(Failure(*inputs.lacking))
            opened = await self._front.request("open", inputs)
        except WorkerError as error:
            self.failure = error.failure
        except WorkerStopped:
            pass
        self.computing = opened is not None
        self.changed()
        return opened

    async def _evaluate(self) -> None:
        """Fit the step that is shown, quickly; the rest follows in the background."""
        step, inputs = self.session.step, self.session.inputs
        assert step is not None
        self._save()
        made: Evaluation | None = None
        if step.key not in self._evaluations:
            self.computing = True
            self.changed()
            made = await self._evaluated(self._front, step, quick=True)
            if made is None or self.session.inputs is not inputs:
                return
            self._keep(step, made)
        self.computing = False
        self.changed()
        shown = self._evaluations[step.key]
        if made is not None or not shown.complete:
            self.background(self._complete(step, shown))

    async def _evaluated(
        self, worker: Worker, step: ModelStep, *, quick: bool
    ) -> Evaluation | None:
        """Return the evaluation of a step; None, with ``error``, if it failed."""
        shapes = {} if self.session.found is None else dict(self.session.found.shapes)
        try:
            made: Evaluation = await worker.request(
                "evaluate", self.session.inputs, step, quick=quick, shapes=shapes
            )
        except LieidError as error:
            if not isinstance(error, WorkerStopped):
                self.error, self.computing = str(error), False
                self.changed()
            return None
        return made

    async def _complete(self, step: ModelStep, quick: Evaluation) -> None:
        """Compute what a quick evaluation of a step left out, then what follows an exact fit.

        An exact fit of which only the uncertainty is left out needs no other process.
        """
        worker = self._front if quick.exact else self._back
        if not quick.complete and not await self._completed(worker, step, quick):
            return
        await self.details.load_curves(worker, step, self.session.recording)
        await self.details.simulate(self._back, self._exact_step)

    async def _completed(self, worker: Worker, step: ModelStep, quick: Evaluation) -> bool:
        """Replace a quick evaluation; again if the process was stopped meanwhile."""
        inputs, made = self.session.inputs, None
        while made is None and not self._closed:
            made = await self._evaluated(worker, step, quick=False)
            shown = self.session.step
            left = self.session.inputs is not inputs or shown is None or shown.key != step.key
            if self.error or left:
                break
        if made is None or self.session.inputs is not inputs:
            return False
        if quick.exact:  # the same fit: views that show its torque need not draw it again
            made = replace(made, train=quick.train, test=quick.test)
        self._keep(step, made)
        self.changed()
        return True

    def _exact_step(self) -> ModelStep | None:
        """Return the step that is shown, None before its exact fit."""
        evaluation = self.evaluation
        return None if evaluation is None or not evaluation.exact else self.session.step

    def _keep(self, step: ModelStep, evaluation: Evaluation) -> None:
        self._evaluations[step.key] = evaluation
        self.session = self.session.with_errors(step, evaluation.errors)
        while len(self._evaluations) > KEPT_EVALUATIONS:
            del self._evaluations[next(iter(self._evaluations))]
        self._save()

    async def _load_motion(self) -> None:
        inputs = self.session.inputs
        with contextlib.suppress(WorkerStopped):
            motion = await self._front.request("motion", inputs, recording=self.session.recording)
            if self.session.inputs is inputs:
                self.motion = motion
                self.changed()

    def _save(self) -> None:
        try:
            save_session(self.name, self.session)
        except LieidError as error:
            self.error = str(error)
