"""Variables of the template of the self-test of exported C."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.exporters.c.functions import (
    RIGID_ARGUMENTS,
    SAMPLE_ARGUMENTS,
    WITHOUT_NUMBERS,
    ExportForm,
)
from lieid_casadi.exporters.c.self_test_data import (
    SelfTestData,
    SelfTestNumbers,
    self_test_data,
)
from lieid_casadi.identification.fit import Fit


def self_test_content(fit: Fit, names: Collection[str], form: ExportForm) -> dict[str, Any]:
    """Return the variables of the template of the self-test.

    ``names``: the exported functions.
    """
    tested = SelfTestNumbers.of(fit, form)
    stored = self_test_data(fit, names, form)
    rigid = [name for name in RIGID_ARGUMENTS if name in names]
    calls = [name for name in SAMPLE_ARGUMENTS if name in names]
    results = _compared(stored.results, names, calls)
    parameters = _identified(fit)
    arrays = _inputs_read(stored, rigid, calls)
    arrays += [(name, values.ravel()) for name, values in results.items()]
    arrays += list(parameters.items())
    if form.runtime:
        arrays += _factors(fit, tested, names)
    if stored.acceleration_scale is not None:
        arrays.append(("acceleration_scale", stored.acceleration_scale))
    sizes = {name: values.shape[1] for name, values in results.items()}
    products = {"effect_columns", "base_regressor"} & set(names)
    reports = [
        "begin", *(["states", "held_states"] if "states" in results else []),
        *calls, *(["products"] if products else []),
    ]  # fmt: skip
    return {
        "samples": len(stored.inputs["q"]),
        "largest": max(fit.model.n, *sizes.values()),
        "arrays": arrays,
        "parameters": [(name, len(values)) for name, values in parameters.items()],
        "rigid_calls": [
            (name, RIGID_ARGUMENTS[name], sizes[name], name not in WITHOUT_NUMBERS)
            for name in rigid
        ],
        "own": "tested" if form.runtime else None,
        "numbers_given": _numbers_given(tested, form),
        "effect_calls": [(name, SAMPLE_ARGUMENTS[name], sizes[name]) for name in calls],
        "multiplies": bool(products) or "regressor" in names,
        "signs": [("", "NULL"), ("_smooth", "v0")] if calls else [],
        "reports": reports,
        "worsts": ", ".join(f"of_{name} = 0.0" for name in reports),
    }


def _compared(
    results: dict[str, Array], names: Collection[str], calls: Sequence[str]
) -> dict[str, Array]:
    """Return the results that the C code reads: without a rigid torque that nothing needs."""
    loaded = any(SAMPLE_ARGUMENTS[name] == "load" for name in calls)
    if loaded or {"rigid_torque", "regressor"} & set(names):
        return results
    return {name: values for name, values in results.items() if name != "rigid_torque"}


def _identified(fit: Fit) -> dict[str, Array]:
    """Return the identified numbers; those of which the model has none are left out."""
    numbers = {
        "link_parameters": fit.link_parameters,
        "base_parameters": fit.values,
        "effect_coefficients": fit.effect_coefficients,
        "shapes": fit.shapes,
    }
    return {name: values for name, values in numbers.items() if len(values)}


def _inputs_read(
    stored: SelfTestData, rigid: Sequence[str], calls: Sequence[str]
) -> list[tuple[str, Array]]:
    """Return the inputs that the tested functions read, by their names in C."""
    read = {name for function in rigid for name in RIGID_ARGUMENTS[function]}
    if calls:
        read |= {"q", "dq", "ddq", "temperature", "time"}
    # "time" is a function of C
    arrays = [
        (f"{name}_" if name == "time" else name, values.ravel())
        for name, values in stored.inputs.items()
        if name in read
    ]
    return [*arrays, ("v0", stored.v0)] if calls else arrays


def _factors(fit: Fit, tested: SelfTestNumbers, names: Collection[str]) -> list[tuple[str, Array]]:
    """Return what each exported matrix is multiplied by, where numbers are inputs."""
    links = tested.links(fit)
    every = np.concatenate([links, tested.effect_coefficients])
    factors = {
        "regressor": ("tested_link_parameters", links),
        "base_regressor": ("tested_base_parameters", fit.model.base.combination @ every),
        "effect_columns": ("tested_effect_coefficients", tested.effect_coefficients),
    }
    return [factor for name, factor in factors.items() if name in names]


def _numbers_given(tested: SelfTestNumbers, form: ExportForm) -> list[tuple[str, Array]]:
    """Return the numbers that are inputs of the exported functions."""
    return [
        (name, getattr(tested, name))
        for name in ("link_parameters", "effect_coefficients", "shapes", "payload")
        if len(getattr(tested, name))
        and ("payload" if name == "payload" else "parameters") in form.runtime
    ]
