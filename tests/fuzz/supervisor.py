"""Runs mutations in one child process, restarts it when it ends, and sorts the outcomes."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Self

from fuzz.formats import FORMATS, Format

TESTS = Path(__file__).resolve().parents[1]
#: Memory beyond the baseline, bytes, and processor time per input, s.
MEMORY, SECONDS = 1 << 30, 5.0


@dataclass(frozen=True)
class Escape:
    """An input that gave neither data nor a LieidError."""

    index: int
    detail: str
    place: str

    def __str__(self) -> str:
        return f"mutation {self.index}: {self.detail} ({self.place})"


@dataclass
class Tally:
    """Outcomes of the mutations of one format."""

    counts: Counter[str] = field(default_factory=Counter)
    escapes: list[Escape] = field(default_factory=list)

    def groups(self) -> dict[str, list[Escape]]:
        """Return the escapes by the place in the code and the kind of exception."""
        made: dict[str, list[Escape]] = {}
        for escape in self.escapes:
            made.setdefault(f"{escape.detail.split(':')[0]} at {escape.place}", []).append(escape)
        return made


class LoadingProcess:
    """The child process; a context manager."""

    def __init__(self, *, memory: int = MEMORY, seconds: float = SECONDS) -> None:
        self._limits = [str(memory), str(seconds)]
        self._child: subprocess.Popen[str] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._child is not None:
            self._end(self._child)

    def load(self, name: str, path: Path) -> dict[str, str]:
        """Load a file of a format in the child; see `fuzz.loading_process` for the answer."""
        child = self._child or self._start()
        assert child.stdin is not None
        assert child.stdout is not None
        print(f"{name}\t{path}", file=child.stdin, flush=True)
        line = child.stdout.readline()
        if line:
            answer: dict[str, str] = json.loads(line)
            return answer
        ended = -self._end(child)
        if ended in (signal.SIGPROF, signal.SIGALRM):
            detail = f"hang: more than {self._limits[1]} s"
        else:
            detail = f"crash: the process ended by signal {ended}"
        return {"outcome": "escape", "detail": detail, "place": "child process"}

    def _end(self, child: subprocess.Popen[str]) -> int:
        """Close the pipes, wait for the end, and return the exit code."""
        self._child = None
        with contextlib.suppress(BrokenPipeError):
            child.communicate()
        return child.returncode

    def _start(self) -> subprocess.Popen[str]:
        path = os.pathsep.join([str(TESTS), str(TESTS.parent)])
        # no compiler: models would be compiled anew for every mutated robot
        environment = os.environ | {"PYTHONPATH": path, "CC": "/nonexistent/cc"}
        environment |= {"OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
        self._child = child = subprocess.Popen(
            [sys.executable, "-m", "fuzz.loading_process", *self._limits],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
        )
        assert child.stdout is not None
        failed = json.loads(child.stdout.readline() or '{"failed": "it ended"}')["failed"]
        if failed:
            raise RuntimeError(f"the child process could not load the valid files: {failed}")
        return child


def fuzz(
    made: Format, indices: Iterable[int], seed: int, child: LoadingProcess, keep: Path | None = None
) -> Tally:
    """Load mutations of a format and return the outcomes.

    Parameters
    ----------
    made
        The format.
    indices, seed
        Numbers of the mutations and the seed; together they determine each input.
    child
        The process that loads.
    keep
        Folder to which inputs that escape are copied, one for each group.
    """
    tally = Tally()
    with tempfile.TemporaryDirectory() as folder:
        for index in indices:
            data = made.mutation(index, seed)
            answer = child.load(made.name, made.write(data, Path(folder)))
            tally.counts[answer["outcome"]] += 1
            if answer["outcome"] == "escape":
                tally.escapes.append(Escape(index, answer["detail"], answer["place"]))
                if keep is not None:
                    keep.mkdir(parents=True, exist_ok=True)
                    (keep / f"{made.name}-{seed}-{index}").write_bytes(data)
    return tally


def chosen(name: str | None) -> list[Format]:
    """Return one format by its name, or all."""
    return list(FORMATS.values()) if name is None else [FORMATS[name]]
