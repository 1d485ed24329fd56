"""Errors and torque are shown first; what takes longer than the fit follows as it lands."""

import asyncio
from dataclasses import replace

import pytest

from lieid_casadi.workbench.evaluation import Evaluation
from lieid_casadi.workbench.session import (
    FoundEffects,
    ProposedEffect,
    RecordingInput,
    Session,
    StepErrors,
    WorkbenchInputs,
)
from lieid_casadi.workbench.workbench import Workbench
from lieid_casadi.workbench.worker import WorkerStopped

INPUTS = WorkbenchInputs(robot="two_link", recordings=(RecordingInput("a.csv", "train"),))


def evaluation(*, exact, complete, series):
    errors = StepErrors((0.2,), (0.3,), (0.1,) if complete else (0.15,))
    return Evaluation(
        exact=exact, complete=complete, errors=errors, train=series,
        test=None, sentence="", effects=(), cutoff=10.0,
    )  # fmt: skip


class Process:
    """Answers evaluations; those that are not quick wait until they are let go, or stopped."""

    def __init__(self):
        self.busy, self.asked, self.go = False, [], asyncio.Event()
        self.slow, self.stopped = False, False

    async def request(self, task, inputs, *, step, **options):
        if task != "evaluate":
            await asyncio.Event().wait()  # curves are never computed here
        self.asked.append(("quick" if options["quick"] else "whole", step.effects[-1]))
        while self.slow:
            options["progress"]("fit", 0.25)
            await asyncio.sleep(0.01)
            if self.stopped:
                raise WorkerStopped("stopped")
        if options["quick"]:
            held = step.effects[-1].startswith("stribeck")
            return evaluation(exact=not held, complete=False, series="quick series")
        await self.go.wait()
        return evaluation(exact=True, complete=True, series="whole series")

    def stop(self):
        self.stopped = True


@pytest.fixture
def page(tmp_path, monkeypatch):
    """Return a workbench with two processes of this test, and what it has shown."""
    monkeypatch.setenv("LIEID_WORKBENCH_DIR", str(tmp_path))

    def made():
        workbench = Workbench("0" * 16, None, worker=Process())
        workbench._back = Process()
        workbench.session = Session().opened(INPUTS, ["coulomb:1"])
        shown = []

        def show():
            e = workbench.evaluation
            shown.append(None if e is None else (e.exact, e.complete, e.train))

        workbench.listen(show)
        return workbench, shown

    return made


async def settle():
    for _ in range(20):
        await asyncio.sleep(0)


@pytest.mark.parametrize(
    ("effect", "exact", "series"),
    [("viscous:1", True, "quick series"), ("stribeck:1", False, "whole series")],
)
def test_the_other_process_adds_what_a_quick_fit_left_out(page, effect, exact, series):
    async def run():
        workbench, shown = page()
        await workbench.apply(workbench.session.with_added(effect))
        await settle()
        assert not workbench.computing
        assert shown[-1] == (exact, False, "quick series")
        assert workbench.session.step.errors.noise_floor == (0.15,)
        workbench._back.go.set()
        await settle()
        assert shown[-1] == (True, True, series)  # the torque of an exact fit is not drawn again
        assert workbench.session.step.errors.noise_floor == (0.1,)
        assert workbench._front.asked == [("quick", effect)]

    asyncio.run(run())


def test_a_fit_that_takes_long_can_be_stopped(page):
    async def run():
        workbench, _ = page()
        before = workbench.session
        workbench._front.slow = True
        applied = asyncio.create_task(workbench.apply(before.with_added("viscous:1")))
        while workbench.fitting is None or workbench.fitting.fraction == 0.0:
            await asyncio.sleep(0.01)
        assert (workbench.computing, workbench.fitting.text) == (True, "fit")
        begun = replace(workbench.fitting, begun=workbench.fitting.begun - 10.0)
        assert begun.text == "fit, about 30 s left"
        workbench.stop()
        await applied
        assert (workbench.computing, workbench.fitting, workbench.error) == (False, None, "")
        assert workbench.session is before

    asyncio.run(run())


def test_a_result_that_lands_after_undo_belongs_to_its_step(page):
    async def run():
        workbench, shown = page()
        await workbench.apply(workbench.session.with_added("viscous:1"))
        await settle()
        await workbench.apply(workbench.session.at(0))
        await settle()
        before = workbench.evaluation
        workbench._back.go.set()
        await settle()
        _, added = workbench.session.history
        assert before is not workbench._results["evaluation", added.key]
        assert workbench._results["evaluation", added.key].complete
        assert added.errors.noise_floor == (0.1,)
        await workbench.apply(workbench.session.at(1))
        assert shown[-1] == (True, True, "quick series")
        assert workbench._front.asked.count(("quick", "viscous:1")) == 1

    asyncio.run(run())


def test_all_effects_are_added_with_the_fit_of_the_diagnosis(page):
    """The bars pass the errors of each model, and rest on those of the diagnosis' own fit.

    A click that comes before this fit is evaluated waits for it.
    """

    async def run():
        workbench, _ = page()
        first = workbench.session.step
        proposed = tuple(
            ProposedEffect(label, label[:-2], (1,), 0, 1.0, 0.5)
            for label in ("stribeck:1", "viscous:1")
        )
        model = (*first.effects, "stribeck:1", "viscous:1")
        path = ((1.0,), (0.5,), (0.3,))
        found = FoundEffects("effect_found", "", proposed, first.effects, model=model, path=path)
        workbench.session = replace(workbench.session, found=found)
        final = replace(first, effects=model)

        async def adopt():  # after the click
            await settle()
            workbench._keep(
                "evaluation", final, evaluation(exact=True, complete=True, series="fit")
            )

        workbench._adopting = workbench.background(adopt())
        played = []
        workbench.listen(lambda: played.append(workbench.playing))
        await workbench.add_found([p.label for p in proposed])
        assert workbench._front.asked == []  # no further fit
        assert workbench.session.step.effects == model
        assert [errors for errors in dict.fromkeys(played) if errors] == [(1.0,), (0.5,)]
        assert played[-1] is None
        await workbench.apply(workbench.session.at(0))
        await workbench.add_found(["stribeck:1"])
        assert workbench.session.step.effects == (*first.effects, "stribeck:1")
        before = workbench.session.step.errors.shown
        played.clear()
        await workbench.add_found(["stribeck:1", "viscous:1"])  # those that are missing
        assert (played[0], played[-1]) == (before, None)
        assert workbench.session.step.errors.shown in played  # of one joint after the other

    asyncio.run(run())
