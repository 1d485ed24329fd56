"""Measure the arm of the demo again, after something has changed: more friction on joint 4."""

import numpy as np

import lieid_casadi as lieid
from lieid_casadi import plant

robot = lieid.robots.panda()
arm = plant.demo_arm(robot, hidden="load_friction", joint=1)
changed = plant.hidden_effect(arm, "viscous_asymmetric", 3)
arm = arm.with_effects(changed)
t = np.arange(0.0, 20.0, 0.001)
motion = plant.FourierTrajectory(robot, base_frequency=0.05, seed=77).at(t)
sensors = plant.demo_sensors(robot)
run = plant.measure_along(arm, t, *motion, sensors=sensors, seed=77, name="later")
run.save("later.csv")
print(f"later.csv: {len(run.t)} rows; added: {changed}")
