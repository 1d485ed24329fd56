"""How often `lieid.check` finds what is wrong, and how often it finds something that is not.

    python tests/benchmarks/premises.py [--arms 20] [--draws 200] [--only NAME…] [--list]

Twelve corruptions of every recording in the folder that ``LIEID_RECORDINGS`` names (see
tests/real_arms.py) and of simulated arms without hidden effects (tests/hidden_effects): base
turned by 90° and 20°, joints exchanged in all signals and in the torques alone, sign of a torque,
direction of an axis, zero by 90°, milliseconds, amperes, gravity compensated, torque 40 ms late,
velocity filtered at 0.2 s; and recordings checked against another arm with as many joints. The
first finding must name the premise, with its value within 5° or 10 ms. A corruption that changes no
error of the plain fit by 5 % (the zero of a joint that turns about gravity) is harmless, cannot be
found and is counted apart. ``--draws`` clean simulated arms count false findings.
"""

from __future__ import annotations

import argparse
import contextlib
import resource
import sys
import zlib
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hidden_effects.arms import load_arm
from hidden_effects.case_setup import Case
from hidden_effects.generator import Unreachable, draw
from hidden_effects.worlds import Measured
from real_arms import FINGERS, PANDA, TX40, UR10E
from scipy.signal import lfilter

import lieid_casadi as lieid
from lieid_casadi.plant import measure
from lieid_casadi.premises import check, timing
from lieid_casadi.premises.correction import Correction, shifted
from lieid_casadi.premises.plain_fit import samples_of
from lieid_casadi.premises.screen import Screen

UR_RUNS = ("excitation_30s", "excitation_50s", "excitation_14_harmonics", "point_to_point")
TORQUE_CONSTANTS = (14.9, 13.3, 11.1, 10.6, 11.0, 11.5, 9.8)
ANGLE, SECONDS = np.radians(5.0), 0.010


def real():
    """Yield name, robot and recording of the real arms."""
    panda = lieid.Robot.from_urdf(PANDA / "panda.urdf", lock=FINGERS)
    yield "panda", panda, lieid.Recording.load(PANDA / "excitation.csv.gz")
    yield (
        "tx40",
        lieid.Robot.from_urdf(TX40 / "tx40.urdf"),
        lieid.Recording.load(TX40 / "excitation.csv.gz"),
    )
    for run in UR_RUNS:
        yield f"ur10e-{run}", load_arm("ur10e"), lieid.Recording.load(UR10E / f"{run}.csv.gz")


def simulated(count, first=0):
    """Yield name, robot and recording of simulated arms without hidden effects."""
    made = 0
    for k in range(first, 10 * count + first):
        if made == count:
            return
        with contextlib.suppress(Unreachable, lieid.LieidError):
            drawn = draw(Case("none", 100 + k))
            recording = measure(drawn.arms[0], drawn.motions[0], drawn.sensors, seed=k)
            run = Measured(
                recording, drawn.arms[0], drawn.motions[0], drawn.noise, np.random.default_rng(k)
            )
            made += 1
            yield f"{drawn.arm_name}-{k}", load_arm(drawn.arm_name), drawn.world.record(run)


def pair(n, random):
    i, j = random.choice(n, 2, replace=False)
    order = np.arange(n)
    order[[i, j]] = order[[j, i]]
    return order, sorted((int(i) + 1, int(j) + 1))


def turned(angle):
    def corrupt(robot, recording, random):
        axis = random.choice([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        g = np.asarray(robot.gravity, dtype=float)
        said = np.cos(angle) * g + np.sin(angle) * np.cross(axis, g)
        right = lambda f: angle_between(f.value["gravity"], g) < ANGLE  # noqa: E731
        return replace(robot, gravity=said), recording, ("gravity_direction", right)

    return corrupt


def angle_between(a, b):
    return np.arccos(np.clip(np.dot(a, b) / np.linalg.norm(a) / np.linalg.norm(b), -1.0, 1.0))


def applied(recording, **changes):
    return Correction(
        **({"position": np.eye(recording.n), "zero": np.zeros(recording.n),
            "torque": np.eye(recording.n)} | changes)
    ).of_recording(recording)  # fmt: skip


def joints_swapped(robot, recording, random):
    order, joints = pair(robot.n, random)
    right = lambda f: f.value["signals"] == "all" and [j + 1 for j in f.joints] == joints  # noqa: E731
    return robot, applied(recording, position=np.eye(robot.n)[order]), ("joint_order", right)


def torques_swapped(robot, recording, random):
    order, joints = pair(robot.n, random)
    right = lambda f: f.value["signals"] == "torque" and [j + 1 for j in f.joints] == joints  # noqa: E731
    return robot, applied(recording, torque=np.eye(robot.n)[order]), ("joint_order", right)


def flipped(random, n):
    j = int(random.integers(n))
    sign = np.ones(n)
    sign[j] = -1.0
    return np.diag(sign), lambda f: f.joints == (j,)


def torque_sign(robot, recording, random):
    matrix, right = flipped(random, robot.n)
    return robot, applied(recording, torque=matrix), ("torque_sign", right)


def axis(robot, recording, random):
    matrix, right = flipped(random, robot.n)
    return robot, applied(recording, position=matrix), ("joint_sign", right)


def zero(robot, recording, random):
    j = int(random.choice([k for k, joint in enumerate(robot.joints) if joint.revolute]))
    x = float(random.choice([-0.5, 0.5]) * np.pi)
    right = lambda f: f.joints == (j,) and abs(f.value["rad"] + x) < ANGLE  # noqa: E731
    return robot, applied(recording, zero=x * np.eye(robot.n)[j]), ("joint_zero", right)


def milliseconds(robot, recording, random):
    recording = replace(recording, t=recording.t * 1e3)
    return robot, recording, ("time_unit", lambda f: f.value["unit"] == "ms")


def amperes(robot, recording, random):
    constants = np.array(TORQUE_CONSTANTS[: robot.n])
    return robot, replace(recording, tau=recording.tau / constants), ("torque_unit", lambda f: True)


def gravity_compensated(robot, recording, random):
    """Take out the gravity of a fitted model, as a controller has it."""
    screen, still = Screen(robot, samples_of([recording]), most=1500), np.zeros_like(recording.q)
    columns = screen.arm.columns(recording.q, still, still, robot.gravity)
    gravity = np.einsum("jkn,k->nj", columns, screen.base.free.base)
    return robot, replace(recording, tau=recording.tau - gravity), (
        "torque_gravity_compensated", lambda f: True,
    )  # fmt: skip


def torque_late(robot, recording, random):
    tau = np.concatenate([shifted(s.t, s.tau, -0.04) for s in recording.segments()])
    own = [a.value["seconds"] for a in timing.delays(Screen(robot, samples_of([recording])))]
    late = 0.04 + sum(own)  # torque of real drives is late by itself
    right = lambda f: abs(f.value["seconds"] - late) < SECONDS  # noqa: E731
    return robot, replace(recording, tau=tau), ("time_offset", right)


def velocity_filtered(robot, recording, random):
    parts = []
    for s in recording.segments():
        dq = s.dq if s.dq is not None else np.gradient(s.q, s.t, axis=0)
        keep = np.exp(-s.duration / (len(s) - 1) / 0.2)
        parts.append(lfilter([1.0 - keep], [1.0, -keep], dq, axis=0))
    right = lambda f: abs(f.value["seconds"] - 0.2) < SECONDS  # noqa: E731
    return robot, replace(recording, dq=np.concatenate(parts)), ("velocity_signal", right)


CORRUPTIONS = {
    "base by 90°": turned(np.pi / 2.0),
    "base by 20°": turned(np.radians(20.0)),
    "joints exchanged": joints_swapped,
    "torques exchanged": torques_swapped,
    "sign of a torque": torque_sign,
    "direction of an axis": axis,
    "zero by 90°": zero,
    "milliseconds": milliseconds,
    "amperes": amperes,
    "gravity compensated": gravity_compensated,
    "torque 40 ms late": torque_late,
    "velocity filtered at 0.2 s": velocity_filtered,
}
SILENT = ("milliseconds", "velocity filtered at 0.2 s")


def harmless(name, robot, recording, corrupted_robot, corrupted):
    """Whether a corruption changes no error of the plain fit by 5 %."""
    if name in SILENT:
        return False
    before, after = (
        Screen(arm, samples_of([r]), most=1500).base.relative
        for arm, r in ((robot, recording), (corrupted_robot, corrupted))
    )
    return bool(np.all(after < 1.05 * before))


def seconds():
    return sum(resource.getrusage(resource.RUSAGE_SELF)[:2])


def corrupted_cases(cases, only, shown):
    counts = {name: Counter() for name in only}
    times = []
    for label, robot, recording in cases:
        for name in only:
            random = np.random.default_rng(zlib.crc32(f"{label} {name}".encode()))
            arm, made, (premise, right) = CORRUPTIONS[name](robot, recording, random)
            if harmless(name, robot, recording, arm, made):
                counts[name]["harmless"] += 1
                continue
            start = seconds()
            found = check(arm, made)
            times.append(seconds() - start)
            first = found.findings[0] if found.findings else None
            ok = first is not None and first.premise == premise and right(first)
            counts[name]["right" if ok else "other"] += 1
            counts[name]["wrong"] += found.verdict == "wrong"
            if shown and not ok:
                said = [
                    (f.premise, [j + 1 for j in f.joints], dict(f.value), f.ratio)
                    for f in found.findings
                ]
                print(f"  {label}, {name}: {found.verdict} {said[:2]}", flush=True)
    return counts, times


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--arms", type=int, default=20)
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", nargs="+", default=list(CORRUPTIONS))
    parser.add_argument("--list", action="store_true", help="print what was not found")
    args = parser.parse_args()
    recordings = list(real()) if UR10E.exists() else []
    arms = list(simulated(args.arms, args.first))
    for title, cases in (("real arms", recordings), ("simulated arms", arms)):
        counts, times = corrupted_cases(cases, args.only, args.list)
        print(f"{title}: {len(cases)} recordings")
        total = Counter()
        for name, count in counts.items():
            total += count
            print(
                f"  {name:28s} right {count['right']:3d}  other {count['other']:3d}  "
                f"wrong {count['wrong']:3d}  harmless {count['harmless']:3d}"
            )
        share = total["right"] / max(total["right"] + total["other"], 1)
        print(f"  first finding right: {100.0 * share:.1f} %", end="")
        print(
            f"; processor time {np.mean(times):.2f} s, at most {max(times):.2f} s" if times else ""
        )
    crossed(recordings + arms, args.list)
    clean(recordings, "real", args.list)
    clean(simulated(args.draws, args.first + 1000), "simulated", args.list)


def crossed(cases, shown):
    """Check recordings against other arms with as many joints."""
    robots = {}
    for label, robot, _ in cases:
        robots.setdefault(label.split("-")[0], robot)
    found = Counter()
    for label, robot, recording in cases:
        for other, arm in robots.items():
            if other == label.split("-")[0] or arm.n != robot.n:
                continue
            made = check(arm, recording)
            first = made.findings[0].premise if made.findings else "none"
            found["right" if first == "robot_mismatch" else "other"] += 1
            found[made.verdict] += 1
            if shown and first != "robot_mismatch":
                print(f"  {label} as {other}: {made.verdict} {first}")
    print("crossed robots:", dict(found))


def clean(cases, title, shown):
    """Check recordings of sound arms."""
    verdicts, times = Counter(), []
    for label, robot, recording in cases:
        start = seconds()
        made = check(robot, recording)
        times.append(seconds() - start)
        verdicts[made.verdict] += 1
        if shown and made.findings:
            print(f"  {label}: {made.verdict}", *(f.sentence for f in made.findings), sep="\n    ")
    if times:
        print(f"clean, {title}: {dict(verdicts)}; processor time {np.mean(times):.2f} s")


if __name__ == "__main__":
    main()
