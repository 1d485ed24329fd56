"""Coverage of standard deviations: a simulated arm is measured 200 times with different noise.

Prints how often the 95 % intervals of base parameters contain the true values, for white and for
coloured torque noise. Encoder noise causes a bias that standard deviations do not include; the last
line shows it. Draws ``coverage.png``.

Takes some minutes: python examples/uncertainty.py [RUNS]
"""

import sys

import numpy as np

import lieid_casadi as lieid
from lieid_casadi import plant

EFFECTS = "coulomb,viscous,offset"
NOISE = 0.005  # of each joint's torque scale


def arm_and_motion():
    """Return the bundled Panda with other inertias, and half a minute of its motion."""
    robot = lieid.robots.panda()
    motion = plant.FourierTrajectory(robot, harmonics=8, base_frequency=1 / 30, seed=2)
    t = np.arange(0.0, 30.0, 0.005)
    return plant.demo_arm(robot, hidden=None, seed=1), t, motion.at(t)


def true_values(model, arm):
    """Return the true base parameters."""
    friction = {"coulomb": arm.friction.coulomb, "viscous": arm.friction.viscous}
    friction["offset"] = arm.friction.offset
    effects = [friction[column.name.split(".")[0]][column.joint] for column in model.columns]
    return model.base.combination @ np.concatenate([arm.parameters, effects])


def errors(arm, t, motion, sensors, runs):
    """Return errors (runs, p) of the base values, and their stated standard deviations."""
    model = lieid.Model(arm.robot, EFFECTS)
    truth, found, stated = true_values(model, arm), [], []
    for seed in range(runs):
        recording = plant.measure_along(arm, t, *motion, sensors=sensors, seed=seed)
        fit = lieid.identify(model, recording, processing=lieid.Processing(cutoff=8.0))
        found.append(fit.values - truth)
        stated.append(fit.std)
    return np.array(found), np.array(stated)


def main(runs=200):
    """Measure, print and draw."""
    import matplotlib.pyplot as plt

    arm, t, motion = arm_and_motion()
    noise = tuple(NOISE * plant.torque_scale(arm.robot))
    white = plant.Sensors(torque_noise=noise)
    coloured = plant.Sensors(coloured_noise=noise, correlation_time=0.1)
    encoder = plant.Sensors(torque_noise=noise, position_noise=1e-4, velocity="difference")
    kinds = {
        "white torque noise": white,
        "coloured torque noise, 0.1 s": coloured,
        "white torque and 1e-4 rad encoder noise": encoder,
    }
    figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
    for name, sensors in kinds.items():
        found, stated = errors(arm, t, motion, sensors, runs)
        held = np.mean(np.abs(found) < 1.96 * stated, axis=0)
        bias = np.abs(found.mean(axis=0)) / found.std(axis=0)
        print(
            f"{name}: 95 % intervals contain the true value in {held.mean():.1%} of all "
            f"cases, {held.min():.1%} for the worst parameter; "
            f"bias {np.median(bias):.2f} std (median), {bias.max():.2f} (largest)"
        )
        axes.plot(np.sort(held), label=name)
    axes.axhline(0.95, color="black", linewidth=0.8)
    axes.set(
        xlabel="base parameters, sorted",
        ylabel="coverage of 95 % intervals",
        ylim=(0, 1),
    )
    axes.legend(frameon=False)
    figure.savefig("coverage.png", dpi=150)


if __name__ == "__main__":
    main(*(int(runs) for runs in sys.argv[1:2]))
