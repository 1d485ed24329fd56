"""``lieid experiment`` with a prepared experiment: one motion, no diagnosis and no search."""

import sys
from pathlib import Path

import numpy as np

import lieid_casadi.experiments
from lieid_casadi.cli.main import main
from lieid_casadi.excitation.trajectory import MotionSamples
from lieid_casadi.experiments import Experiment, PlannedMotion, Purpose, Round
from lieid_casadi.experiments.folder import STATE, ExperimentFolder

OPEN = (("stribeck:1", "viscous_polynomial:1"),)


def prepared(source, given, *, record, folder, confirm, progress, **options):
    """Show the progress of a diagnosis, plan a motion, ask, and end."""
    errors = {"error": (2.0, 1.0), "first_error": (3.0, 1.0), "noise_floor": (1.0, 1.0)}
    rounds = (Round(0, None, "", 8.0, None, None, open=OPEN, **errors),)
    kept = ExperimentFolder.of(folder, {})
    kept.write(STATE, Experiment("two_link", rounds).to_dict())
    progress("diagnose: fits", 0.5)
    t = np.linspace(0.0, 4.0, 81)
    q = np.outer(1.0 - np.cos(np.pi * t), [0.4, -0.3])
    motion = PlannedMotion(
        1, Purpose("excitation", why="Little is known."), MotionSamples(t, q, 0 * q, 0 * q),
        0.0, "", ("positions",), ("obstacles",), Path(folder) / "round-1",
    )  # fmt: skip
    assert confirm(motion)
    done = Round(1, motion.purpose, "", 4.0, None, None, named=("stribeck:1",), **errors)
    ended = Experiment("two_link", (*rounds, done), None, "all_named", "Every effect is named.")
    kept.write(STATE, ended.to_dict())
    return ended


if __name__ == "__main__":
    lieid_casadi.experiments.experiment = prepared
    sys.exit(main())
