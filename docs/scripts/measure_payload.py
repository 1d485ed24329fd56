"""Measure the simulated Panda without and with a payload of 2 kg; torques and motor currents."""

import numpy as np

import lieid_casadi as lieid
from lieid_casadi import plant

CONSTANTS = np.array([14.9, 13.3, 11.1, 10.6, 11.0, 11.5, 9.0])  # N·m/A

robot = lieid.robots.panda()
empty = plant.demo_arm(robot, hidden=None)
loaded = empty.with_effects(plant.Payload(mass=2.0, com=(0.03, -0.02, 0.08), radius=0.06))
t = np.arange(0.0, 30.0, 0.005)
motion = plant.FourierTrajectory(robot, base_frequency=1 / 30, seed=5).at(t)
header = "t," + ",".join(f"{name}{j}" for name in ("q", "i") for j in range(1, 8))
for seed, (name, arm) in enumerate({"empty": empty, "loaded": loaded}.items()):
    sensors = plant.demo_sensors(robot)
    run = plant.measure_along(arm, t, *motion, sensors=sensors, seed=seed, name=name)
    run.save(f"{name}.csv")
    table = np.column_stack([run.t, run.q, run.tau / CONSTANTS])
    np.savetxt(f"{name}_currents.csv", table, delimiter=",", header=header, comments="")
    print(f"{name}.csv, {name}_currents.csv: {len(run.t)} rows")
