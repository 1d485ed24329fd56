"""One page's session, its computations, and who is informed of changes."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Coroutine, Sequence
from dataclasses import dataclass, replace
from typing import Any

from lieid_casadi.errors import LieidError
from lieid_casadi.premises import PremiseCheck
from lieid_casadi.recording import Processing
from lieid_casadi.workbench.arm import ArmMotion
from lieid_casadi.workbench.evaluation import EffectCurve, Evaluation, OpenedInputs
from lieid_casadi.workbench.session import (
    ModelStep,
    Numbers,
    Session,
    WorkbenchInputs,
    WorkerSetup,
    save_session,
)
from lieid_casadi.workbench.worker import Task, Worker, WorkerError, WorkerStopped

KEPT_RESULTS = 48  # evaluations and curves
SOON = 1.0  # s; work that takes longer has a progress bar
SHOWN_FIRST = 0.05  # s, by which a file is written later than the page is drawn
PLAY_SECONDS = 0.35, 2.5  # of each model on the way to the last, and of all of them at most


@dataclass(frozen=True)
class PlotView:
    """What the plots show; not saved."""

    window: tuple[float, float] | None = None  # visible part of the recording, s; None: all
    selection: tuple[float, float] | None = None  # s
    compared: int | None = None  # position of the step that is shown beside the current one
    instant: float | None = None  # of the arm's pose, s


@dataclass(frozen=True)
class Work:
    """Long work: its stage, the fraction done, and when it began (s, monotonic)."""

    stage: str
    fraction: float
    begun: float

    @property
    def seconds(self) -> float:
        """Time since it began."""
        return time.monotonic() - self.begun

    @property
    def text(self) -> str:
        """The stage, and about how long it will take once that can be estimated."""
        if self.seconds < SOON or not 0.05 < self.fraction < 1.0:
            return self.stage
        left = self.seconds * (1.0 - self.fraction) / self.fraction
        unit = f"{left:.0f} s" if left < 100.0 else f"{left / 60.0:.0f} min"
        return f"{self.stage}, about {unit} left"


class Workbench:
    """A session with its two worker processes.

    Fits that the user waits for run in one; the search for missing effects, and what quick fits
    leave out, run in the other, which can be stopped.
    """

    def __init__(self, name: str, setup: WorkerSetup, *, worker: Worker | None = None) -> None:
        self.name = name
        self.session = Session()
        self.opened: OpenedInputs | None = None
        self.error = ""  # of the last action, one line
        self.failure = ""  # of the last opening, one line
        self.started = False  # whether something was opened, or the form was shown
        self.computing = True  # a fit that the user waits for, until `open` has ended
        self.searching: Work | None = None
        self.saving: Work | None = None
        self.fitting: Work | None = None  # that the user waits for
        self.playing: Numbers | None = None  # errors on the way to those of a model
        self.view = PlotView()
        self.motion: ArmMotion | None = None
        self.premises: PremiseCheck | str | None = None  # or why they cannot be tested
        self._filter: Processing | None = None  # of all fits of what is open
        self._results: dict[tuple[str, object], Any] = {}
        self._front = worker or Worker(setup)
        self._back = Worker(setup, background=True)
        self._closed, self._completing = False, asyncio.Lock()
        self._unsaved: asyncio.TimerHandle | None = None
        self._listeners: list[Callable[[], None]] = []
        self._tasks: set[asyncio.Task[Any]] = set()
        self._adopting: asyncio.Task[Any] | None = None  # the evaluation of the search's fit

    # -- what is shown

    @property
    def evaluation(self) -> Evaluation | None:
        """Of the step that is shown; None while it is computed."""
        return self._result("evaluation", self.session.step)  # type: ignore[no-any-return]

    @property
    def compared(self) -> Evaluation | None:
        """Of the step that the current one is compared with; None without, or while computed."""
        position, history = self.view.compared, self.session.history
        if position is None or position >= len(history) or position == self.session.position:
            return None
        return self._result("evaluation", history[position])  # type: ignore[no-any-return]

    @property
    def curves(self) -> dict[str, EffectCurve]:
        """Torque of each effect of the step that is shown, by its label; empty until computed."""
        return self._result("curves", self.session.step) or {}

    def _result(self, kind: str, step: ModelStep | None) -> Any:
        return None if step is None else self._results.get((kind, step.key))

    def _keep(self, kind: str, step: ModelStep, result: Any) -> None:
        """Keep a result of a step, and show it; the oldest results are dropped."""
        self._results[kind, step.key] = result
        while len(self._results) > KEPT_RESULTS:
            del self._results[next(iter(self._results))]
        if isinstance(result, Evaluation):
            self._filter = result.processing
            self.session = self.session.with_errors(step, result.errors)
            self._save()
        self.changed()

    # -- views

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

    def background(self, work: Coroutine[Any, Any, object]) -> asyncio.Task[Any]:
        """Run a coroutine beside what the user does."""
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    def show(self, session: Session) -> None:
        """Show a session whose model is the same: another joint or recording."""
        moved = session.recording != self.session.recording
        self.session = session
        if moved:
            self.view, self.motion = PlotView(), None
        self._save()
        self.changed()
        if moved:
            self.background(self._load_motion())

    async def select(self, joint: str) -> None:
        """Show another joint, from 0."""
        self.show(replace(self.session, joint=int(joint)))

    def look(self, view: PlotView) -> None:
        """Show another range or instant of time."""
        self.view = view
        self.changed()

    # -- actions of the user

    async def open(self, inputs: WorkbenchInputs, saved: Session | None = None) -> bool:
        """Open a robot or fit and recordings; return whether it succeeded."""
        if self._back.busy:
            self._back.stop()
        self.computing, self.error, self.failure = True, "", inputs.lacking
        self.changed()
        opened: OpenedInputs | None = None
        try:
            if not self.failure:
                opened = await self._front.request("opened", inputs)
        except WorkerError as error:
            self.failure = str(error)
        except WorkerStopped:
            pass
        self.computing = opened is not None
        self.changed()
        if opened is None:
            return False
        self.opened, self.motion, self.view, self._results = opened, None, PlotView(), {}
        self.session = saved or self.session.opened(inputs, opened.effects)
        self.premises = self._filter = None
        self.background(self._check())
        await self._evaluate()
        if saved is None:
            self.show(self.session.at_worst_joint())
        await self._load_motion()
        return True

    async def correct(self, words: Sequence[str]) -> None:
        """Open the same with the options that correct a premise."""
        await self.open(self.session.inputs.with_options(words))

    async def apply(self, session: Session) -> None:
        """Show a session with another step, and fit it."""
        if session is self.session:
            return
        before, self.session, self.error = self.session, session, ""
        await self._evaluate()
        if self.session is session and not (self.computing or self.error or self.evaluation):
            self.show(before)  # the fit was stopped

    async def add_found(self, labels: Sequence[str]) -> None:
        """Add effects that the search found, with one fit; show the errors on the way to it."""
        if self._adopting is not None:
            await asyncio.wait([self._adopting])
        session, found = self.session, self.session.found
        if found is None or session.step is None:
            return
        chosen = [p for p in found.proposed if p.label in labels]
        before, path = session.step.errors, found.path
        if chosen != list(found.proposed) or session.step.effects != found.effects:
            added, path = session.with_added(*labels), ()
        else:  # all of them: the diagnosis' own fit
            count = len(chosen)
            title = f"+ {chosen[0].label}" if count == 1 else f"+ all {count} effects found"
            added = session.with_effects(title, found.model)
        first = path[0] if path else before.shown if before and len(chosen) > 1 else None
        self.playing = first
        await self.apply(added)
        between = list(path[1:-1])
        after = None if self.session.step is None else self.session.step.errors
        if first and after and not path:  # the errors of one joint after the other
            done = [[p.joint for p in chosen[:k]] for k in range(1, len(chosen) + 1)]
            both = list(enumerate(zip(first, after.shown, strict=True)))
            between = [tuple(pair[j in fallen] for j, pair in both) for fallen in done]
        for errors in between:
            self.playing = errors
            self.changed()
            await asyncio.sleep(min(PLAY_SECONDS[0], PLAY_SECONDS[1] / len(between)))
        self.playing = None
        self.changed()

    async def compare_with(self, position: int | None) -> None:
        """Show a step of the history beside the current one; None ends the comparison."""
        self.look(replace(self.view, compared=position))
        if position is None:
            return
        inputs, step = self.session.inputs, self.session.history[position]
        for worker, quick in ((self._front, True), (self._back, False)):
            known = self.compared
            if known is not None and (quick or known.complete):
                continue
            made = await self._evaluated(worker, step, quick=quick)
            if made is None or self.session.inputs is not inputs or self.view.compared != position:
                return
            self._keep("evaluation", step, made)

    async def find_missing(self) -> None:
        """Search for missing effects."""
        step, inputs = self.session.step, self.session.inputs
        if step is None or self.searching is not None:
            return
        self.error = ""
        made = await self._long("searching", self._back, "find", step, processing=self._filter)
        if made is not None and self.session.inputs is inputs:
            found, content = made
            self.session = replace(self.session, found=found)
            self._save()
            if found.proposed:  # its fit is kept until its effects are added
                final = replace(step, effects=found.model)
                adopted = self._follow(self._front, "adopt", final, content=content)
                self._adopting = self.background(adopted)
            self.changed()

    def stop(self) -> None:
        """Stop the search for missing effects, and a fit or export that the user waits for."""
        if self._back.busy:
            self._back.stop()
        if self.saving is not None or self.fitting is not None:
            self._front.stop()  # it is started again, and reads its inputs, when it is needed

    async def save(self, kind: str) -> tuple[str, bytes] | None:
        """Return the name and content of a file: ``fit``, ``report``, ``c``, ``urdf``, ``mjcf``."""
        step = self.session.step
        if step is None or self.saving is not None:
            return None
        self.error = ""
        made: tuple[str, bytes] | None = await self._long(
            "saving", self._front, "save", step, kind=kind
        )
        return made

    def close(self) -> None:
        """End both processes."""
        self._closed = True
        if self._unsaved is not None:
            self._unsaved.cancel()
            self._write()
        self._front.stop()
        self._back.stop()

    # -- computations

    async def _long(
        self, name: str, worker: Worker, task: Task, step: ModelStep, **options: Any
    ) -> Any:
        """Return the result of work, whose progress is the attribute ``name`` if it is shown.

        None if it is stopped or, with ``error``, fails. The page looks at the progress by itself.
        """
        begun, made = time.monotonic(), None

        def reports(stage: str, fraction: float) -> None:
            if name:
                setattr(self, name, Work(stage, fraction, begun))

        reports("start", 0.0)
        if name:
            self.changed()
        later = asyncio.get_running_loop().call_later(SOON, self.changed)
        try:
            inputs = self.session.inputs
            made = await worker.request(task, inputs, step=step, progress=reports, **options)
        except WorkerStopped:
            pass
        except LieidError as error:
            self.error = str(error)
        later.cancel()
        if name:
            setattr(self, name, None)
        if made is None or name != "fitting":  # a fit is shown by who waits for it
            self.changed()
        return made

    async def _check(self) -> None:
        """Test the premises, while the first model is fitted."""
        inputs = self.session.inputs
        try:
            made = await self._back.request("premises", inputs)
        except LieidError as error:
            made = str(error)
        if self.session.inputs is inputs:
            self.premises = made
            self.changed()

    async def _evaluate(self) -> None:
        """Fit the step that is shown, quickly; the rest follows in the background."""
        step, inputs = self.session.step, self.session.inputs
        assert step is not None
        self._save()
        made: Evaluation | None = self._result("evaluation", step)
        if made is None:
            self.computing = True
            made = await self._evaluated(self._front, step, quick=True)
            self.computing = False
            if made is None or self.session.inputs is not inputs:
                return
            self._keep("evaluation", step, made)
        else:
            self.computing = False
            self.session = self.session.with_errors(step, made.errors)
            self.changed()
        self.background(self._complete(step, made))

    async def _evaluated(
        self, worker: Worker, step: ModelStep, *, quick: bool
    ) -> Evaluation | None:
        """Return the evaluation of a step; None if it was stopped or, with ``error``, failed."""
        options = {"quick": quick, "processing": self._filter}
        name = "fitting" if quick else ""
        made: Evaluation | None = await self._long(name, worker, "evaluate", step, **options)
        return made

    async def _complete(self, step: ModelStep, shown: Evaluation) -> None:
        """Compute what a quick evaluation of a step left out, then what follows an exact fit."""
        if not shown.complete and not await self._completed(step, shown):
            return
        await self._follow(self._back, "curves", step, recording=self.session.recording)

    async def _completed(self, step: ModelStep, quick: Evaluation) -> bool:
        """Replace a quick evaluation; again if the process was stopped meanwhile.

        One after the other: steps that were left before their turn are skipped.
        """
        inputs, made = self.session.inputs, None

        def left() -> bool:
            shown = self.session.step
            return self.session.inputs is not inputs or shown is None or shown.key != step.key

        async with self._completing:
            while made is None and not (self._closed or left()):
                made = await self._evaluated(self._back, step, quick=False)
                if self.error:
                    break
        if made is None or self.session.inputs is not inputs:
            return False
        if quick.exact:  # the same fit: views that show its torque need not draw it again
            made = replace(made, test=quick.test or made.test)
            if any(quick.errors.train):  # otherwise it is that along a part
                made = replace(made, train=quick.train)
        self._keep("evaluation", step, made)
        return True

    async def _follow(self, worker: Worker, task: Task, step: ModelStep, **options: Any) -> None:
        """Compute what the page is complete without, and show it; what fails is left out."""
        inputs, kind = self.session.inputs, "evaluation" if task == "adopt" else task
        if task != "adopt" and self._result(kind, step) is not None:
            return
        with contextlib.suppress(LieidError):
            made = await worker.request(task, inputs, step=step, **options)
            if self.session.inputs is inputs:
                self._keep(kind, step, made)

    async def _load_motion(self) -> None:
        inputs = self.session.inputs
        with contextlib.suppress(LieidError):
            motion = await self._front.request("motion", inputs, recording=self.session.recording)
            if self.session.inputs is inputs:
                self.motion = motion
                self.changed()

    def _save(self) -> None:
        """Save the session once what has changed is shown."""
        if self._unsaved is None:
            self._unsaved = asyncio.get_running_loop().call_later(SHOWN_FIRST, self._write)

    def _write(self) -> None:
        self._unsaved = None
        try:
            save_session(self.name, self.session)
        except LieidError as error:
            self.error = str(error)
