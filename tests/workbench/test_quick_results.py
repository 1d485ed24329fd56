"""Errors and torque are shown first; what takes longer than the fit follows as it lands."""

import asyncio

import pytest

from lieid_casadi.workbench.evaluation import Evaluation
from lieid_casadi.workbench.session import RecordingInput, Session, StepErrors, WorkbenchInputs
from lieid_casadi.workbench.workbench import Workbench

INPUTS = WorkbenchInputs(robot="two_link", recordings=(RecordingInput("a.csv", "train"),))


def evaluation(*, exact, complete, series):
    errors = StepErrors((0.2,), (0.3,), (0.1,) if complete else (0.15,))
    return Evaluation(
        exact=exact,
        complete=complete,
        errors=errors,
        train=series,
        test=None,
        sentence="",
        effects=(),
        warnings=(),
        shapes={},
        cutoff=10.0,
    )


class Process:
    """Answers evaluations; those that are not quick wait until they are let go."""

    def __init__(self):
        self.busy, self.asked, self.go = False, [], asyncio.Event()

    async def request(self, task, inputs, step, **options):
        if task != "evaluate":
            await asyncio.Event().wait()  # curves and simulation: never, here
        self.asked.append(("quick" if options["quick"] else "whole", step.effects[-1]))
        if options["quick"]:
            held = step.effects[-1].startswith("stribeck")
            return evaluation(exact=not held, complete=False, series="quick series")
        await self.go.wait()
        return evaluation(exact=True, complete=True, series="whole series")


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


def test_the_same_process_adds_what_a_linear_fit_left_out(page):
    async def run():
        workbench, shown = page()
        await workbench.apply(workbench.session.with_effect("viscous:1"))
        await settle()
        assert not workbench.computing
        assert shown[-1] == (True, False, "quick series")
        assert workbench.session.step.errors.noise_floor == (0.15,)
        workbench._front.go.set()
        await settle()
        assert shown[-1] == (True, True, "quick series")  # need not be drawn again
        assert workbench.session.step.errors.noise_floor == (0.1,)
        assert workbench._back.asked == []

    asyncio.run(run())


def test_the_other_process_fits_shapes_exactly(page):
    async def run():
        workbench, shown = page()
        await workbench.apply(workbench.session.with_effect("stribeck:1"))
        await settle()
        assert shown[-1] == (False, False, "quick series")
        workbench._back.go.set()
        await settle()
        assert shown[-1] == (True, True, "whole series")
        assert workbench._front.asked == [("quick", "stribeck:1")]

    asyncio.run(run())


def test_a_result_that_lands_after_undo_belongs_to_its_step(page):
    async def run():
        workbench, shown = page()
        await workbench.apply(workbench.session.with_effect("viscous:1"))
        await settle()
        await workbench.apply(workbench.session.undone())
        await settle()
        before = workbench.evaluation
        workbench._front.go.set()
        await settle()
        _, added = workbench.session.history
        assert before is not workbench._evaluations[added.key]
        assert workbench._evaluations[added.key].complete
        assert added.errors.noise_floor == (0.1,)
        await workbench.apply(workbench.session.redone())
        assert shown[-1] == (True, True, "quick series")
        assert workbench._front.asked.count(("quick", "viscous:1")) == 1

    asyncio.run(run())
