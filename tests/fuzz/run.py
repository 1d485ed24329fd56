"""A long run of the fuzzer: ``python tests/fuzz/run.py --count 100000 [--format F] [--seed S]``.

Prints a table of the outcomes and the escapes, grouped by place; exit status 1 if there are any.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE.parents[1])]

from fuzz.formats import FORMATS  # noqa: E402
from fuzz.supervisor import LoadingProcess, chosen, fuzz  # noqa: E402


def main() -> int:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=2000, help="mutations per format")
    parser.add_argument("--first", type=int, default=0, help="number of the first mutation")
    parser.add_argument("--format", choices=list(FORMATS), help="one format; default: all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, metavar="DIR", help="folder for inputs that escape")
    options = parser.parse_args()
    escaped = 0
    print(f"{'format':9}{'inputs':>9}{'data':>9}{'refused':>9}{'escapes':>9}{'seconds':>9}")
    with LoadingProcess() as child:
        for made in chosen(options.format):
            start = time.monotonic()
            numbers = range(options.first, options.first + options.count)
            tally = fuzz(made, numbers, options.seed, child, options.keep)
            counts, seconds = tally.counts, time.monotonic() - start
            print(
                f"{made.name:9}{options.count:9}{counts['data']:9}{counts['refused']:9}"
                f"{counts['escape']:9}{seconds:9.1f}",
                flush=True,
            )
            for group, escapes in tally.groups().items():
                print(f"    {len(escapes):5} × {group}; first: {escapes[0]}", flush=True)
            escaped += len(tally.escapes)
    return 1 if escaped else 0


if __name__ == "__main__":
    sys.exit(main())
