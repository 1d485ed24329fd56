"""Experiments on simulated arms with friction of others' formulas: what is named, and how soon.

    python tests/benchmarks/experiments.py [--worlds 6] [--first 0] [--arm two_link] [--json FILE]

Each world is an arm (Pinocchio) with one hidden effect, written independently of the package:
friction of Rhoban's servo models M2 to M6, LuGre, Maxwell slip, cogging, a spring, cubic viscosity,
a torque filter; M1 (Coulomb and viscous) hides nothing. The first recording is a slow sine of all
joints. Then the experiment goes on for two recordings at most. When all worlds are done, fixed
plans record one standard excitation of 20 s, or of 10 s, after the other until the same is named,
for comparison; they do without the first recording.

Goals: the right effect on the right joint within three recordings in 90 % of the worlds, a wrong
name in at most 2 %, no name in empty worlds, in at most half the recording time of the fixed plan.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hidden_effects.effect_library import MISSING, ReferenceMotion, ScalableEffect
from hidden_effects.foreign import FORMS, foreign

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.plant.trajectories import Envelope

EFFECTS = "coulomb,viscous,offset"
RATE = 200.0  # Hz, of the sensors
MORE = 2  # recordings after the first
SECONDS = 20.0  # of the longest motion
FIXED = (20.0, 10.0)  # s, of the standard excitations of a plan
STANDARD = 4  # of them at most
SIZE = 0.5  # of a form, relative to the joint's Coulomb friction
PARTS = {"torque_ripple": 0.15, "position_spring": 0.4, "viscous_polynomial": 0.3}  # of `most`


def lugre(g, j):
    """Return LuGre friction (without its damping) in place of the sign of dry friction."""
    width, v = g.log(0.005, 0.05), g.log(0.03, 0.15) * float(g.speed[j])
    excess = float(g.random.uniform(0.3, 1.0))

    def torque(s):
        q, dq = s.q[..., j], s.dq[..., j]
        level = 1.0 + excess * np.exp(-((dq / v) ** 2))
        z = np.zeros(len(q))
        for k in range(1, len(q)):
            move = q[k] - q[k - 1]
            steady = level[k] * np.sign(move)
            z[k] = steady + (z[k - 1] - steady) * np.exp(-abs(move) / (width * level[k]))
        return z - s.sign[..., j]

    made = foreign("lugre", j, (), torque, simulated=False)
    return ScalableEffect(
        "lugre", (j,), made.hide, float(g.arm.friction.coulomb[j]),
        accepted=("presliding", "stribeck"),
    )  # fmt: skip


KINDS = {
    "bam_m1": None,
    **{f"bam_m{k}": FORMS[f"bam_m{k}"] for k in range(2, 7)},
    "lugre": lugre,
    "maxwell_slip": FORMS["maxwell_slip"],
    "cogging": MISSING["torque_ripple"],
    "spring": MISSING["position_spring"],
    "cubic": MISSING["viscous_polynomial"],
    "torque_filter": MISSING["torque_lowpass"],
}
#: A world for each kind on each arm, the arms in turn; then the same with other draws.
WORLDS = [
    (kind, ("two_link", "panda")[(k + turn) % 2], turn)
    for turn in range(28)
    for k, kind in enumerate(KINDS)
]


def hidden(kind, arm, random):
    """Return the arm with its hidden effect, names that are right, and joints (from 0)."""
    if KINDS[kind] is None:
        return arm, (), ()
    motion = plant.FourierTrajectory(arm.robot, base_frequency=0.05, seed=int(random.integers(99)))
    t = np.arange(0.0, motion.duration, 0.01)
    along = plant.move_along(arm, t, *motion.at(t))
    g = ReferenceMotion(
        arm, plant.torque_scale(arm.robot), np.abs(along.dq).max(axis=0),
        np.sqrt(np.mean(along.dq**2, axis=0)), np.abs(along.rigid).max(axis=0),
        along.q.min(axis=0), along.q.max(axis=0), motion.duration, RATE, (), random,
    )  # fmt: skip
    effect = KINDS[kind](g, int(random.integers(min(arm.n, 4))))
    coulomb = float(arm.friction.coulomb[effect.joints[0]])
    strength = SIZE * coulomb
    if effect.effect in ("maxwell_slip", "lugre"):
        strength = coulomb
    elif effect.effect in PARTS:
        strength = PARTS[effect.effect] * effect.most
    elif effect.effect == "torque_lowpass":
        strength = 0.02  # s
    return effect.hide(arm, strength, 0), effect.accepted or (effect.effect,), effect.joints


def slow_sine(arm):
    """Return a slow sine of all joints about the middle of their ranges."""
    t = np.arange(0.0, SECONDS, 0.001)
    w, size = 2.0 * np.pi * 0.15 * (1.0 + 0.1 * np.arange(arm.n)), 0.3
    angle = np.outer(t, w)
    middle = Envelope.of(arm.robot).middle
    return t, middle + size * np.sin(angle), size * w * np.cos(angle), -size * w**2 * np.sin(angle)


def measured(arm, t, q, dq, ddq, seed):
    sensors = plant.demo_sensors(arm.robot, rate=RATE)
    return plant.measure_along(arm, t, q, dq, ddq, sensors=sensors, seed=seed)


def score(diagnosis, accepted, joints):
    """Return whether the hidden effect is named, and names that are wrong."""
    named = [step for step in diagnosis.steps if step.status == "named"]
    right = [s for s in named if s.effect in accepted and set(s.joints) & set(joints)]
    wrong = [step.label for step in named if step not in right]
    return bool(right) or not accepted, wrong


def fixed_plan(arm, accepted, joints, excitations):
    """Return the recording time after which standard excitations name the effect; None if none."""
    recordings = []
    for k, motion in enumerate(excitations):
        recordings.append(measured(arm, motion.t, motion.q, motion.dq, motion.ddq, 50 + k))
        found = lieid.diagnose(lieid.Model(arm.robot, EFFECTS), recordings)
        right, wrong = score(found, accepted, joints)
        if right and not wrong:
            return float(sum(each.t[-1] for each in excitations[: k + 1]))
    return None


def world(number):
    """Return the arm of a world, names that are right, and joints (from 0)."""
    kind, robot_name, turn = WORLDS[number]
    plain = plant.demo_arm(lieid.Robot.load(robot_name), seed=number, hidden=None)
    return hidden(kind, plain, np.random.default_rng([number, turn, 7]))


def run(number):
    """Return what an experiment in a world named, and its recording time."""
    kind, robot_name, turn = WORLDS[number]
    arm, accepted, joints = world(number)
    first = measured(arm, *slow_sine(arm), 1)

    def record(motion):
        s = motion.samples
        return measured(arm, s.t, s.q, s.dq, s.ddq, 1 + motion.number)

    begin = time.process_time()
    result = lieid.experiment(
        arm.robot, first, record=record, most=MORE, longest=SECONDS, seed=number
    )
    seconds = time.process_time() - begin
    right, wrong = score(result.diagnosis, accepted, joints)
    return {
        "number": number, "world": f"{kind} {robot_name} {turn}",
        "hidden": [list(accepted), [j + 1 for j in joints]],
        "right": right, "wrong": wrong, "stopped": result.stopped,
        "recordings": len(result.rounds), "recorded": result.seconds,
        "purposes": [r.purpose.kind for r in result.rounds if r.purpose],
        "open": [" or ".join(group) for group in result.rounds[-1].open],
        "reason": result.reason, "processor_seconds": seconds,
    }  # fmt: skip


def standard(robot):
    """Return the excitations of each fixed plan."""
    model = lieid.Model(robot, EFFECTS)
    return [
        [lieid.excite(model, duration=each, starts=1, seed=k).motion() for k in range(STANDARD)]
        for each in FIXED
    ]


def write(rows, file):
    """Print the counts, and write the worlds so far."""
    right = sum(row["right"] for row in rows)
    wrong = sum(bool(row["wrong"]) for row in rows)
    sys.stdout.write(f"{right} of {len(rows)} right, {wrong} with a wrong name")
    for k, seconds in enumerate(FIXED):
        both = [r for r in rows if r["right"] and r.get("fixed", [None] * len(FIXED))[k]]
        loop, plan = sum(r["recorded"] for r in both), sum(r["fixed"][k] for r in both)
        if both:
            sys.stdout.write(
                f"; {len(both)} right with excitations of {seconds:g} s, too: "
                f"{loop:.0f} s recorded for {plan:.0f} s ({loop / plan:.2f})"
            )
    sys.stdout.write("\n")
    sys.stdout.flush()
    if file:
        Path(file).write_text(json.dumps(rows, indent=1), encoding="utf-8")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", type=int, default=6, help=f"how many, up to {len(WORLDS)}")
    parser.add_argument("--first", type=int, default=0, help="number of the first, from 0")
    parser.add_argument("--arm", choices=("two_link", "panda"), help="worlds of this arm alone")
    parser.add_argument("--json", help="file to write, after each world")
    args = parser.parse_args()
    rows, excitations = [], {}
    chosen = [k for k, (_, arm, _) in enumerate(WORLDS) if args.arm in (None, arm)]
    for number in chosen[args.first : args.first + args.worlds]:
        row = run(number)
        rows.append(row)
        sys.stdout.write(
            f"{row['world']:24} {'right' if row['right'] else 'missed':7} wrong {row['wrong']} "
            f"{row['stopped']} after {row['recordings']} recordings, {row['recorded']:.0f} s, "
            f"{row['processor_seconds']:.0f} s of processor time; "
            f"{', '.join(row['purposes'])}; open {row['open']}\n"
        )
        write(rows, args.json)
    for row in rows:
        arm, accepted, joints = world(row["number"])
        name = WORLDS[row["number"]][1]
        if name not in excitations:
            excitations[name] = standard(arm.robot)
        row["fixed"] = [fixed_plan(arm, accepted, joints, plan) for plan in excitations[name]]
        sys.stdout.write(f"{row['world']:24} fixed plans {row['fixed']} s\n")
        write(rows, args.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
