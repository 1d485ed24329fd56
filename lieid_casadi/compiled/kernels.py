"""The kernels of a model: loaded from the cache, or built by the system's C compiler."""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import logging
import os
import platform
import shlex
import shutil
import signal
import subprocess
import tempfile
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TypeVar

import casadi as ca
import numpy as np

from lieid_casadi.codegen_files import codegen_folder
from lieid_casadi.compiled import cache as disk
from lieid_casadi.compiled.kernel_source import kernel_source
from lieid_casadi.compiled.library import (
    Kernel,
    Reducer,
    Runtime,
    load_kernel,
    load_reducer,
    load_runtime,
)
from lieid_casadi.errors import CompilerError
from lieid_casadi.expressions.c_writer import UnsupportedOperation
from lieid_casadi.expressions.model_functions import ModelFunctions, SparseFunction
from lieid_casadi.robot import Joint

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


logger = logging.getLogger("lieid_casadi")

T = TypeVar("T")
Loaded = TypeVar("Loaded", Kernel, Reducer, Runtime)

# Functions of the robot's geometry alone: their cache key is made of its numbers, so that a hit
# derives nothing. All others are small, and their key is made of their C source.
RIGID = frozenset(
    {"regressor", "base_regressor", "inverse_dynamics", "mass_matrix", "gravity", "jacobian"}
)


class Kernels:
    """The kernels of one model for one instruction set; safe to use from several threads."""

    def __init__(self, functions: ModelFunctions, lanes: int | None = None) -> None:
        self.functions = functions
        self.target = target_of(lanes)
        self._loaded: dict[str, Kernel] = {}
        self._runtime: Runtime | None = None

    def get(self, names: Iterable[str]) -> tuple[Runtime, tuple[Kernel, ...]] | None:
        """Return the runtime and kernels of functions; None without a working compiler."""
        return CompilerFailure.unless(lambda: self._runtime_and(tuple(names)))

    def _runtime_and(self, names: tuple[str, ...]) -> tuple[Runtime, tuple[Kernel, ...]]:
        missing = [name for name in names if name not in self._loaded]
        if self._runtime is not None and len(missing) < 2:
            built = [self._kernel(name) for name in missing]
        else:
            with ThreadPoolExecutor(2) as pool:  # two compilers at once
                runtime = pool.submit(_own_library, load_runtime, self.target, "lieid_batch.c")
                built = list(pool.map(self._kernel, missing))
            self._runtime = runtime.result()
        self._loaded.update(zip(missing, built, strict=True))
        return self._runtime, tuple(self._loaded[name] for name in names)

    def _kernel(self, name: str) -> Kernel:
        def source() -> str:
            sparse = getattr(self.functions, name)
            assert isinstance(sparse, SparseFunction)
            return kernel_source(sparse)

        if name in RIGID:
            content = _rigid_content(self.functions, name)
            return _library(load_kernel, self.target, content, source)
        text = source()
        return _library(load_kernel, self.target, text, lambda: text)


class CompilerFailure:
    """Why this process works without a compiler; set once, so that a hang occurs once."""

    reason: str | None = None

    @classmethod
    def unless(cls, build: Callable[[], T]) -> T | None:
        """Return what a function builds; None without a compiler. The first reason is logged."""
        if cls.reason is not None:
            return None
        try:
            return build()
        except UnsupportedOperation as error:
            logger.warning("%s; CasADi's virtual machine evaluates it", error)
            return None
        except CompilerError as error:
            reason = str(error)
        except OSError as error:
            reason = f"compiled code cannot be stored: {error}"
        if cls.reason is None:
            cls.reason = reason
            logger.warning(
                "%s; models are evaluated by CasADi's virtual machine, some 50 times slower. "
                "Remedy: install a C compiler (e.g. apt install gcc) or set CC to one that works",
                reason,
            )
        return None


def target_of(lanes: int | None) -> Target:
    """Return the fastest instruction set of this processor, or that of ``lanes`` samples."""
    targets = available_targets()
    if lanes is None:
        return targets[0]
    for target in targets:
        if target.lanes == lanes:
            return target
    known = ", ".join(str(target.lanes) for target in targets)
    raise CompilerError(f"lanes: {lanes}; expected one of {known} on this processor")


def reducer() -> Reducer | None:
    """Return the reduction to triangular factors; None without a working compiler."""
    return CompilerFailure.unless(_reducer)


@cache
def _reducer() -> Reducer:
    return _own_library(load_reducer, target_of(None), "lieid_reduce.c")


def _own_library(load: Callable[[Path], Loaded], target: Target, name: str) -> Loaded:
    """Return a library whose source is a file of ``codegen``."""
    text = _source(name)
    return _library(load, target, text, lambda: text)


@cache
def _source(name: str) -> str:
    return (codegen_folder() / name).read_text(encoding="utf-8")


_libraries: dict[str, Kernel | Reducer | Runtime] = {}  # by key, for every model of this process
_lock = threading.Lock()


def _library(
    load: Callable[[Path], Loaded], target: Target, content: str, source: Callable[[], str]
) -> Loaded:
    compiler = find_compiler()
    parts = (
        platform.machine(), target.name, *FLAGS, *target.flags, compiler.identity,
        _source("lieid_lanes.h"), content,
    )  # fmt: skip
    key = hashlib.sha256("\0".join(parts).encode()).hexdigest()[:40]
    with _lock:
        loaded_before = _libraries.get(key)
    if loaded_before is not None:
        return loaded_before  # type: ignore[return-value]  # the key's content determines its type
    loaded = _from_cache(load, key)
    if loaded is None:
        path = disk.store(key, _compiled(compiler, target, source()))
        try:
            loaded = load(path)
        except CompilerError:
            disk.discard(path)
            raise
    with _lock:
        _libraries[key] = loaded
    return loaded


def _from_cache(load: Callable[[Path], Loaded], key: str) -> Loaded | None:
    """Return a library of the cache; one that cannot be used is deleted, to be built again."""
    path = disk.find(key)
    if path is None:
        return None
    try:
        return load(path)
    except CompilerError as error:
        logger.info("%s; it is built again", error)
        disk.discard(path)
        return None


def _compiled(compiler: Compiler, target: Target, text: str) -> bytes:
    with tempfile.TemporaryDirectory(prefix="lieid-casadi-") as folder:
        source, library = Path(folder, "model.c"), Path(folder, "model.so")
        source.write_text(text, encoding="utf-8")
        build(compiler, target, source, library, codegen_folder())
        return library.read_bytes()


def _rigid_content(functions: ModelFunctions, name: str) -> str:
    """Return all that a rigid function depends on: geometry, kept columns, deriving code."""
    model = functions.model
    robot, digest = model.robot, hashlib.sha256()
    for array in (robot.gravity, robot.tool, *(a for j in robot.joints for a in (j.screw, j.home))):
        digest.update(np.ascontiguousarray(array, dtype=np.float64).tobytes())
    if name == "base_regressor":
        kept = model.base.kept
        digest.update(kept[kept < 10 * model.n].astype(np.int64).tobytes())
    return f"{name} {digest.hexdigest()} {_derivation()}"


@cache
def _derivation() -> str:
    """Return a digest of the code between a robot and its C source."""
    package, here = Path(__file__).parents[1], Path(__file__).parent
    files = [*(package / "dynamics").glob("*.py"), Path(inspect.getfile(Joint))]
    files += [package / "expressions" / name for name in ("model_functions.py", "c_writer.py")]
    files.append(here / "kernel_source.py")
    digest = hashlib.sha256(ca.CasadiMeta.version().encode())
    for path in sorted(files):
        digest.update(path.read_bytes())
    return digest.hexdigest()
