"""Write the files of ``fits_0_1_0`` with the code of version 0.1.0 (commit 787729c).

python make_fits_0_1_0.py FOLDER
"""

import sys
from pathlib import Path

import numpy as np

import lieid_casadi as lieid
from lieid_casadi import plant

FITS = {
    "joints": ("coulomb,viscous,offset,stribeck:1,load_friction:2,presliding:2", "wls"),
    "arm": ("coulomb,viscous,offset,base_tilt,armature:2,torque_delay:2", "wls"),
    "feasible": ("coulomb,viscous,offset,viscous_polynomial:1", "feasible"),
}


def measure(arm, *, seconds, rate, seed, name):
    """Measure the arm along a random motion of that seed."""
    t = np.arange(0.0, seconds, 1e-3)
    motion = plant.FourierTrajectory(arm.robot, base_frequency=1 / seconds, seed=seed)
    sensors = plant.demo_sensors(arm.robot, rate=rate)
    return plant.measure_along(arm, t, *motion.at(t), sensors=sensors, seed=seed, name=name)


def main(folder):
    if lieid.__version__ != "0.1.0":
        raise SystemExit(f"this is version {lieid.__version__}; run it with 0.1.0")
    folder.mkdir(parents=True, exist_ok=True)
    robot = lieid.robots.two_link()
    arm = plant.demo_arm(robot, hidden="load_friction", joint=1, seed=3)
    arm = arm.with_effects(
        plant.hidden_effect(arm, "stribeck", 0), plant.hidden_effect(arm, "presliding", 1)
    )
    train = measure(arm, seconds=20.0, rate=200.0, seed=1, name="train")
    measure(arm, seconds=4.0, rate=100.0, seed=2, name="test").save(folder / "motion.csv")
    motion = lieid.Recording.load(folder / "motion.csv")
    for name, (effects, method) in FITS.items():
        lieid.identify(lieid.Model(robot, effects), train, method=method).save(
            folder / f"fit_{name}.json"
        )
        fit = lieid.Fit.load(folder / f"fit_{name}.json")
        header = ",".join(f"tau{j + 1}" for j in range(fit.model.n))
        np.savetxt(
            folder / f"predicted_{name}.csv", fit.predict(motion),
            fmt="%.17g", delimiter=",", header=header, comments="",
        )  # fmt: skip


if __name__ == "__main__":
    main(Path(sys.argv[1]))
