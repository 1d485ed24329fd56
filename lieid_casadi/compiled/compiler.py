"""The system's C compiler, and what this processor can run."""

from __future__ import annotations

import contextlib
import os
import platform
import shlex
import shutil
import signal
import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from lieid_casadi.errors import CompilerError

FLAGS = (
    "-std=gnu11", "-O2", "-fPIC", "-shared",
    "-ffp-contract=off",  # the same bits with any number of lanes, on any processor
    "-fno-math-errno", "-fno-trapping-math", "-Wno-psabi",
)  # fmt: skip
TIMEOUT = 120.0  # s; a kernel takes well below one


@dataclass(frozen=True)
class Target:
    """An instruction set: its samples per register, the compiler flags and processor flags."""

    name: str
    lanes: int
    flags: tuple[str, ...] = ()
    needs: frozenset[str] = frozenset()


AVX512 = frozenset({"avx512f", "avx512dq", "avx512vl", "avx512bw"})
TARGETS = (
    Target("avx512", 8, (*(f"-m{flag}" for flag in sorted(AVX512)), "-mavx2", "-mfma"), AVX512),
    Target("avx2", 4, ("-mavx2", "-mfma"), frozenset({"avx2", "fma"})),
    Target("sse2", 2, (), frozenset({"sse2"})),
    Target("neon", 2, (), frozenset({"neon"})),
    Target("scalar", 1),
)


@cache
def processor_flags() -> frozenset[str]:
    """Return the names of the instruction sets of `TARGETS` that this processor has."""
    machine = platform.machine().lower()
    if machine in ("aarch64", "arm64"):
        return frozenset({"neon"})
    if machine not in ("x86_64", "amd64"):
        return frozenset()
    try:
        with open("/proc/cpuinfo", encoding="ascii", errors="replace") as lines:
            flags = next((line for line in lines if line.startswith("flags")), "")
    except OSError:
        flags = ""
    return frozenset(flags.partition(":")[2].split()) | {"sse2"}


def available_targets() -> tuple[Target, ...]:
    """Return what this processor can run, fastest first; ``scalar`` is the last."""
    return tuple(target for target in TARGETS if target.needs <= processor_flags())


@dataclass(frozen=True)
class Compiler:
    """A C compiler: its command, and a text that changes with its version."""

    command: tuple[str, ...]
    identity: str


def find_compiler() -> Compiler:
    """Return the compiler of ``$CC``, else the first of cc, gcc, clang on the path."""
    try:
        stated = shlex.split(os.environ.get("CC", ""))
    except ValueError as error:
        raise CompilerError(f"$CC is {os.environ['CC']!r}: {error}") from None
    for command in [stated] if stated else [["cc"], ["gcc"], ["clang"]]:
        found = shutil.which(command[0])
        if found:
            real = Path(found).resolve()
            status = real.stat()
            identity = f"{real} {status.st_size} {status.st_mtime_ns} {command[1:]}"
            return Compiler((found, *command[1:]), identity)
    wanted = f"$CC, which names {stated[0]!r}," if stated else "cc, gcc or clang"
    raise CompilerError(f"no C compiler: {wanted} is not on the path")


def build(compiler: Compiler, target: Target, source: Path, library: Path, include: Path) -> None:
    """Compile one C file to a shared library, with headers of the folder ``include``."""
    command = [
        *compiler.command, *FLAGS, *target.flags, f"-DLIEID_LANES={target.lanes}", f"-I{include}",
        str(source), "-o", str(library), "-lm",
    ]  # fmt: skip
    name = compiler.command[0]
    try:
        # a new session, so that the children of the compiler driver end with it
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
            start_new_session=True, text=True, errors="replace",
        )  # fmt: skip
    except OSError as error:
        raise CompilerError(f"{name} cannot be started: {error.strerror}") from None
    with process:
        try:
            _, complaint = process.communicate(timeout=TIMEOUT)
        except BaseException as error:  # Ctrl-C too
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            if isinstance(error, subprocess.TimeoutExpired):
                raise CompilerError(f"{name} did not finish within {TIMEOUT:g} s") from None
            raise
    if process.returncode != 0 or not library.is_file():
        first = next(
            (line for line in complaint.splitlines() if "error" in line), complaint.strip()
        )
        raise CompilerError(f"{name} failed with status {process.returncode}: {first[:200]}")
