"""A user-defined effect in ten lines: a gear's position error, six periods per turn.

Run this file to identify it on a simulated arm, or use it on the command line:

    lieid identify arm.urdf run.csv --effects-file examples/own_effect.py \
          --effects coulomb,viscous,offset,gear_waves:2
"""

import casadi as ca

import lieid_casadi as lieid


@lieid.effect(
    "gear_waves",
    formula="a·sin(6q) + b·cos(6q)",
    coefficients={"a": "N·m", "b": "N·m"},
    signals=["q"],
)
def gear_waves(s, shape):
    return [ca.sin(6 * s.q), ca.cos(6 * s.q)]


if __name__ == "__main__":
    from lieid_casadi import plant

    robot = lieid.robots.two_link()
    # hidden: 0.4·sin(6q + 0.5) N·m, that is a = 0.351, b = 0.192
    arm = plant.demo_arm(robot, hidden=plant.TorqueRipple(1, 0.4, harmonic=6, phase=0.5))
    motion = plant.FourierTrajectory(robot, seed=1)
    recording = plant.simulate(arm, motion, sensors=plant.demo_sensors(robot))
    for effects in ("coulomb,viscous,offset", "coulomb,viscous,offset,gear_waves:2"):
        fit = lieid.identify(lieid.Model(robot, effects), recording)
        print(f"{effects:38} RMS of joint 2: {fit.rms_cv[1]:.3f} N·m")
    for row in fit.parameter_table()[-2:]:
        print(f"{row['name']} = {row['value']:.3f} ± {row['std']:.3f} {row['unit']}")
