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


def recording(arm, sensors, seed=0):
    """Return 20 s of a periodic excitation."""
    t = np.arange(0.0, 20.0, 0.01)
    motion = plant.FourierTrajectory(ROBOT, base_frequency=0.05, seed=1).at(t)
    return plant.measure_along(arm, t, *motion, sensors=replace(sensors, rate=100.0), seed=seed)


def residual(robot, run, joint, title):
    """Return times and residual of the free fit of one joint, N·m."""
    samples = samples_of([run])
    if title.startswith("velocity"):
        samples = with_measured_velocity(samples)
    if title.startswith("time_unit"):
        samples = replace(Correction.none(robot.n), time=1e3).of_samples(samples)
    screen = Screen(robot, samples, most=2400)
    columns = screen.columns(Correction.none(robot.n))[joint]
    fit = screen.base.free
    fitted = fit.base @ columns + fit.own[joint] @ screen.thin.own[joint]
    return screen.thin.t, screen.thin.tau[:, joint] - fitted


def main():
    """Draw all premises."""
    arm = plant.demo_arm(ROBOT, hidden=None)
    run, again = (recording(arm, plant.demo_sensors(ROBOT), seed=k) for k in (0, 1))

    def by(*options):
        return ROBOT, correction_of(options, ROBOT.n).of_recording(run)

    still = plant.JointFriction.none(ROBOT.n)
    computed = recording(replace(arm, friction=still), plant.Sensors(rate=100.0))
    wrapped = (run.q - run.q[600]) % (2.0 * np.pi)
    held = run.q[np.arange(len(run)) // 20 * 20]
    outliers = run.tau + 60.0 * (np.arange(len(run)) % 397 == 99)[:, None]
    limit = 0.7 * np.abs(run.tau).max(axis=0)
    gravity = lieid.compile(ROBOT).gravity(run.q, ROBOT.link_parameters)
    lagged = lfilter([0.05], [1.0, -0.95], run.dq, axis=0)
    cases = [
        ("sound", (ROBOT, run)),
        (
            "gravity_direction: sideways",
            (replace(ROBOT, gravity=gravity_of((0, np.pi / 2, 0))), run),
        ),
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
        ("time_unit: milliseconds", (ROBOT, run)),
        ("torque_from_model", (ROBOT, computed)),
        ("angle_wrapped", (ROBOT, replace(run, q=wrapped))),
        ("spikes", (ROBOT, replace(run, tau=outliers))),
        ("held_samples: positions at 5 Hz", (ROBOT, replace(run, q=held))),
        ("clipped: at 70 %", (ROBOT, replace(run, tau=np.clip(run.tau, -limit, limit)))),
        ("robot_mismatch: an arm on a rail", (load_arm("rail"), run)),
        ("same_motion: test, training", (ROBOT, again)),
    ]
    figure, axes = plt.subplots(7, 3, figsize=(10.0, 13.0), sharex=True, layout="constrained")
    for axis, (title, (robot, given)) in zip(axes.flat, cases, strict=True):
        t, error = residual(robot, given, 2, title)
        t = t / (1e3 if title.startswith("time_unit") else 1.0)
        if title.startswith("same_motion"):
            axis.plot(*residual(ROBOT, run, 2, title), color="C0", linewidth=0.9)
        axis.plot(t, error, color="C3", linewidth=0.9)
        axis.set_title(f"{title} (RMS {np.sqrt(np.mean(error**2)):.2g})", fontsize=9, loc="left")
        axis.grid(alpha=0.3)
    figure.supxlabel("time, s")
    figure.supylabel("residual of the plain fit on joint 3, N·m")
    figure.savefig(FILE, dpi=90)
    sys.stdout.write(f"{FILE}\n")


if __name__ == "__main__":
    main()
