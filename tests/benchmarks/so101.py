# ruff: noqa: T201
"""Identify a MuJoCo model of the SO-101 with altered drives from one recording, and compare it.

The altered arm has other inertias, friction, armature, backlash and command delay than the nominal
model. One recording of commands and measured positions (4096 counts per turn) goes to lieid and to
MuJoCo's own ``mujoco.sysid``; both models, and the nominal one, then follow new commands. Reported
are the differences from the altered arm at the ends of 1 s windows that start in its state, the
time, and the lines of user code.

    python tests/benchmarks/so101.py [--case backlash] [--seconds 30] [--rate 50] [--step 0.002]

Cases: ``hold``, commands that are late by their hold alone; ``delay``, by 40 ms more;
``saturation`` and ``half``, torques limited to 80 and 50 % of what the recording without a limit
reaches; ``backlash``, 0.8° in every joint and the delay. ``--diagnose``: also what `diagnose` makes
of the default model. ``--seed``: of the arm and its motions. ``--step``: of both simulations.
MuJoCo's integration adds half a step × damping to the inertia, 3 % of a joint's at 2 ms; it is in
what was recorded, and the exported model makes up for it.
"""

from __future__ import annotations

import argparse
import inspect
import re
import sys
import time
from pathlib import Path

import mujoco
import numpy as np

import lieid_casadi as lieid
from lieid_casadi.exporters.mjcf import mjcf_text

sys.path.insert(0, str(Path(__file__).parents[1]))
from exporters.c_arms import made_fit

ROBOT = lieid.robots.so101().with_drives(lieid.servo_drive("sts3215"))
N, STEP, RATE = ROBOT.n, 0.002, 50.0  # s, Hz of commands and recording
#: Play of every joint, rad, delay of commands, s, and limit of torque relative to the largest one.
CASES = {
    "hold": (0.0, 0.0, np.inf),
    "delay": (0.0, 0.04, np.inf),
    "saturation": (0.0, 0.0, 0.8),
    "half": (0.0, 0.0, 0.5),
    "backlash": (np.radians(0.8), 0.04, np.inf),
}
PLAY, DELAY, LIMIT = CASES["backlash"]
SEED = 0  # of the arm, and of its motions
COUNTS = 4096
EFFECTS = "coulomb,viscous,offset,armature,command_delay"  # the default


def nominal_xml() -> str:
    """Return the model without identification: CAD inertias, data-sheet servo, no friction."""
    fit = made_fit(ROBOT, "")
    fit.parameters[:] = ROBOT.link_parameters
    return mjcf_text(fit)[0]


def linear(damping: float) -> np.ndarray:
    """Return the coefficients of the polynomial that MuJoCo 4 has for damping."""
    return np.array([damping, 0.0, 0.0])


def altered_model() -> mujoco.MjModel:
    """Return the arm that is measured: its motor positions are qpos of the joints with actuators.

    Backlash is a second joint of each link, within a range of ±play/2.
    """
    random = np.random.default_rng(SEED)
    xml = nominal_xml()

    def with_play(match: re.Match[str]) -> str:
        joint = match.group(0)
        axis = re.search(r'axis="[^"]*"', joint).group(0)
        name = re.search(r'name="([^"]*)"', joint).group(1)
        half = PLAY / 2
        play = (
            f'<joint name="{name}_play" type="hinge" {axis} range="{-half} {half}" '
            'damping="0.01" armature="0.0005" solreflimit="0.004 1"/>'
        )
        return joint + play

    if PLAY:
        xml = re.sub(r"<joint [^>]*/>", with_play, xml)
    spec = mujoco.MjSpec.from_string(xml)
    spec.option.timestep = STEP
    for joint in ROBOT.joints:
        real = spec.joint(joint.name)
        real.armature = random.uniform(0.01, 0.03)
        real.frictionloss = random.uniform(0.03, 0.1)
        real.damping = linear(real.damping[0] + random.uniform(0.02, 0.15))
    for body in spec.bodies[1:]:
        factor = random.uniform(0.8, 1.3)
        body.mass *= factor
        body.fullinertia = np.asarray(body.fullinertia) * factor
    model = spec.compile()
    model.actuator_delay[:] = 0.0
    return model


def saturated(model: mujoco.MjModel, seconds: float) -> mujoco.MjModel:
    """Return the arm with torques limited relative to the largest ones of the recording."""
    if np.isfinite(LIMIT):
        arm, path = Arm(model, DELAY), commands(1, seconds)
        arm.set(path[0], np.zeros(N))
        largest = np.zeros(N)
        for k in range(len(path) - 1):
            arm.run(path, k, 1)
            largest = np.maximum(largest, np.abs(arm.data.actuator_force))
        model.actuator_forcerange[:] = LIMIT * largest[:, None] * [-1.0, 1.0]
    return model


def commands(seed: int, seconds: float) -> np.ndarray:
    """Return commands (K, n) at the command rate: sums of harmonics within the limits."""
    random, t = np.random.default_rng(10 * SEED + seed), np.arange(round(seconds * RATE)) / RATE
    lower, upper = ROBOT.limit("position_lower"), ROBOT.limit("position_upper")
    path = np.zeros((len(t), N))
    for k in range(1, 13):
        phase = random.uniform(0, 2 * np.pi, N)
        path += random.normal(size=N) * np.sin(2 * np.pi * 0.1 * k * t[:, None] + phase)
    path *= 0.2 * (upper - lower) / np.abs(path).max(axis=0)
    return 0.5 * (lower + upper) + path


class Arm:
    """A MuJoCo model under commands that are held, and delayed by whole steps.

    The delay is not left to the actuators, whose buffers a reset to a window's start empties.
    """

    def __init__(self, model: mujoco.MjModel, delay: float | np.ndarray = 0.0) -> None:
        self.model, self.data = model, mujoco.MjData(model)
        self.delay = np.round(np.broadcast_to(delay, N) / STEP).astype(int)
        self.motors = [model.joint(j.name).qposadr[0] for j in ROBOT.joints]
        self.speeds = [model.joint(j.name).dofadr[0] for j in ROBOT.joints]

    def run(self, path: np.ndarray, start: int, count: int) -> np.ndarray:
        """Return positions (count + 1, n) at the command rate from the present state on."""
        hold, rows = round(1.0 / RATE / STEP), [self.data.qpos[self.motors].copy()]
        for k in range(count * hold):
            now = np.maximum((start * hold + k - self.delay) // hold, 0)
            self.data.ctrl[:] = path[now, np.arange(N)]
            mujoco.mj_step(self.model, self.data)
            if (k + 1) % hold == 0:
                rows.append(self.data.qpos[self.motors].copy())
        return np.array(rows)

    def set(self, q: np.ndarray, dq: np.ndarray) -> None:
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[self.motors], self.data.qvel[self.speeds] = q, dq


def recorded(seed: int, seconds: float) -> tuple[lieid.Recording, np.ndarray]:
    """Return the altered arm's recording, and its motor velocities (K, n)."""
    arm, path = Arm(saturated(altered_model(), seconds), DELAY), commands(seed, seconds)
    arm.set(path[0], np.zeros(N))
    q = [arm.data.qpos[arm.motors].copy()]
    dq = [arm.data.qvel[arm.speeds].copy()]
    for k in range(len(path) - 1):
        q.append(arm.run(path, k, 1)[-1])
        dq.append(arm.data.qvel[arm.speeds].copy())
    quantum = 2 * np.pi / COUNTS
    measured = np.round(np.array(q) / quantum) * quantum
    t = np.arange(len(path)) / RATE
    return lieid.Recording.from_arrays(t, measured, command=path, name="run.csv"), np.array(dq)


def tracking(
    model: mujoco.MjModel, test: lieid.Recording, dq: np.ndarray, delay: float | np.ndarray
) -> np.ndarray:
    """Return the differences from the altered arm at the ends of 1 s windows, rad (W, n)."""
    arm, length = Arm(model, delay), round(RATE)
    ends = []
    for start in range(length, len(test) - length, length):
        arm.set(test.q[start], dq[start])
        ends.append(arm.run(test.command, start, length)[-1] - test.q[start + length])
    return np.array(ends)


def with_lieid(train: lieid.Recording, *, diagnosed: bool) -> tuple[mujoco.MjModel, np.ndarray]:
    """Return the model that lieid identifies and exports, and its delays beyond the hold."""
    train, model = train.with_drives(ROBOT.drives), lieid.Model(ROBOT, EFFECTS)
    if diagnosed:
        found = lieid.diagnose(model, train, method="feasible")
        print(f"found: {', '.join(f'{s.label} ({s.status})' for s in found.steps)}")
        fit = found.fit
    else:
        fit = lieid.identify(model, train, method="feasible")
    model = mujoco.MjModel.from_xml_string(mjcf_text(fit, step=STEP)[0])
    delay = np.maximum(model.actuator_delay - 0.5 / RATE, 0.0)
    model.actuator_delay[:] = 0.0
    return model, delay


def with_sysid(train: lieid.Recording, dq: np.ndarray) -> mujoco.MjModel:
    """Return the model that MuJoCo's own toolbox identifies: drives and masses.

    It is given the true delay of the commands and the true velocities.
    """
    from mujoco import sysid

    spec = mujoco.MjSpec.from_string(nominal_xml())
    for joint in ROBOT.joints:
        spec.add_sensor(
            name=joint.name, type=mujoco.mjtSensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=joint.name,
        )  # fmt: skip
    model = spec.compile()
    params = sysid.ParameterDict()
    bounds = {"armature": (0.001, 0.1), "damping": (0.05, 2.0), "frictionloss": (0.0, 0.5)}
    for j in ROBOT.joints:
        for key, (low, high) in bounds.items():
            form = linear if key == "damping" else float
            change = lambda s, p, n=j.name, k=key, f=form: setattr(  # noqa: E731
                s.joint(n), k, f(p.value[0])
            )
            start = {"armature": 0.01, "damping": 0.45, "frictionloss": 0.05}[key]
            params.add(sysid.Parameter(f"{j.name}_{key}", start, low, high, modifier=change))
    for body in spec.bodies[1:]:
        scale = lambda s, p, n=body.name: setattr(s.body(n), "mass", p.value[0])  # noqa: E731
        params.add(sysid.Parameter(f"{body.name}_mass", body.mass, 0.5 * body.mass,
                                   2.0 * body.mass, modifier=scale))  # fmt: skip
    sequences, length, hold = [], round(2 * RATE), round(1.0 / RATE / STEP)
    late = round(DELAY / STEP)
    for start in range(length, len(train) - length - 1, length):
        rows = slice(start, start + length + 1)
        t = np.arange(length * hold) * STEP
        held = train.command[(start * hold + np.arange(length * hold) - late) // hold]
        state = sysid.create_initial_state(model, train.q[start], dq[start], np.zeros(0))
        times = train.t[rows] - train.t[start]
        sensors = sysid.TimeSeries.from_names(times[1:], train.q[rows][1:], model)
        sequences.append(
            sysid.ModelSequences(
                "so101", spec, f"w{start}", state, sysid.TimeSeries(t, held), sensors
            )
        )
    found, _ = sysid.optimize(
        initial_params=params,
        residual_fn=sysid.build_residual_fn(models_sequences=sequences),
        optimizer="mujoco",
        verbose=False,
        max_iters=15,
    )
    return sysid.apply_param_modifiers(found, spec)


def lines(function: object) -> int:
    """Return the lines of code of a function, without its docstring and signature."""
    return sum(bool(line.strip()) for line in inspect.getsource(function).splitlines()[2:])


def main() -> None:
    global RATE, STEP, PLAY, DELAY, LIMIT, EFFECTS, SEED
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--case", choices=CASES, default="backlash")
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--rate", type=float, default=RATE, help="Hz")
    parser.add_argument("--step", type=float, default=STEP, help="s")
    parser.add_argument("--effects", default=EFFECTS)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--diagnose", action="store_true")
    parser.add_argument("--no-sysid", action="store_true")
    args = parser.parse_args()
    RATE, STEP, EFFECTS, SEED = args.rate, args.step, args.effects, args.seed
    PLAY, DELAY, LIMIT = CASES[args.case]
    train, dq = recorded(1, args.seconds)
    test, test_dq = recorded(2, args.seconds)
    nominal = mujoco.MjModel.from_xml_string(nominal_xml())
    nominal.opt.timestep = STEP
    rows = [("nominal", tracking(nominal, test, test_dq, 0.0), 0.0, 0)]
    for diagnosed in (False, True) if args.diagnose else (False,):
        started = time.time()
        model, delay = with_lieid(train, diagnosed=diagnosed)
        spent = time.time() - started
        error = tracking(model, test, test_dq, delay)
        rows.append(("diagnosed" if diagnosed else "default", error, spent, lines(with_lieid)))
        found = ", ".join(f"{1e3 * d:.1f}" for d in delay)
        print(f"delays identified: {found} ms; true: {1e3 * DELAY:.1f} ms")
    if not args.no_sysid:
        started = time.time()
        model = with_sysid(train, dq)
        spent = time.time() - started
        error = tracking(model, test, test_dq, DELAY)
        rows.append(("mujoco.sysid", error, spent, lines(with_sysid)))
    base = np.sqrt(np.mean(rows[0][1] ** 2))
    joints = " ".join(f"joint{j + 1}" for j in range(N))
    print(f"RMS after 1 s, deg  {joints}       all (std)    factor  time  lines")
    for name, ends, spent, count in rows:
        windows = np.mean(ends**2, axis=1)
        every = np.sqrt(windows.mean())
        std = windows.std(ddof=1) / (2.0 * every * np.sqrt(len(windows)))
        joints = " ".join(f"{x:6.3f}" for x in np.degrees(np.sqrt(np.mean(ends**2, axis=0))))
        print(
            f"{name:19s} {joints}; {np.degrees(every):6.3f} ± {np.degrees(std):.3f} "
            f"{base / every:6.1f} {spent:6.1f} s {count:4d}"
        )


if __name__ == "__main__":
    main()
