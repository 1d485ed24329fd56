"""Reproduce the tables and figures of section 6 of Luo et al. 2024, and write the page.

    python examples/paper/make.py [-o DIR] [--quick]
    python examples/paper/make.py --robot ARM.urdf --train A.csv B.csv --test C.csv
        [--alone D.csv --joint J] [--torque-constants K1,...,Kn]

The simulated Panda has the friction of the paper (`arm.py`). The same tables are made from
recordings of a real arm: those of the UR10e under LIEID_RECORDINGS, or those given on the command
line. Each script can also be run by itself and prints its section.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import excitation_table
import figure_5
import figure_7
import matplotlib
import payload_runs
import real_arm
import table_4
import tables_5_6
from arm import HEAVIEST, PAYLOADS, TORQUE_NOISE, VELOCITY_NOISE
from lab import Lab
from page import Claim, Section, listed_claims, table

HERE = Path(__file__).parent
QUICKLY = "fewer periods, followed exactly without the controller (--quick)"


def main(arguments: list[str] | None = None) -> tuple[Section, ...]:
    """Write the page and its figures; return its sections."""
    args = _parser().parse_args(arguments)
    matplotlib.use("Agg")
    lab = Lab.quick() if args.quick else Lab()
    recorded = _recorded(args)
    began = time.perf_counter()
    parts: list[tuple[str, Callable[[], Section]]] = [
        ("Table III", lambda: excitation_table.section(lab)),
        ("Table IV", lambda: table_4.section(lab)),
        ("Tables V and VI", lambda: tables_5_6.section(lab)),
        ("payloads", lambda: payload_runs.section(lab)),
        ("Fig. 5", lambda: figure_5.section(lab)),
        ("Fig. 7", lambda: figure_7.section(lab)),
        ("recordings", lambda: real_arm.section(recorded)),
    ]
    sections = []
    for name, make in parts:
        started = time.perf_counter()
        sections.append(make())
        sections[-1].draw(args.output / "figures")
        print(f"{name}: {time.perf_counter() - started:.0f} s", file=sys.stderr)
    seconds = time.perf_counter() - began
    text = render(tuple(sections), seconds, quick=args.quick, recorded=recorded is not None)
    (args.output / "README.md").write_text(text, encoding="utf-8")
    print(f"{args.output / 'README.md'} in {seconds:.0f} s", file=sys.stderr)
    return tuple(sections)


def render(sections: tuple[Section, ...], seconds: float, *, quick: bool, recorded: bool) -> str:
    """Return the page."""
    claims = [claim for section in sections for claim in section.claims]
    command = "python examples/paper/make.py" + (" --quick" if quick else "")
    if recorded:
        command = f"LIEID_RECORDINGS=… {command}"
    head = (
        "# The paper's results\n\n"
        "Section 6 of Luo et al., “Lie-theory-based dynamic model identification of serial robots "
        "considering nonlinear friction and optimal excitation trajectory”, Robotica 42 (2024), "
        "on a simulated Panda and on a real arm's recordings. Made by\n\n"
        f"    {command}\n\n"
        f"in {seconds / 60:.1f} minutes ({os.cpu_count()} cores). Numbers marked “paper” are "
        "printed in the paper (`printed.yaml`); all others come from this run.\n\n"
        "**The plant.** The Panda of Table II, with inertias that differ from the published ones "
        "by up to 20 %, dynamics by Pinocchio, a joint controller at 1 kHz, and friction that "
        "shares no code with the library. The friction is Eq. 8 at constant temperature with the "
        "offset of Eq. 17: f_v1, f_b and |f_c| of Table IV; f_v2 and f_v3 scaled down, because "
        "the printed values give negative friction at full speed on most joints; load friction "
        "of the size that RMS and σ of Fig. 5 imply; values that are not printed are chosen in "
        "`arm.py`. The paper states no noise: the torque noise per sample at 1 kHz is that of a "
        "public recording of a real Panda "
        f"({', '.join(f'{x:g}' for x in TORQUE_NOISE)} N·m), the velocity noise is assumed to be "
        f"{VELOCITY_NOISE:g} rad/s, and encoders have 20 bits. Excitation as in sections 6.1 and "
        f"6.2: 5 harmonics, 20 s, {QUICKLY if quick else '5 periods'}. Friction "
        "runs at 200 Hz follow the commanded motion exactly, with a payload of "
        f"{HEAVIEST:g} kg and, for verification, {', '.join(f'{m:g}' for m in PAYLOADS)} kg; the "
        "centre of each payload is 4 cm beside the axis of the flange.\n\n"
        "**Verdicts.** A difference between models is significant if its 95 % interval, by a "
        "block bootstrap over time (blocks of 1 s) or over the points of a friction curve, does "
        "not contain zero. Where it does, or where the paper states no limit, a statement is not "
        "decided. The simulation has one arm and one noise realization, so that a verdict says "
        "nothing about other arms.\n"
    )
    rows = [claim.row() for claim in claims]
    verdicts = "## Verdicts\n\n" + table(["section", "statement", "verdict", "numbers"], rows)
    return "\n".join([head, *(s.markdown() for s in sections), verdicts, closing(claims)])


def closing(claims: Sequence[Claim]) -> str:
    """Return a summary of the verdicts on rankings, and the limits of this reproduction."""
    ranking = [claim for claim in claims if claim.ranking]
    holds, fails, open_ = (
        [claim for claim in ranking if claim.holds is verdict] for verdict in (True, False, None)
    )
    return (
        f"## Closing note\n\nOf {len(ranking)} rankings of criteria and models, {len(holds)} hold, "
        f"{len(fails)} do not hold and {len(open_)} are not decided.\n\n"
        f"**Not holding:**\n\n{listed_claims(fails)}\n\n"
        f"**Not decided:**\n\n{listed_claims(open_)}\n\n"
        "The friction of the plant is that of the paper by construction. That Eq. 8 has the "
        "smallest errors in Fig. 7 shows only that the procedure finds a friction of this form; "
        "whether real friction has this form must be measured on a real arm. The temperature is "
        "constant throughout. The models of refs. 6, 7, 14 and 25 are reconstructions from "
        "abstracts and from the paper's description.\n"
    )


def _recorded(args: argparse.Namespace) -> real_arm.Recorded | None:
    if args.robot is None:
        return real_arm.ur10e()
    constants = args.torque_constants
    return real_arm.Recorded(
        args.robot.stem,
        args.robot,
        tuple(args.train),
        tuple(args.test),
        args.alone,
        args.joint - 1,
        None if constants is None else tuple(float(x) for x in constants.split(",")),
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, default=HERE, metavar="DIR")
    parser.add_argument(
        "--quick", action="store_true", help="fewer periods, speeds and starts, no controller"
    )
    parser.add_argument("--robot", type=Path, metavar="URDF")
    parser.add_argument("--train", type=Path, nargs="+", default=[])
    parser.add_argument("--test", type=Path, nargs="+", default=[])
    parser.add_argument("--alone", type=Path, help="one joint moving forward and backward")
    parser.add_argument("--joint", type=int, default=1, help="that joint, from 1")
    parser.add_argument("--torque-constants", metavar="K1,...,Kn", help="N·m/A")
    return parser


if __name__ == "__main__":
    main()
