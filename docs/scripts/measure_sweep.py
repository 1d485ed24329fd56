"""Measure joint 2 of a simulated two-link arm forward and back at constant speeds."""

import numpy as np

import lieid_casadi as lieid
from lieid_casadi import plant

robot = lieid.robots.two_link()
arm = plant.demo_arm(robot, hidden="stribeck", joint=1)
speeds = (0.05, 0.1, 0.15, 0.2, 0.4, 0.8, 1.6)
motion = plant.sweep(robot, joint=1, speeds=speeds)
t = np.arange(0.0, motion.duration, 0.01)
sensors = plant.demo_sensors(robot, rate=100.0)
run = plant.measure_along(arm, t, *motion.at(t), sensors=sensors, name="sweep")
run.save("sweep.csv")
print(f"sweep.csv: {len(run.t)} rows, {run.t[-1]:.0f} s")
