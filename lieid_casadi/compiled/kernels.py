"""The kernels of a model: loaded from the cache, or built."""

from __future__ import annotations

import hashlib
import inspect
import logging
import platform
import tempfile
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import TypeVar

import casadi as ca
import numpy as np

from lieid_casadi.codegen_files import codegen_folder
from lieid_casadi.compiled import cache as disk
from lieid_casadi.compiled.compiler import (
    FLAGS,
    Compiler,
    Target,
    available_targets,
    build,
    find_compiler,
)
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
