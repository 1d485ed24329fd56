"""Kernels and batch runtime are built for aarch64 with NEON, without warnings."""

import shutil
import subprocess

import pytest

import lieid_casadi as lieid
from lieid_casadi.codegen_files import codegen_folder
from lieid_casadi.compiled.compiler import FLAGS, TARGETS
from lieid_casadi.compiled.kernel_source import kernel_source
from lieid_casadi.expressions.model_functions import ModelFunctions

NEON = next(target for target in TARGETS if target.name == "neon")
COMPILER, DUMP = "aarch64-linux-gnu-gcc", "aarch64-linux-gnu-objdump"


@pytest.mark.skipif(shutil.which(COMPILER) is None, reason=f"no {COMPILER}")
@pytest.mark.parametrize("name", ["lieid_batch.c", "lieid_reduce.c", "kernel.c"])
def test_everything_builds_for_neon(name, tmp_path):
    source = codegen_folder() / name
    if name == "kernel.c":
        source = tmp_path / name
        functions = ModelFunctions(lieid.Model(lieid.robots.two_link(), "coulomb,stribeck"))
        source.write_text(kernel_source(functions.effect_columns))
    options = [*FLAGS, *NEON.flags, f"-DLIEID_LANES={NEON.lanes}", f"-I{codegen_folder()}"]
    made = str(tmp_path / "made.so")
    subprocess.run([COMPILER, *options, "-Wall", "-Werror", str(source), "-o", made], check=True)
    shown = subprocess.run([DUMP, "-d", made], check=True, capture_output=True, text=True).stdout
    assert "v0.2d" in shown  # two doubles per register
