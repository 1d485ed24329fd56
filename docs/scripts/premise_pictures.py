"""Draw docs/pictures/premises.png: the residual of a plain fit where one premise is wrong.

    PYTHONPATH=tests python docs/scripts/premise_pictures.py

The arm is a simulated UR10e without hidden effects (tests/hidden_effects/arms.py).
"""

import sys
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from hidden_effects.arms import load_arm
from scipy.signal import lfilter

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.premises.correction import Correction, correction_of, gravity_of, shifted
from lieid_casadi.premises.plain_fit import samples_of
from lieid_casadi.premises.screen import Screen
from lieid_casadi.premises.timing import with_measured_velocity

ROBOT = load_arm("ur10e")
FILE = Path(__file__).parents[1] / "pictures" / "premises.png"


def recording():
    """Return 20 s of a periodic excitation."""
    t = np.arange(0.0, 20.0, 0.01)
    motion = plant.FourierTrajectory(ROBOT, base_frequency=0.05, seed=1).at(t)
    sensors = replace(plant.demo_sensors(ROBOT), rate=100.0)
    return plant.measure_along(plant.demo_arm(ROBOT, hidden=None), t, *motion, sensors=sensors)


def residual(robot, run, joint, measured=False):
    """Return times and residual of the free fit of one joint, N·m."""
    samples = samples_of([run])
    screen = Screen(robot, with_measured_velocity(samples) if measured else samples, most=2400)
    columns = screen.columns(Correction.none(robot.n))[joint]
    fit = screen.base.free
    fitted = fit.base @ columns + fit.own[joint] @ screen.thin.own[joint]
    return screen.thin.t, screen.thin.tau[:, joint] - fitted


def main():
    """Draw all premises."""
    run = recording()

    def by(*options):
        return ROBOT, correction_of(options, ROBOT.n).of_recording(run)

    gravity = lieid.compile(ROBOT).gravity(run.q, ROBOT.link_parameters)
    lagged = lfilter([0.05], [1.0, -0.95], run.dq, axis=0)
    cases = [
        ("sound", (ROBOT, run)),
        (
            "gravity_direction: sideways",
            (replace(ROBOT, gravity=gravity_of((0, np.pi / 2, 0))), run),
        ),
        ("gravity_direction: 20°", (replace(ROBOT, gravity=gravity_of((0.35, 0, 0))), run)),
        ("joint_order: 2 and 3", by("--joint-order 1 3 2 4 5 6")),
        ("joint_order: torques 2 and 3", (ROBOT, replace(run, tau=run.tau[:, [0, 2, 1, 3, 4, 5]]))),
        ("joint_sign: joint 3", by("--joint-sign 1 1 -1 1 1 1")),
        ("torque_sign: joint 3", by("--torque-sign 1 1 -1 1 1 1")),
        ("joint_zero: joint 3 by 90°", by("--joint-zero 0 0 1.571 0 0 0")),
        ("joint_coupling: 3 − 2", by("--joint-coupling 3-2")),
        ("torque_gravity_compensated", (ROBOT, replace(run, tau=run.tau - gravity))),
        ("time_offset: 40 ms", (ROBOT, replace(run, tau=shifted(run.t, run.tau, -0.04)))),
        ("velocity_signal: 0.2 s", (ROBOT, replace(run, dq=lagged))),
        ("position_unit: degrees", (ROBOT, replace(run, q=np.rad2deg(run.q)))),
        ("torque_unit: amperes", (ROBOT, replace(run, tau=run.tau / 11.0))),
        ("robot_mismatch: an arm on a rail", (load_arm("rail"), run)),
    ]
    figure, axes = plt.subplots(5, 3, figsize=(10.0, 9.6), sharex=True, layout="constrained")
    for axis, (title, (robot, given)) in zip(axes.flat, cases, strict=True):
        t, error = residual(robot, given, 2, measured=title.startswith("velocity"))
        axis.plot(t, error, color="C3", linewidth=0.9)
        axis.set_title(f"{title} (RMS {np.sqrt(np.mean(error**2)):.2g})", fontsize=9, loc="left")
        axis.grid(alpha=0.3)
    figure.supxlabel("time, s")
    figure.supylabel("residual of the plain fit on joint 3, N·m")
    figure.savefig(FILE, dpi=90)
    sys.stdout.write(f"{FILE}\n")


if __name__ == "__main__":
    main()
