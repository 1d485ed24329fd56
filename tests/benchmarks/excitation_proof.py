"""Does it matter? Identification from an optimal and from a random trajectory, 50 noise seeds each.

    python tests/benchmarks/excitation_proof.py [SEEDS]

The plant is the Panda with inertias off the nominal ones, Coulomb, viscous and constant friction,
encoders and noisy torques; both trajectories last 20 s, start and end at rest and keep to the same
limits. Parameter error: of the base parameters, each in units of the standard deviation that the
best trajectory could predict for it; and what a controller would see, the error of the torque on a
third trajectory without noise.
"""

import sys

import numpy as np

import lieid_casadi as lieid
from lieid_casadi.excitation import Torque, excite
from lieid_casadi.plant.demo_arm import demo_arm, demo_sensors
from lieid_casadi.plant.sensors import measure_along
from lieid_casadi.plant.trajectories import FourierTrajectory
from lieid_casadi.recording import Processing

EFFECTS = ["coulomb", "viscous", "offset"]
RATE, CUTOFF, DURATION = 200.0, 8.0, 20.0


def truth(arm, model):
    """True base parameters (p,)."""
    f = arm.friction
    coefficients = np.concatenate([f.coulomb, f.viscous, f.offset])
    return model.base.combination @ np.concatenate([arm.parameters, coefficients])


def runs(arm, model, motion, seeds):
    """Return fitted values and predicted standard deviations (S, p)."""
    values, deviations = [], []
    sensors = demo_sensors(arm.robot, rate=RATE)
    for seed in range(seeds):
        recording = measure_along(arm, *motion, sensors=sensors, seed=seed)
        fit = lieid.identify(model, recording, method="wls", processing=Processing(cutoff=CUTOFF))
        values.append(fit.values)
        deviations.append(fit.std[: len(fit.values)])
    return np.array(values), np.array(deviations)


def torque_errors(arm, model, values, true, motion):
    """RMS torque error (S, n) on a motion without noise, of the fitted base parameters."""
    rows = lieid.compile(model).base_regressor(*motion[1:])
    error = np.einsum("tnp,sp->stn", rows, values - true)
    return np.sqrt(np.mean(error**2, axis=1))


def main(seeds=50):
    robot = lieid.robots.panda()
    model = lieid.Model(robot, effects=EFFECTS)
    arm = demo_arm(robot, seed=1, hidden=None)
    best = excite(model, duration=DURATION, acceleration=5.0, margin=1.0, limits=(Torque(),))
    optimal = best.motion()
    t = np.arange(0.0, DURATION + 1e-9, 1e-3)
    random = FourierTrajectory(robot, base_frequency=1.0 / DURATION, seed=5)
    third = FourierTrajectory(robot, base_frequency=0.1, seed=77)
    motions = {
        "optimal": (optimal.t, optimal.q, optimal.dq, optimal.ddq),
        "random": (t, *random.at(t)),
    }
    test = (t[::10], *third.at(t[::10]))
    true = truth(arm, model)
    say(f"optimal: condition number {best.condition_number:.1f}")
    results = {name: runs(arm, model, motion, seeds) for name, motion in motions.items()}
    unit = np.median(results["optimal"][1], axis=0)
    say(f"{'':9}{'error, rms':>12}{'bias':>8}{'spread':>8}{'predicted':>11}"
        f"{'spread/predicted':>18}{'test rms, mN·m':>17}")  # fmt: skip
    for name, (values, deviations) in results.items():
        error = (values - true) / unit
        spread, predicted = values.std(axis=0, ddof=1), np.median(deviations, axis=0)
        torque = 1e3 * np.median(np.sqrt(np.mean(
            torque_errors(arm, model, values, true, test) ** 2, axis=1
        )))  # fmt: skip
        bias = np.abs(error.mean(axis=0))
        say(
            f"{name:9}{np.sqrt(np.mean(error**2)):12.2f}{np.sqrt(np.mean(bias**2)):8.2f}"
            f"{np.sqrt(np.mean((spread / unit) ** 2)):8.2f}"
            f"{np.sqrt(np.mean((predicted / unit) ** 2)):11.2f}"
            f"{np.median(spread / predicted):18.2f}{torque:17.2f}"
        )


def say(text):
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
