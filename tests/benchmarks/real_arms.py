"""The table of real arms: what a diagnosis finds, and the error on recordings that it did not see.

    python tests/benchmarks/real_arms.py [--arms NAME…] [--forward] [--json FILE] [--record FILE]
    python tests/benchmarks/real_arms.py --further|--windows [--record FILE] [--best FILE]
    python tests/benchmarks/real_arms.py --unchanged

It needs the recordings that ``LIEID_RECORDINGS`` names (see tests/real_arms.py; tests of the suite
read all of them) and prints a Markdown table: RMS errors of samples in motion, N·m, of the plain
fit, of the diagnosed model, and of the version of this program with the lowest error so far
(``real_arms_best.json``; ``--record`` adds this run to such a file, ``--best`` reads another one):
the geometric mean over the joints counts. One effect more or less moves a row by more than
versions differ; ``--further`` has other cut-offs and stretches, to compare two versions by their
mean; ``--windows`` has 24 random parts of 12 to 27 s, each tested on other recordings or parts, and
four divisions of the TX40; ``--unchanged`` states what a diagnosis of the same tests finds changed
since a fit to the UR10e's, plain and with friction effects on every joint. Two references are made
without a diagnosis: friction effects on every joint at once and, with ``--forward``, a selection by
the cross-validated error alone, which tries every effect on every joint in turn. The processor time
of a diagnosis is given in multiples of a fixed loop of linear algebra, since machines differ, and
of an identification of the same model.
"""

import argparse
import json
import sys
import time
import warnings
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

from real_arms import FINGERS, PANDA, TX40, UR10E  # noqa: E402

import lieid_casadi as lieid  # noqa: E402
from lieid_casadi.identification.identify import default_effects  # noqa: E402

BEST = HERE / "real_arms_best.json"
GOAL = 1.02  # error relative to the best so far
BLOCK, MOVING = 0.6, 7.8  # s: the TX40's blocks, two of three for training; then it rests
FRICTION = ("viscous_polynomial", "load_friction", "presliding")  # on every joint, as a reference
FORWARD = ("stribeck", "viscous_polynomial", "viscous_asymmetric", "load_friction", "presliding",
           "position_friction", "torque_ripple", "torque_lowpass", "armature")  # fmt: skip


@dataclass(frozen=True)
class Arm:
    """Recordings of an arm: ``train`` and, by name, those of each test, below the URDF's folder."""

    name: str
    urdf: Path
    train: tuple[str, ...]
    tests: dict[str, tuple[str, ...]]
    cutoff: float  # Hz
    motor_side: bool = False  # torque comes from motor currents
    lock: tuple[str, ...] = ()
    trim: float = 0.5  # s that are removed at both ends of each part


def blocks(first, count):
    """Return parts of ``count`` blocks of the TX40's recording, every three blocks."""
    starts = np.arange(first, int(MOVING / BLOCK) - count + 1, 3) * BLOCK
    return tuple(f"excitation.csv.gz@{a:g}:{a + count * BLOCK:g}" for a in starts)


def ur10e(said, train, tests):
    return Arm(f"UR10e, {said}", UR10E / "ur10e.urdf", train,
               {name: (f"{name}.csv.gz",) for name in tests}, 7.0, True)  # fmt: skip


def panda(said, end):
    return Arm(f"Franka Panda, {said}", PANDA / "panda.urdf", (f"excitation.csv.gz@0:{end:g}",),
               {"15.6 to 24 s": ("excitation.csv.gz@15.6:",)}, 3.0, lock=FINGERS)  # fmt: skip


OTHERS = ("excitation_50s", "excitation_14_harmonics", "point_to_point")
ARMS = {
    "ur10e": ur10e("30 s + 50 s", ("excitation_30s.csv.gz", "excitation_50s.csv.gz"), OTHERS[1:]),
    "ur10e_30s": ur10e("30 s", ("excitation_30s.csv.gz",), OTHERS),
    "ur10e_16s": ur10e("16 s", ("excitation_30s.csv.gz@0:16",), OTHERS),
    "tx40": Arm("Stäubli TX40, two of three blocks of 0.6 s", TX40 / "tx40.urdf", blocks(0, 2),
                {"every third block": blocks(2, 1)}, 20.0, True, trim=0.05),
    "panda": panda("15.6 s", 15.6),
    "panda_13s": panda("13 s", 13.0),
}  # fmt: skip
#: Rows by which versions are compared: other cut-offs, and other stretches of the recordings.
FURTHER = {
    f"{key}, {factor:g} × cut-off": replace(
        ARMS[key], name=f"{ARMS[key].name}, {factor:g} × cut-off", cutoff=factor * ARMS[key].cutoff
    )
    for key, factor in product(("ur10e", "ur10e_30s", "ur10e_16s", "panda", "panda_13s"),
                               (0.7, 1.4, 2.0))
} | {
    "ur10e, 14 to 30 s": ur10e("14 to 30 s", ("excitation_30s.csv.gz@14:",), OTHERS),
    "ur10e, first half": ur10e("0 to 25 of 50 s", ("excitation_50s.csv.gz@0:25",), OTHERS[1:]),
    "ur10e, second half": ur10e("25 to 50 s", ("excitation_50s.csv.gz@25:",), OTHERS[1:]),
    "panda, last": replace(panda("8.4 to 24 s", 15.6), train=("excitation.csv.gz@8.4:",),
                           tests={"0 to 8.4 s": ("excitation.csv.gz@0:8.4",)}),
}  # fmt: skip
#: Random parts of the recordings, s. What of the Panda's is outside one tests it if it lasts 3 s.
PARTS = {
    "excitation_30s": ((13.7, 26.7), (11.3, 27.3), (5.2, 25.2), (0.9, 27.9)),
    "excitation_50s": ((2, 15), (13, 29), (12.3, 32.3), (1, 28),
                       (1.8, 14.8), (34, 50), (19.6, 39.6), (5.4, 32.4)),
    "excitation_14_harmonics": ((16.1, 29.1), (33.2, 49.2), (27, 47), (19.5, 46.5)),
}  # fmt: skip
OF_PANDA = ((4.71, 16.71), (5.92, 17.92), (7.44, 20.44), (0.67, 13.67),
            (5.56, 19.56), (2.71, 16.71), (7.92, 22.92), (0.58, 15.58))  # fmt: skip


def panda_part(start, end):
    rest = {"before": (0.0, start), "after": (end, 24.0)}
    tests = {k: (f"excitation.csv.gz@{a:g}:{b:g}",) for k, (a, b) in rest.items() if b - a > 3.0}
    arm = panda(f"{start:g} to {end:g} s", end)
    return replace(arm, train=(f"excitation.csv.gz@{start:g}:{end:g}",), tests=tests)


def tx40_part(first, block):
    starts = range(int(MOVING / block))
    parts = [(k, f"excitation.csv.gz@{k * block:g}:{(k + 1) * block:g}") for k in starts]
    train = tuple(part for k, part in parts if (k + first) % 3)
    test = tuple(part for k, part in parts if (k + first) % 3 == 0)
    said = f"Stäubli TX40, blocks of {block:g} s from {first}"
    return replace(ARMS["tx40"], name=said, train=train, tests={"blocks": test})


WINDOWS = (
    {
        f"ur10e, {name} {a:g} to {b:g} s": ur10e(
            f"{a:g} to {b:g} s of {name}", (f"{name}.csv.gz@{a:g}:{b:g}",),
            [other for other in ("excitation_30s", *OTHERS) if other != name],
        )
        for name, parts in PARTS.items() for a, b in parts
    }
    | {f"panda, {a:g} to {b:g} s": panda_part(a, b) for a, b in OF_PANDA}
    | {f"tx40, {k}, {b:g}": tx40_part(k, b) for k, b in ((1, 0.6), (2, 0.6), (0, 0.9), (1, 0.9))}
)  # fmt: skip
EVERY = ARMS | FURTHER | WINDOWS


class Task:
    """What an arm's diagnosis starts from."""

    def __init__(self, arm):
        self.arm, self.processing = arm, lieid.Processing(cutoff=arm.cutoff, trim=arm.trim)
        robot = lieid.Robot.from_urdf(arm.urdf, lock=arm.lock)
        self.train = self.recordings(arm.train)
        first = default_effects(robot, self.train, motor_side=arm.motor_side)
        self.model = lieid.Model(robot, first.names)
        self.tests = {name: self.recordings(paths) for name, paths in arm.tests.items()}

    def recordings(self, paths):
        return [lieid.Recording.load(f"{self.arm.urdf.parent / path}") for path in paths]

    def fitted(self, model):
        return lieid.identify(model, self.train, processing=self.processing)

    def errors(self, fit):
        """Return the RMS (n,) of samples in motion of each test."""
        return {
            name: lieid.compare(fit, test).rms_moving.tolist() for name, test in self.tests.items()
        }


def changes(key):
    """Yield each test of an arm and what a diagnosis finds changed since a fit of its training."""
    task = Task(EVERY[key])
    for effects in ((), FRICTION):
        model = task.model
        for effect in effects:
            model = model.with_effect(effect)
        fit = task.fitted(model)
        for name, test in task.tests.items():
            said = f"{task.arm.name}{', friction on every joint' if effects else ''}, {name}"
            yield said, [f"{s.label} ({s.status})" for s in lieid.diagnose(fit, test).steps]


def timed(function):
    start = time.process_time()
    result = function()
    return result, time.process_time() - start


def reference_loop():
    """Least squares as large as a search's; 0.66 s in the table of the documentation."""
    matrix = np.random.default_rng(0).normal(size=(4000, 60))
    for _ in range(140):
        np.linalg.qr(matrix)
        np.linalg.inv(matrix.T @ matrix)


def forward_selection(task, most=8):
    """Return the effects that lower the cross-validated error most, one after another.

    An effect is taken where it lowers the error of one joint by 2 %; it stops where none does.
    """
    labels = [f"{name}:{j + 1}" for name in FORWARD for j in range(task.model.n)]
    taken, model, error = [], task.model, task.fitted(task.model).rms_cv
    while len(taken) < most:
        best, found = 0.98, None
        for label in labels:
            try:
                trial = model.with_effect(label)
                fit = task.fitted(trial)
            except lieid.LieidError:
                continue
            ratio = float(np.exp(np.mean(np.log(fit.rms_cv / error)))) ** task.model.n
            if ratio < best:
                best, found = ratio, (label, trial, fit.rms_cv)
        if found is None:
            break
        label, model, error = found
        taken.append(label)
        labels.remove(label)
    return taken, task.fitted(model)


def measured(key, *, forward=False):
    """Return one row for each test of an arm."""
    task = Task(EVERY[key])
    task.fitted(task.model)  # compiled code is generated once
    plain, plain_seconds = timed(lambda: task.fitted(task.model))
    found, seconds = timed(
        lambda: lieid.diagnose(task.model, task.train, processing=task.processing)
    )
    loop = timed(reference_loop)[1]
    before, after = task.errors(plain), task.errors(found.fit)
    by_hand = task.model
    for name in FRICTION:
        by_hand = by_hand.with_effect(name)
    friction = task.errors(task.fitted(by_hand))
    reference, selected = {}, None
    if forward:
        selected, fit = forward_selection(task)
        reference = task.errors(fit)
    return [
        {
            "arm": key,
            "test": test,
            "effects": [
                step.label + {"one_of": " (one of)", "shape": " (shape)"}.get(
                    getattr(step, "status", ""), ""
                )
                for step in found.steps
            ],
            "verdict": str(found.verdict),
            "before": before[test],
            "after": after[test],
            "friction": friction[test],
            "forward": reference.get(test),
            "forward_effects": selected,
            "noise_floor": lieid.compare(found.fit, task.tests[test]).noise_floor.tolist(),
            "seconds": seconds,
            "times_loop": seconds / loop,
            "times_identify": seconds / plain_seconds,
        }
        for test in task.tests
    ]  # fmt: skip


def best_version(runs, row):
    """Return the errors of the recorded version that was best on a row; None without any."""
    own = [r["after"] for r in runs if (r["arm"], r["test"]) == (row["arm"], row["test"])]
    return min(own, key=lambda after: whole(after, row["before"]), default=None)


def whole(values, reference):
    """Return the geometric mean over joints of the errors relative to others."""
    return float(np.exp(np.mean(np.log(np.array(values) / np.array(reference)))))


def numbers(values):
    return "–" if values is None else " ".join(f"{value:.2f}" for value in values)


def printed(row, runs):
    best = best_version(runs, row)
    ratio = "–"
    if best is not None:
        ratio = f"{whole(row['after'], best):.2f} ({numbers(np.array(row['after']) / best)})"
    return (
        f"| {EVERY[row['arm']].name}, {row['test']} "
        f"| {', '.join(row['effects']) or 'none'} "
        f"({row['verdict']}) | {numbers(row['before'])} | {numbers(row['after'])} "
        f"| {whole(row['after'], row['before']):.2f} | {numbers(best)} | {ratio} "
        f"| {numbers(row['friction'])} | {numbers(row['noise_floor'])} "
        f"| {row['seconds']:.0f} s, {row['times_loop']:.0f} ×, {row['times_identify']:.0f} × |"
    )


def show(line):
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--arms", nargs="+", choices=ARMS, default=list(ARMS))
    parser.add_argument("--further", action="store_true", help="the rows by which versions compare")
    parser.add_argument(
        "--windows", action="store_true", help="random parts, six minutes on one core"
    )
    parser.add_argument("--unchanged", action="store_true", help="changes since fits, four minutes")
    parser.add_argument("--best", type=Path, default=BEST, metavar="FILE", help="recorded runs")
    parser.add_argument("--forward", action="store_true", help="minutes for each arm")
    parser.add_argument("--json", type=Path, metavar="FILE", help="all rows")
    parser.add_argument("--record", type=Path, metavar="FILE", help="add this run to these")
    parser.add_argument("--version", default="this", help="its name there, such as a commit")
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    if args.unchanged:
        keys = [key for key in (*ARMS, *WINDOWS) if key.startswith("ur10e")]
        found = [each for key in keys for each in changes(key)]
        for said, steps in found:
            if steps:
                show(f"{said}: {', '.join(steps)}")
        show(f"{sum(bool(steps) for _, steps in found)} of {len(found)} tests have a change")
        return
    show(
        "| arm and its training, test | effects found | plain | diagnosed | ratio | best so far "
        f"| to the best (goal ≤ {GOAL:g}) | friction on every joint | noise floor "
        "| processor, to the loop, to `identify` |\n"
        + "| --- " * 10 + "|"
    )  # fmt: skip
    rows, runs = [], json.loads(args.best.read_text("utf-8"))
    for key in FURTHER if args.further else WINDOWS if args.windows else args.arms:
        own = measured(key, forward=args.forward)
        rows += own
        for row in own:
            show(printed(row, runs))
            if row["forward"]:
                show(f"<!-- forward selection by rms_cv: {numbers(row['forward'])}: "
                     f"{', '.join(row['forward_effects'])} -->")  # fmt: skip
    for arm in ("ur10e", "panda", "tx40"):
        own = [whole(r["after"], r["before"]) for r in rows if r["arm"].startswith(arm)]
        if own:
            mean = np.exp(np.mean(np.log(own)))
            show(f"\n{arm}: {len(own)} tests, {mean:.3f} of the plain model on average")
    every = [(r, best) for r in rows if (best := best_version(runs, r)) is not None]
    ratios = [whole(r["after"], best) for r, best in every]
    if ratios:
        show(f"\n{len(ratios)} rows: {np.exp(np.mean(np.log(ratios))):.3f} of the best on average")
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1), "utf-8")
    if args.record:
        kept = json.loads(args.record.read_text("utf-8")) if args.record.exists() else []
        kept += [
            {"arm": r["arm"], "test": r["test"], "version": args.version,
             "after": [round(x, 4) for x in r["after"]]}
            for r in rows
        ]  # fmt: skip
        lines = ",\n".join(" " + json.dumps(r) for r in kept)
        args.record.write_text(f"[\n{lines}\n]\n", "utf-8")


if __name__ == "__main__":
    main()
