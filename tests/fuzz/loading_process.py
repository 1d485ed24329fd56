"""The child process of the fuzzer: loads files that it is given, within limits.

Usage: ``python -m fuzz.loading_process MEMORY SECONDS``. It reads lines ``FORMAT<tab>PATH`` from
stdin and answers each with one line of JSON: ``outcome`` (``data``, ``refused`` or ``escape``),
``detail`` and ``place``. A file that takes longer than SECONDS of processor time ends the process
by SIGPROF, one that waits for much longer by SIGALRM.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import resource
import signal
import sys
import tempfile
import traceback
import warnings
from pathlib import Path
from typing import Any

#: Time on the clock, in processor seconds allowed: a machine may be busy with other work.
CLOCK_OVER_PROCESSOR = 30.0


def main() -> None:
    """Serve requests until stdin ends."""
    memory, seconds = int(sys.argv[1]), float(sys.argv[2])
    answers = os.fdopen(os.dup(1), "w")
    errors = tempfile.TemporaryFile()  # noqa: SIM115 - open as long as the process
    os.dup2(errors.fileno(), 1)
    os.dup2(errors.fileno(), 2)
    warnings.simplefilter("ignore")
    logging.getLogger("lieid_casadi").addHandler(logging.NullHandler())

    from fuzz.formats import FORMATS

    try:
        _load_every_seed(FORMATS)
    except Exception:
        print(json.dumps({"failed": traceback.format_exc()}), file=answers, flush=True)
        raise
    _limit_memory(memory)
    print(json.dumps({"failed": ""}), file=answers, flush=True)
    for line in sys.stdin:
        name, _, path = line.rstrip("\n").partition("\t")
        written = os.fstat(errors.fileno()).st_size
        _set_timers(seconds)
        answer = _outcome(FORMATS[name], Path(path))
        _set_timers(0.0)
        sys.stdout.flush()
        sys.stderr.flush()
        if answer["outcome"] != "escape" and os.fstat(errors.fileno()).st_size > written:
            shown = os.pread(errors.fileno(), 200, written).decode(errors="replace")
            answer = {
                "outcome": "escape",
                "detail": f"written on the terminal: {shown.strip().splitlines()[0]}",
                "place": "a library's output",
            }
        print(json.dumps(answer), file=answers, flush=True)


def _load_every_seed(formats: dict[str, Any]) -> None:
    """Import and allocate what valid files need, so that the memory's baseline includes it."""
    from lieid_casadi.errors import LieidError

    with tempfile.TemporaryDirectory() as folder:
        for made in formats.values():
            for data in made.seeds():
                with contextlib.suppress(LieidError):
                    made.use(made.write(data, Path(folder)))


def _limit_memory(margin: int) -> None:
    """Allow ``margin`` bytes more of data (heap, private mappings) than are in use now."""
    status = Path("/proc/self/status").read_text()
    used = next(int(x.split()[1]) for x in status.splitlines() if x.startswith("VmData:"))
    limit = used * 1024 + margin
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))


def _set_timers(seconds: float) -> None:
    signal.setitimer(signal.ITIMER_PROF, seconds)
    signal.setitimer(signal.ITIMER_REAL, seconds * CLOCK_OVER_PROCESSOR)


def _outcome(made: Any, path: Path) -> dict[str, str]:
    from lieid_casadi.errors import LieidError

    try:
        made.use(path)
    except LieidError as error:
        if "\n" in str(error):
            return _escape(error, "message of several lines")
        return {"outcome": "refused", "detail": str(error), "place": ""}
    except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever it is, it is an escape
        return _escape(error, type(error).__name__)
    return {"outcome": "data", "detail": "", "place": ""}


def _escape(error: BaseException, kind: str) -> dict[str, str]:
    """Return an answer with the innermost line of the package that the error passed through."""
    frames = traceback.extract_tb(error.__traceback__)
    inside = [f for f in frames if "lieid_casadi" in f.filename] or frames[-1:]
    place = inside[-1]
    text = " ".join(str(error).split())[:150]
    return {
        "outcome": "escape",
        "detail": f"{kind}: {text}",
        "place": f"{Path(place.filename).name}:{place.lineno}",
    }


if __name__ == "__main__":
    main()
