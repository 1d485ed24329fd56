"""Fits with realistic numbers, made without data, and C compilers."""

import ctypes
import dataclasses
import shutil
import subprocess

import numpy as np
import pytest
from robot.random_arms import random_arm

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.recording_checks import Provenance, Source
from lieid_casadi.identification.regression.least_squares import Conditioning
from lieid_casadi.identification.uncertainty.noise_model import Noise
from lieid_casadi.recording import Processing

WARNINGS = (
    "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wsign-conversion", "-Wshadow",
    "-Wdouble-promotion", "-Wcast-qual", "-Wundef", "-Wmissing-declarations", "-Werror",
)  # fmt: skip
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g")
BUILDS = {
    "gcc": ("gcc", "-std=c99", "-O2"),
    "clang": ("clang", "-std=c99", "-O2", "-Wcomma"),
    "g++": ("g++", "-x", "c++", "-std=c++11", "-O1"),
    "clang++": ("clang++", "-x", "c++", "-std=c++11", "-O1"),
    "sanitizers": ("gcc", "-std=c99", "-O0", *SANITIZERS),
}
PANDA = (
    "coulomb,viscous,offset,armature,viscous_polynomial:1,viscous_asymmetric:2,"
    "stribeck:4,stribeck/exponent:5,stribeck/two_width:6,load_friction:2+3,"
    "load_friction/paper:1,load_friction/motoring:5,temperature_friction:1,"
    "temperature_friction/exponential:3,warm_up:7,position_friction:4,"
    "transmission_coupling:5<6,smooth/q.dq:2,smooth/q5:4"
)


def torque_of(fit, q, dq, ddq, time=None):
    """Torque (N, n) of a fit with effects on single joints at samples."""
    load = fit.compiled.inverse_dynamics(q, dq, ddq, fit.link_parameters)
    return load + fit.compiled.effect_torque(
        q, dq, ddq, fit.effect_coefficients, load=load, time=time, shapes=fit.shapes
    )


def made_fit(robot, effects, *, seed=0):
    """A fit of random numbers: link parameters off by up to 30 %, coefficients below 1."""
    model, random = lieid.Model(robot, effects), np.random.default_rng(seed)
    links = plant.perturbed_inertias(robot, spread=0.3, seed=seed)
    parameters = np.concatenate([links, random.uniform(0.05, 0.5, len(model.columns))])
    values = model.base.combination @ parameters
    shapes = model.initial_shapes * random.uniform(0.8, 1.2, len(model.shapes))
    count, n = len(values) + len(shapes), model.n
    error = np.full(n, 0.1)
    return Fit(
        model=model,
        method="ols",
        values=values,
        shapes=shapes,
        covariance=np.diag(np.full(count, 1e-6)),
        parameters=parameters,
        noise=error,
        residual_noise=tuple(Noise.white(0.1) for _ in range(n)),
        rms_train=error,
        rms_train_raw=error,
        rms_cv=error,
        processing=Processing(cutoff=5.0),
        conditioning=Conditioning(10.0, 1.0, 0.0),
        warnings=(),
        provenance=Provenance("0.0", (Source("run.csv", "0" * 64),)),
        temperature_mean=np.linspace(30.0, 40.0, n) if "temperature" in effects else None,
    )


def with_load_friction(fit, size):
    """The fit with coefficients that load friction of a drive can have, N·m per (N·m)²."""
    square = [c.name.startswith("load_friction") for c in fit.model.columns]
    parameters = fit.parameters.copy()
    parameters[10 * fit.model.n :][square] = size
    return dataclasses.replace(
        fit, parameters=parameters, values=fit.model.base.combination @ parameters
    )


ARMS = {
    "panda": lambda: made_fit(lieid.robots.panda(), PANDA),
    "sliding": lambda: with_load_friction(
        made_fit(
            random_arm(np.random.default_rng(4), 4),
            "coulomb,viscous,armature:2,load_friction/square",
        ),
        1e-4,
    ),
    "presliding": lambda: made_fit(
        lieid.robots.two_link(), "viscous,presliding:1,presliding/load:2,presliding/lugre:2"
    ),
    "rigid": lambda: made_fit(lieid.robots.two_link(), ""),
}


def run(command, folder):
    """Run a command that must succeed; skip if it is not installed."""
    if shutil.which(command[0]) is None:
        pytest.skip(f"no {command[0]}")
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stderr[-3000:]}\n{done.stdout}"
    return done.stdout


def library(folder, *, files=("arm.c", "arm_parameters.c")):
    """The exported functions as a shared library."""
    run(["gcc", "-std=c99", "-O0", "-shared", "-fPIC", *files, "-lm", "-o", "arm.so"], folder)
    return ctypes.CDLL(str(folder / "arm.so"))


def sample_type(n):
    """The struct of a sample, by the header."""
    row = ctypes.c_double * n

    class Sample(ctypes.Structure):
        _fields_ = (
            ("q", row), ("dq", row), ("ddq", row), ("temperature", row), ("time", ctypes.c_double)
        )  # fmt: skip

    return Sample


def pointer(array):
    assert array.dtype == np.float64
    assert array.flags.c_contiguous
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def constants(loaded, name, count):
    return np.array((ctypes.c_double * count).in_dll(loaded, name))
