"""Measure joint 2 of a simulated two-link arm forward and back at constant speeds."""

from dataclasses import replace

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.excitation import friction_sweep

robot = lieid.robots.two_link()
arm = plant.demo_arm(robot, hidden="stribeck", joint=1)
speeds = (0.05, 0.1, 0.15, 0.2, 0.4, 0.8, 1.6)
motion = friction_sweep(robot, 1, speeds=speeds, seconds=60.0, rate=100.0).motion
sensors = replace(plant.demo_sensors(robot), rate=None)
run = plant.measure_along(
    arm, motion.t, motion.q, motion.dq, motion.ddq, sensors=sensors, name="sweep"
)
run.save("sweep.csv")
print(f"sweep.csv: {len(run.t)} rows, {run.t[-1]:.0f} s")
