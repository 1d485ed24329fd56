"""A running experiment in a browser: started, shown on the arm, confirmed, followed to its end."""

import os
import sys
from multiprocessing import Pipe
from pathlib import Path

import numpy as np
import pytest
from experiments import arms

from lieid_casadi.cli.experiment import _Page
from lieid_casadi.excitation.trajectory import MotionSamples
from lieid_casadi.experiments import PlannedMotion, Purpose

FOLDER = Path(arms.__file__).parent
RECORD = f"'{sys.executable}' '{FOLDER / 'arms.py'}' {{trajectory}} {{recording}}"
QUICK = """
import sys
from lieid_casadi.cli.main import main
from lieid_casadi.experiments import motion
motion.EXCITATION_STARTS, motion.EVALUATIONS, motion.STARTS = 1, 60, 20
if __name__ == "__main__":
    sys.exit(main())
"""


@pytest.fixture
def words(tmp_path, monkeypatch):
    """Return a program with short searches for motions, and what it is called with."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(FOLDER.parent), *sys.path]))
    (tmp_path / "quick.py").write_text(QUICK)
    arms.sines(arms.arm()).save(tmp_path / "sines.csv")
    out = str(tmp_path / "out")
    options = ["-o", out, "--longest", "13", "--rate", "200", "--record", RECORD]
    return ["two_link", str(tmp_path / "sines.csv"), *options]


def test_a_motion_is_shown_on_the_arm_and_confirmed(start, browse, words, tmp_path):
    server = start(*words, program=(str(tmp_path / "quick.py"), "experiment"))
    page = browse(server.url)
    page.click("start-experiment", done=lambda: page.text("progress"))
    page.wait(lambda: "The robot moves for" in page.text("next-motion"), "the next motion")
    page.wait(lambda: page.number("instant") > 0.5, "its preview")
    assert "Not checked: " in page.text("next-motion")
    assert "stribeck:1 or viscous_polynomial:1" in page.text("rounds")
    page.picture("experiment_motion")
    assert not list(tmp_path.glob("out/round-1/recording.csv"))
    page.click("run-motion", done=lambda: not page.shown("run-motion"))
    page.wait(lambda: "Every effect is named" in page.text("experiment-end"), "the end")
    page.wait(lambda: "excitation" in page.text("rounds"), "the rounds")
    page.picture("experiment_end")
    assert page.script_errors() == []
    page.click("close-experiment")
    out, errors = server.process.communicate(timeout=60)
    assert (server.process.returncode, errors) == (0, "")
    assert "Every effect is named" in out


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
