"""A running experiment in a browser: started, shown on the arm, confirmed, followed to its end.

The experiment behind the page is a prepared one: what a diagnosis finds belongs to other tests.
"""

from multiprocessing import Pipe, get_context
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from experiments import arms
from workbench import quick_experiment
from workbench.server_process import free_port

import lieid_casadi.cli.experiment
import lieid_casadi.experiments
from lieid_casadi.cli.experiment import _Page
from lieid_casadi.cli.main import main
from lieid_casadi.errors import NoSolution
from lieid_casadi.excitation.trajectory import MotionSamples
from lieid_casadi.experiments import PlannedMotion, Purpose
from lieid_casadi.workbench.experiment_page import ExperimentState, serve_experiment

RECORD = "cp {trajectory} {recording}"


def test_a_motion_is_shown_on_the_arm_and_confirmed(start, browse, tmp_path):
    words = ["two_link", "-o", str(tmp_path / "out"), "--record", RECORD]
    server = start(*words, program=(quick_experiment.__file__, "experiment"))
    page = browse(server.url)
    page.click("start-experiment", done=lambda: not page.shown("start-experiment"))
    page.wait(lambda: "The robot moves for" in page.text("next-motion"), "the next motion")
    page.wait(lambda: page.number("instant") > 0.5, "its preview")
    assert page.text("progress") == "diagnose: fits"
    assert "Not checked: " in page.text("next-motion")
    assert "stribeck:1 or viscous_polynomial:1" in page.text("rounds")
    page.picture("experiment_motion")
    page.click("run-motion", done=lambda: not page.shown("run-motion"))
    page.wait(lambda: "Every effect is named" in page.text("experiment-end"), "the end")
    page.wait(lambda: "excitation" in page.text("rounds"), "the rounds")
    page.picture("experiment_end")
    assert page.script_errors() == []
    page.click("close-experiment")
    assert server.ended() == (0, "")


def test_the_page_shows_why_an_experiment_failed(monkeypatch, capsys, tmp_path):
    def failing(*given, **options):
        raise NoSolution("no motion within the limits")

    ends = []
    page = SimpleNamespace(progress=None, confirm=None, end=lambda *text: ends.append(text))
    monkeypatch.setattr(lieid_casadi.experiments, "experiment", failing)
    monkeypatch.setattr(lieid_casadi.cli.experiment, "_Page", lambda args, robot: page)
    words = ["experiment", "two_link", "-o", str(tmp_path / "out"), "--record", RECORD]
    assert main([*words, "--page", str(free_port())]) == 3
    assert ends == [("The experiment failed: no motion within the limits",)]
    assert "no motion within the limits" in capsys.readouterr().err


def test_large_messages_arrive_whole_and_the_page_ends_with_the_command(tmp_path):
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    state = ExperimentState("two_link", tmp_path, (), unattended=False)
    process = context.Process(target=serve_experiment, args=(theirs, free_port(), state))
    process.start()
    theirs.close()
    assert ours.recv().startswith("http://127.0.0.1:")
    for _ in range(5):
        ours.send({"stage": "x" * 10**7})
    process.join(1.0)
    assert process.is_alive()
    ours.close()
    process.join(60.0)
    assert process.exitcode == 0


def test_the_user_pauses_continues_and_ends():
    ours, theirs = Pipe()
    page = _Page.__new__(_Page)
    page._robot, page._pipe, page._asks, page._told = arms.ROBOT, ours, False, 0.0
    t, q = np.linspace(0.0, 1.0, 11), np.zeros((11, 2))
    samples = MotionSamples(t, q, q, q)
    motion = PlannedMotion(1, Purpose("excitation"), samples, 0.0, "", (), (), Path("round-1"))
    assert page.confirm(motion)  # --yes: nobody is asked
    for words, runs, asks in (
        (["pause", "run"], True, True),  # this motion alone
        (["continue"], True, False),
        (["pause", "end"], False, True),
    ):
        for word in words:
            theirs.send(word)
        assert (page.confirm(motion), page._asks) == (runs, asks)
    theirs.close()
    assert not page.confirm(motion)  # the page has ended: no motion is run unseen
