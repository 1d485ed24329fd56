"""What follows a fit never delays what the user waits for."""

import asyncio
from types import SimpleNamespace

from lieid_casadi.workbench.evaluation import SimulationError
from lieid_casadi.workbench.session import ModelStep, WorkbenchInputs
from lieid_casadi.workbench.workbench import StepDetails

FIRST, SECOND = ModelStep("first", ("coulomb:1",)), ModelStep("second", ("viscous:1",))


class Worker:
    """Answers every request at once, and notes it."""

    def __init__(self, then=lambda: None):
        self.busy, self.steps, self._then = False, [], then

    async def request(self, task, inputs, step):
        self.steps.append(step)
        self._then()
        return SimulationError(1.0, (0.1,), "")


def details():
    made = StepDetails(lambda: None)
    made.reset(WorkbenchInputs(robot="two_link"))
    return made


def test_a_busy_worker_is_not_asked():
    worker, found = Worker(), details()
    worker.busy = True
    asyncio.run(found.simulate(worker, lambda: FIRST))
    assert worker.steps == []
    assert found.simulation(FIRST) is None


def test_the_step_that_is_shown_meanwhile_is_simulated_next_and_each_once():
    shown = SimpleNamespace(step=FIRST)
    worker, found = Worker(lambda: setattr(shown, "step", SECOND)), details()
    for _ in range(2):
        asyncio.run(found.simulate(worker, lambda: shown.step))
    assert worker.steps == [FIRST, SECOND]
    assert found.simulation(SECOND).rms == (0.1,)


def test_results_of_other_inputs_are_dropped():
    found = details()
    worker = Worker(lambda: found.reset(WorkbenchInputs(robot="panda")))
    asyncio.run(found.simulate(worker, lambda: FIRST))
    assert found.simulation(FIRST) is None
