"""Section 6 of Luo et al. 2024 again: every table and figure, and the page that shows them.

    python examples/paper/make.py [-o DIR] [--quick]
    python examples/paper/make.py --robot ARM.urdf --train A.csv B.csv --test C.csv
        [--alone D.csv --joint J] [--torque-constants K1,...,Kn]

The simulated Panda has the paper's friction (`arm.py`). A real arm's recordings give the same
columns: the UR10e's are found under LIEID_RECORDINGS, others are named on the command line. Each
script can be run by itself and prints its part.
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


def main(arguments: list[str] | None = None) -> tuple[Section, ...]:
    """Make the page and its pictures; return its sections."""
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
        f"in {seconds / 60:.1f} minutes ({os.cpu_count()} cores). Numbers marked “paper” are those "
        "it prints (`printed.yaml`); all others come from that run.\n\n"
        "**The plant.** Table II's Panda with inertias off the published ones by up to 20 %; "
        "Pinocchio's dynamics, a joint controller at 1 kHz, and friction of its own that shares "
        "no code with the library. Friction is all of Eq. 8, temperature constant, with the "
        "offset of Eq. 17 (Table IV's f_v1, f_b and |f_c|; its f_v2, f_v3 shrunk, because as "
        "printed they drive most joints at full speed; load friction sized by Fig. 5's RMS and σ; "
        "what is not printed is chosen in `arm.py`). Noise: the paper states none; torque noise "
        "per sample of 1 kHz is that of a public recording of a real Panda "
        f"({', '.join(f'{x:g}' for x in TORQUE_NOISE)} N·m), velocity {VELOCITY_NOISE:g} rad/s "
        "(assumed), encoders of 20 bits. Excitation as in 6.1–6.2: 5 harmonics, 20 s, "
        f"{'fewer periods (--quick)' if quick else '5 periods'}. Friction runs at 200 Hz track "
        f"ideally, with {HEAVIEST:g} kg and, to verify, {', '.join(f'{m:g}' for m in PAYLOADS)} "
        "kg; each 4 cm beside the flange's axis.\n"
    )
    rows = [claim.row() for claim in claims]
    verdicts = "## What holds\n\n" + table(["where", "claim", "here", "numbers"], rows)
    return "\n".join([head, *(s.markdown() for s in sections), verdicts, closing(claims)])


def closing(claims: Sequence[Claim]) -> str:
    """Return where the paper's ranking of models holds and where not."""
    ranking = [claim for claim in claims if claim.ranking]
    holds = [claim for claim in ranking if claim.holds]
    fails = [claim for claim in ranking if not claim.holds]
    return (
        f"## Closing note\n\n{len(ranking)} rankings of criteria and models could be checked.\n\n"
        f"**The paper's ranking holds** in {len(holds)}:\n\n{listed_claims(holds)}\n\n"
        f"**It does not hold** in {len(fails)}:\n\n{listed_claims(fails)}\n\n"
        "What this shows, and what not: the plant's friction is the paper's by construction, so "
        "that Eq. 8 wins Fig. 7 on it says only that the procedure finds what is there; whether "
        "real friction is like that, a real arm must say. Temperature is constant throughout. The "
        "models of refs. 6, 7, 14 and 25 are rebuilt from abstracts and from what the paper says "
        "of them.\n"
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
    parser.add_argument("--quick", action="store_true", help="fewer periods, speeds and starts")
    parser.add_argument("--robot", type=Path, metavar="URDF")
    parser.add_argument("--train", type=Path, nargs="+", default=[])
    parser.add_argument("--test", type=Path, nargs="+", default=[])
    parser.add_argument("--alone", type=Path, help="one joint to and fro")
    parser.add_argument("--joint", type=int, default=1, help="that joint, from 1")
    parser.add_argument("--torque-constants", metavar="K1,...,Kn", help="N·m/A")
    return parser


if __name__ == "__main__":
    main()
