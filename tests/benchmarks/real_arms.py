"""The table of real arms: what a diagnosis finds, and the error in motion before and after.

    python tests/benchmarks/real_arms.py [--arms ur10e tx40 panda] [--json FILE]

It needs the recordings that ``LIEID_RECORDINGS`` names (see tests/real_arms.py) and prints a
Markdown table. A recording is called unseen only if no test of the suite reads it; the tests that
read it are listed otherwise.
"""

import argparse
import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

from real_arms import PANDA, TX40, UR10E  # noqa: E402

import lieid_casadi as lieid  # noqa: E402
from lieid_casadi.identification.default_effects import default_effects  # noqa: E402

BLOCK, MOVING = 0.6, 7.8  # s: the TX40's blocks, two of three for training; then it rests
SHORT = 0.05  # s that are removed at both ends of these blocks


@dataclass(frozen=True)
class Arm:
    """An arm with recordings for training and for tests.

    Attributes
    ----------
    name : str
    urdf : Path
    lock : tuple of str
    cutoff : float
        Hz.
    motor_side : bool
        Whether torque comes from motor currents.
    trim : float
        s that are removed at both ends of each part.
    train : tuple of str
        Paths below the folder of the URDF, with parts.
    tests : tuple of (str, tuple of str)
        What is said of the test, and its recordings.
    """

    name: str
    urdf: Path
    lock: tuple[str, ...]
    cutoff: float
    motor_side: bool
    trim: float
    train: tuple[str, ...]
    tests: tuple[tuple[str, tuple[str, ...]], ...]


def blocks(first, count):
    """Return parts of ``count`` blocks of the TX40's recording, every three blocks."""
    starts = np.arange(first, int(MOVING / BLOCK) - count + 1, 3) * BLOCK
    return tuple(f"excitation.csv.gz@{a:g}:{a + count * BLOCK:g}" for a in starts)


ARMS = {
    "ur10e": Arm(
        "UR10e, 7 Hz", UR10E / "ur10e.urdf", (), 7.0, True, 0.5,
        ("excitation_30s.csv.gz", "excitation_50s.csv.gz"),
        (
            ("other periodic motion", ("excitation_14_harmonics.csv.gz",)),
            ("moves between poses", ("point_to_point.csv.gz",)),
        ),
    ),
    "tx40": Arm(
        "Stäubli TX40, 20 Hz", TX40 / "tx40.urdf", (), 20.0, True, SHORT, blocks(0, 2),
        (("every third block of 0.6 s", blocks(2, 1)),),
    ),
    "panda": Arm(
        "Franka Panda, 3 Hz", PANDA / "panda.urdf",
        ("panda_finger_joint1", "panda_finger_joint2"), 3.0, False, 0.5,
        ("excitation.csv.gz@0:15.6",), (("the last third", ("excitation.csv.gz@15.6:",)),),
    ),
}  # fmt: skip


def recordings(arm, paths):
    return [lieid.Recording.load(f"{arm.urdf.parent / path}") for path in paths]


def tests_that_read(arm, path):
    """Return the files of the suite that read a recording, by its name and its arm's."""
    stem, folder = path.split(".csv")[0], arm.urdf.parent
    constant = {UR10E: "UR10E", TX40: "TX40", PANDA: "PANDA"}[folder]
    found = []
    for file in sorted(HERE.parent.rglob("*.py")):
        text = file.read_text("utf-8")
        own = constant in text or folder.name in text
        if "benchmarks" not in file.parts and own and stem in text:
            found.append(str(file.relative_to(HERE.parent)))
    return found


def diagnosed(arm):
    """Return the diagnosis of an arm without a test, and the errors on its tests."""
    robot = lieid.Robot.from_urdf(arm.urdf, lock=arm.lock)
    train = recordings(arm, arm.train)
    default = default_effects(robot, train, motor_side=arm.motor_side)
    model = lieid.Model(robot, default.names)
    processing = lieid.Processing(cutoff=arm.cutoff, trim=arm.trim)
    start = time.process_time()
    found = lieid.diagnose(model, train, processing=processing)
    seconds = time.process_time() - start
    first = lieid.identify(model, train, processing=processing)
    rows = []
    for said, paths in arm.tests:
        test = recordings(arm, paths)
        before, after = lieid.compare(first, test), lieid.compare(found.fit, test)
        read = sorted({file for path in paths for file in tests_that_read(arm, path)})
        rows.append(
            {
                "arm": arm.name,
                "test": f"{said} ({', '.join(sorted({p.split('@')[0] for p in paths}))})",
                "read_by": read,
                "first": list(default.names),
                "effects": [step.label for step in found.steps],
                "before": before.rms_moving.tolist(),
                "after": after.rms_moving.tolist(),
                "noise_floor": after.noise_floor.tolist(),
                "verdict": found.verdict,
                "limits_reached": list(found.limits_reached),
                "seconds": seconds,
            }
        )
    return found, rows


def numbers(values):
    return " ".join(f"{value:.2f}" for value in values)


def printed(row):
    change = 100.0 * (np.array(row["after"]) / np.array(row["before"]) - 1.0)
    read = ", ".join(row["read_by"]) or "no test: unseen"
    effects = ", ".join(row["effects"]) or "none"
    ends = f"; search ended by {', '.join(row['limits_reached'])}" if row["limits_reached"] else ""
    return (
        f"| {row['arm']}, {row['test']} | {', '.join(row['first'])} | {effects}{ends} "
        f"({row['verdict']}) | {numbers(row['before'])} | {numbers(row['after'])} "
        f"({' '.join(f'{x:+.0f}' for x in change)} %) | {numbers(row['noise_floor'])} "
        f"| {row['seconds']:.0f} s | {read} |"
    )


def show(line):
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", nargs="+", choices=ARMS, default=list(ARMS))
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    show(
        "| arm, test | first model | effects found | RMS in motion before, N·m | after (change) "
        "| noise floor | processor | read by tests |\n" + "| --- " * 8 + "|"
    )
    rows = []
    for name in args.arms:
        found, own = diagnosed(ARMS[name])
        rows += own
        for row in own:
            show(printed(row))
        show(f"<!-- {found.sentence} -->")
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1), "utf-8")


if __name__ == "__main__":
    main()
