"""Kernels and batch runtime on aarch64 with NEON, under emulation, against this processor."""

import shutil
import subprocess

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi.codegen_files import codegen_folder
from lieid_casadi.compiled.compiler import FLAGS, TARGETS
from lieid_casadi.compiled.kernel_source import CONSTANT_ARGUMENTS, kernel_source
from lieid_casadi.expressions.model_functions import ModelFunctions

SAMPLES = 6
NEON = next(target for target in TARGETS if target.name == "neon")
EFFECTS = (
    "coulomb,viscous,stribeck,viscous_polynomial,load_friction:2,position_friction:1,"
    "sigmoid_friction:2,temperature_friction/exponential:1"
)
COMPILERS = {
    "gcc": (("aarch64-linux-gnu-gcc",), "aarch64-linux-gnu-objdump"),
    "clang": (("clang", "--target=aarch64-linux-gnu"), "aarch64-linux-gnu-objdump"),
}

MAIN = """
#include <stdio.h>
enum {{ SAMPLES = {samples}, ARGUMENTS = {arguments}, VALUES = {values}, ROWS = {rows} }};
static const int widths[ARGUMENTS] = {{{widths}}}, constant[ARGUMENTS] = {{{constant}}};
static const int starts[ROWS] = {{{starts}}};
{arrays}
static const double *const data[ARGUMENTS] = {{{names}}};

int main(void)
{{
    static double lanes[ARGUMENTS][{widest} * LIEID_LANES], values[VALUES * LIEID_LANES];
    const double *in[ARGUMENTS];
    double *rows[ROWS];
    for (int i = 0; i < ROWS; i++) rows[i] = values + starts[i] * LIEID_LANES;
    for (int s = 0; s < SAMPLES; s += LIEID_LANES) {{
        for (int a = 0; a < ARGUMENTS; a++) {{
            in[a] = constant[a] ? data[a] : lanes[a];
            if (!constant[a])
                for (int j = 0; j < widths[a]; j++)
                    for (int k = 0; k < LIEID_LANES; k++)
                        lanes[a][j * LIEID_LANES + k] = data[a][(s + k) * widths[a] + j];
        }}
        for (int j = 0; j < widths[0]; j++) {{
            lieid_v sine, cosine;
            lieid_sincos(lieid_load(in[0] + j * LIEID_LANES), &sine, &cosine);
            lieid_store(lanes[1] + j * LIEID_LANES, sine);
            lieid_store(lanes[2] + j * LIEID_LANES, cosine);
        }}
        lieid_kernel(in, rows, LIEID_LANES);
        for (int k = 0; k < LIEID_LANES; k++)
            for (int v = 0; v < VALUES; v++) printf("%a\\n", values[v * LIEID_LANES + k]);
    }}
    return 0;
}}
"""


def run(*command):
    if shutil.which(command[0]) is None:
        pytest.skip(f"no {command[0]}")
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stderr[-3000:]}"
    return done.stdout


def inputs_of(sparse, n):
    """Arguments by name: (SAMPLES, width), or (width,) for constants; sines and cosines of q."""
    random, given = np.random.default_rng(4), {}
    for k in range(sparse.function.n_in()):
        name, width = sparse.function.name_in(k), sparse.function.size1_in(k)
        shape = (width,) if name in CONSTANT_ARGUMENTS else (SAMPLES, width)
        given[name] = random.uniform(0.1, 1.5, shape) * np.where(
            name in CONSTANT_ARGUMENTS, 1.0, random.choice([-1.0, 1.0], shape)
        )
    if "sin" in given:
        given["sin"], given["cos"] = np.sin(given["q"]), np.cos(given["q"])
    return given


def program(sparse, given):
    """A program that prints all values of a kernel along the samples."""
    source = kernel_source(sparse)
    rows = sparse.shape[0]
    counts = np.bincount(sparse.rows, minlength=rows)
    if "sin" not in given:  # places for sines and cosines, which the program computes
        first, *others = given
        padded = {first: given[first], "sin_": given[first], "cos_": given[first]}
        order = [0, *range(3, 3 + len(others))]
        given = padded | {name: given[name] for name in others}
        source = source.replace("lieid_kernel(", "lieid_inner(").replace(
            "void lieid_inner", "static void lieid_inner"
        )
        chosen = ", ".join(f"all[{k}]" for k in order)
        source += (
            "static void lieid_kernel(const double *const *all, double *const *rows, ptrdiff_t ld)"
            f"{{ const double *const in[] = {{{chosen}}}; lieid_inner(in, rows, ld); }}\n"
        )
    arrays = "".join(
        f"static const double a_{name}[] = {{{', '.join(map(float.hex, values.ravel()))}, 0.0}};\n"
        for name, values in given.items()
    )
    widths = [np.shape(values)[-1] for values in given.values()]
    return source + MAIN.format(
        samples=SAMPLES, arguments=len(given), values=len(sparse.rows), rows=rows,
        widths=", ".join(map(str, widths)), widest=max(widths),
        constant=", ".join(str(int(name in CONSTANT_ARGUMENTS)) for name in given),
        starts=", ".join(map(str, np.cumsum(counts) - counts)),
        arrays=arrays, names=", ".join(f"a_{name}" for name in given),
    )  # fmt: skip


def build(compiler, source, path, target):
    flags = [flag for flag in FLAGS if flag not in ("-shared", "-fPIC")]
    options = [*flags, *target.flags, f"-DLIEID_LANES={target.lanes}", f"-I{codegen_folder()}"]
    run(*compiler, *options, "-static", str(source), "-o", str(path), "-lm")


@pytest.fixture(scope="module")
def functions():
    return ModelFunctions(lieid.Model(lieid.robots.two_link(), EFFECTS))


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("name", ["regressor", "inverse_dynamics", "effect_columns"])
def test_kernels_give_the_same_bits_with_neon(name, compiler, functions, tmp_path):
    sparse = getattr(functions, name)
    given = inputs_of(sparse, 2)
    source = tmp_path / "kernel.c"
    source.write_text(program(sparse, given))
    command, dump = COMPILERS[compiler]
    build(command, source, tmp_path / "neon", NEON)
    build(("gcc",), source, tmp_path / "scalar", TARGETS[-1])
    here = run(str(tmp_path / "scalar"))
    assert run("qemu-aarch64", str(tmp_path / "neon")) == here
    values = np.array([float.fromhex(x) for x in here.split()]).reshape(SAMPLES, -1)
    order = np.lexsort((sparse.columns, sparse.rows))
    for k in range(SAMPLES):
        point = [x if key in CONSTANT_ARGUMENTS else x[k] for key, x in given.items()]
        expected = sparse.function(*point).full()[order, 0]
        np.testing.assert_allclose(values[k], expected, rtol=0, atol=1e-12 * abs(expected).max())
    assert "fmul\tv" in run(dump, "-d", "--no-show-raw-insn", str(tmp_path / "neon"))


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("name", ["lieid_batch.c", "lieid_reduce.c"])
def test_the_batch_runtime_builds_for_neon(name, compiler, tmp_path):
    command, _ = COMPILERS[compiler]
    options = [*FLAGS, *NEON.flags, f"-DLIEID_LANES={NEON.lanes}", "-Wall", "-Werror"]
    run(*command, *options, str(codegen_folder() / name), "-o", str(tmp_path / "made.so"))
