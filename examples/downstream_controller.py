"""Exported C in a controller at 1 kHz: computed torque and adaptive control of a simulated arm.

A simulated arm, whose inertias and friction differ from the nominal model's, is identified from one
run. The nominal and the identified model are exported to C and linked into the controller of
``codegen/controller`` (which needs CMake and a C compiler). It then drives the arm. Run this file:

    python examples/downstream_controller.py [--robot panda] [--seconds 10] [-o FOLDER]
"""

import argparse
import ctypes
import shutil
import subprocess
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import lieid_casadi as lieid
from lieid_casadi import export, plant
from lieid_casadi.codegen_files import codegen_folder
from lieid_casadi.plant.simulate import DriveCommand, Stepper

EFFECTS = "coulomb,viscous,offset,load_friction:2"
PERIOD = 1e-3  # s
BANDWIDTH = 25.0  # 1/s
SMOOTH = 0.04  # rad/s, half width of the smooth sign
ADAPTATION = 4.0
COUNTS = 2**19  # of the encoders, per turn
COMPUTED_TORQUE, SLOTINE_LI = 0, 1


@dataclass(frozen=True)
class Run:
    """One run under control, SI units: t (N,), error (N, n), cycle (N,), duration of each cycle."""

    t: np.ndarray
    error: np.ndarray
    cycle: np.ndarray
    parameters: np.ndarray

    def rms(self, first=0.0, last=np.inf):
        part = (self.t >= first) & (self.t < last)
        return float(np.sqrt(np.mean(self.error[part] ** 2)))


def identified(arm):
    """Fit one run of the arm, sampled and noisy."""
    motion = plant.FourierTrajectory(arm.robot, seed=1)
    recording = plant.simulate(arm, motion, sensors=plant.demo_sensors(arm.robot), seed=1)
    return lieid.identify(lieid.Model(arm.robot, EFFECTS), recording)


def nominal(fit):
    """The same model with the robot's own inertias and no effects."""
    parameters = np.zeros_like(fit.parameters)
    parameters[: 10 * fit.model.n] = fit.model.robot.link_parameters
    return replace(fit, parameters=parameters, values=fit.model.base.combination @ parameters)


class Controller:
    """The C controller, linked to an exported model."""

    def __init__(self, fit, folder):
        export(fit, folder / "arm", force=True, to="c")
        configure = ["cmake", "-S", str(codegen_folder() / "controller"), "-B", str(folder / "b")]
        for command in (
            [*configure, f"-DARM_DIR={folder / 'arm'}"],
            ["cmake", "--build", str(folder / "b")],
        ):
            done = subprocess.run(command, capture_output=True, text=True)
            if done.returncode:
                raise SystemExit(f"{' '.join(command)} failed:\n{done.stdout}{done.stderr}")
        (library,) = (folder / "b").glob("libcontroller.*")
        self.c, self.fit = ctypes.CDLL(str(library)), fit
        self.c.controller_cycle.restype = ctypes.c_double

    def settings(self, law, *, adaptation):
        n, count = self.fit.model.n, len(self.fit.parameters)

        class Settings(ctypes.Structure):  # controller_settings of controller.h
            _fields_ = (
                ("law", ctypes.c_int), ("period", ctypes.c_double), ("bandwidth", ctypes.c_double),
                ("adaptation", ctypes.c_double), ("smooth_velocity", ctypes.c_double * n),
                ("sizes", ctypes.c_double * count),
            )  # fmt: skip

        sizes = parameter_sizes(self.fit.model)
        smooth = (ctypes.c_double * n)(*[SMOOTH] * n)
        kept = (ctypes.c_double * count)(*sizes)
        return Settings(law, PERIOD, BANDWIDTH, adaptation, smooth, kept)

    def drive(self, arm, trajectory, law, *, seconds, adaptation=ADAPTATION):
        """Return the run of the arm along a trajectory, which is repeated for ``seconds``."""
        n, steps = arm.n, round(seconds / PERIOD)
        t = PERIOD * np.arange(steps)
        path = np.stack(trajectory.at(t % trajectory.duration), axis=1)  # (N, 3, n)
        state = ctypes.create_string_buffer(self.c.controller_size())
        row = ctypes.POINTER(ctypes.c_double)
        stepper = Stepper(arm, PERIOD, path[0, 0])
        settings, q = self.settings(law, adaptation=adaptation), encoders(stepper.q)
        self.c.controller_begin(state, ctypes.byref(settings), q.ctypes.data_as(row))
        limit, still = arm.robot.limit("torque"), np.zeros(n)
        error, cycle, torque = np.empty((steps, n)), np.empty(steps), np.empty(n)
        temperature = arm.thermal.at(t, n)
        for k in range(steps):
            error[k], q = stepper.q - path[k, 0], encoders(stepper.q)
            arguments = (array.ctypes.data_as(row) for array in (path[k], q, torque))
            cycle[k] = self.c.controller_cycle(state, *arguments)
            command = DriveCommand(
                torque.copy(), still, np.where(np.isfinite(limit), limit, np.inf)
            )
            stepper.step(t[k], command, temperature[k])
        count = len(self.fit.parameters)
        return Run(t, error, cycle, np.frombuffer(state.raw)[-count:].copy())


def encoders(q):
    return np.round(q * COUNTS / (2 * np.pi)) * (2 * np.pi / COUNTS)


def parameter_sizes(model):
    """Scale of each parameter's error: 20 % of the link's mass, at 0.1 m; friction by limit."""
    masses = model.robot.link_parameters[::10]
    links = 0.2 * np.outer(masses, [1.0, *[0.1] * 3, *[0.01] * 6]).ravel()
    scale = 0.03 * plant.torque_scale(model.robot)
    effects = [0.1 if c.unit == "1" else scale[c.joint] for c in model.columns]
    return np.concatenate([links, effects])


def torque_errors(arm, motion, models):
    """RMS error of the models' torque along a motion, joints in motion, N·m."""
    t = np.arange(0.0, motion.duration, 0.01)
    truth, errors = plant.move_along(arm, t, *motion.at(t)), {}
    moving = ~truth.resting
    for name, (fit, parameters) in models.items():
        rigid = fit.compiled.inverse_dynamics(
            truth.q, truth.dq, truth.ddq, parameters[: 10 * arm.n]
        )
        columns = fit.compiled.effect_columns(
            truth.q, truth.dq, truth.ddq, load=rigid, shapes=fit.shapes
        )
        error = rigid + columns @ parameters[10 * arm.n :] - truth.tau
        errors[name] = float(np.sqrt(np.mean(error[moving] ** 2)))
    return errors


def report(runs, period):
    """Print tracking errors and cycle times."""
    print(f"RMS tracking error over all joints, mrad, in each {period:g} s")
    for name, run in runs.items():
        periods = np.arange(0.0, run.t[-1], period)
        errors = ", ".join(f"{1e3 * run.rms(t, t + period):.2f}" for t in periods)
        print(f"  {name:32} {errors}")
    print(f"control cycle, µs of {1e6 * PERIOD:.0f}: median, 99.9 %, worst (with interruptions)")
    for name, run in runs.items():
        middle, most = 1e6 * np.quantile(run.cycle, [0.5, 0.999])
        print(f"  {name:32} {middle:.2f}, {most:.2f}, {1e6 * run.cycle.max():.1f}")


def plot(runs, file):
    """Draw the error's norm, smoothed over 0.2 s."""
    import matplotlib.pyplot as plt

    figure, ax = plt.subplots(figsize=(8, 4), layout="constrained")
    window = np.full(200, 1 / 200)
    for name, run in runs.items():
        size = np.sqrt(np.convolve(np.mean(run.error**2, axis=1), window, mode="same"))
        ax.semilogy(run.t, 1e3 * size, label=name)
    ax.set(xlabel="t, s", ylabel="tracking error, mrad", title="Exported C at 1 kHz")
    ax.legend()
    figure.savefig(file, dpi=120)
    plt.close(figure)


def main(words=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robot", default="panda")
    parser.add_argument("--seconds", type=float, default=10.0, help="of each computed-torque run")
    parser.add_argument("-o", "--output", type=Path, help="folder for the plot")
    args = parser.parse_args(words)
    if shutil.which("cmake") is None:
        raise SystemExit("this example needs CMake and a C compiler, e.g. apt install cmake gcc")

    robot = lieid.Robot.load(args.robot)
    arm = plant.demo_arm(robot, joint=1)
    fit = identified(arm)
    motion = plant.FourierTrajectory(robot, seed=7, base_frequency=0.2)  # not the one of the fit
    with tempfile.TemporaryDirectory() as scratch:
        before = Controller(nominal(fit), Path(scratch, "nominal"))
        after = Controller(fit, Path(scratch, "identified"))
        seconds = args.seconds
        runs = {
            "computed torque, nominal": before.drive(arm, motion, COMPUTED_TORQUE, seconds=seconds),
            "computed torque, identified": after.drive(
                arm, motion, COMPUTED_TORQUE, seconds=seconds
            ),
            "Slotine-Li, from nominal": before.drive(arm, motion, SLOTINE_LI, seconds=3 * seconds),
        }
    report(runs, motion.duration)
    adapted = runs["Slotine-Li, from nominal"].parameters
    models = {
        "nominal": (fit, nominal(fit).parameters),
        "identified": (fit, fit.parameters),
        "adapted": (fit, adapted),
    }
    print("RMS error of the model's torque along the motion, N·m")
    for name, error in torque_errors(arm, motion, models).items():
        print(f"  {name:32} {error:.3f}")
    if args.output is not None:
        args.output.mkdir(parents=True, exist_ok=True)
        plot(runs, args.output / "tracking.png")
        print(f"plot: {args.output / 'tracking.png'}")
    return runs


if __name__ == "__main__":
    main()
