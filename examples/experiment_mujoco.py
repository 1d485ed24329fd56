"""A command for `lieid experiment`: an arm in MuJoCo takes the place of the robot.

    lieid experiment two_link --yes -o experiment \
        --record 'python examples/experiment_mujoco.py {trajectory} {recording}'

The command reads a trajectory (t, q, dq, ddq), runs it, and writes what the sensors measured. The
arm is the bundled two_link with other masses and with friction on the shoulder that falls with
speed (Stribeck), which `lieid experiment` is to find. A real robot has a command of the same form.
"""

import argparse
import sys

import mujoco
import numpy as np

ARM = """
<mujoco>
  <option gravity="0 0 -9.81" timestep="0.0005" integrator="implicitfast"/>
  <default><joint solreffriction="0.001 1" solimpfriction="0.99 0.999 0.001"/></default>
  <worldbody>
    <body>
      <joint name="shoulder" axis="0 -1 0" damping="0.5" frictionloss="1.2"/>
      <inertial pos="0.26 0 0" mass="2.2" diaginertia="0.01 0.055 0.055"/>
      <body pos="0.5 0 0">
        <joint name="elbow" axis="0 -1 0" damping="0.2" frictionloss="0.4"/>
        <inertial pos="0.19 0 0" mass="1.1" diaginertia="0.005 0.022 0.022"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator>
</mujoco>
"""
EXCESS, VELOCITY = 1.5, 0.25  # N·m, rad/s: Stribeck friction of the shoulder
STIFFNESS, DAMPING = np.array([4000.0, 1500.0]), np.array([80.0, 25.0])
LIMIT = np.array([40.0, 15.0])  # N·m
RATE = 200.0  # Hz, of the recording
NOISE = np.array([0.05, 0.02])  # N·m, of the measured torque


def run(t, q, dq):
    """Return time, position, velocity and torque that the sensors measure along a trajectory."""
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    data.qpos[:] = q[0]
    dry = model.dof_frictionloss[0]
    every = round(1.0 / RATE / model.opt.timestep)
    steps = np.arange(0.0, t[-1], model.opt.timestep)
    goal = np.column_stack([np.interp(steps, t, column) for column in q.T])
    speed = np.column_stack([np.interp(steps, t, column) for column in dq.T])
    rows = []
    for k, now in enumerate(steps):
        model.dof_frictionloss[0] = dry + EXCESS * np.exp(-((data.qvel[0] / VELOCITY) ** 2))
        tau = data.qfrc_bias + STIFFNESS * (goal[k] - data.qpos) + DAMPING * (speed[k] - data.qvel)
        data.ctrl[:] = np.clip(tau, -LIMIT, LIMIT)
        if k % every == 0:
            rows.append([now, *data.qpos, *data.qvel, *data.ctrl])
        mujoco.mj_step(model, data)
    table = np.array(rows)
    random = np.random.default_rng(len(t))
    table[:, 5:] += NOISE * random.standard_normal((len(table), 2))
    return table


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("trajectory", help="CSV with t, q1, q2, dq1, dq2, …")
    parser.add_argument("recording", help="CSV to write: t, q, dq, tau")
    args = parser.parse_args()
    with open(args.trajectory, encoding="utf-8") as file:
        rows = [line for line in file if not line.startswith("#")]
    table = np.genfromtxt(rows, delimiter=",", names=True)
    q, dq = (np.column_stack([table[f"{kind}{j}"] for j in (1, 2)]) for kind in ("q", "dq"))
    measured = run(table["t"], q, dq)
    header = "t,q1,q2,dq1,dq2,tau1,tau2"
    np.savetxt(args.recording, measured, delimiter=",", header=header, comments="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
