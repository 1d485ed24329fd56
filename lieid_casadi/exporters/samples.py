"""Samples of a fit as files, for domain randomisation in simulators."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.exporters.export import Export
from lieid_casadi.exporters.mjcf import mjcf_files
from lieid_casadi.exporters.urdf import urdf_files
from lieid_casadi.identification.fit import Fit
from lieid_casadi.model import Parameter
from lieid_casadi.output_folder import write_folder


def export_samples(
    samples: Sequence[Fit],
    folder: str | Path,
    *,
    to: Literal["npz", "mjcf", "urdf"] = "npz",
    force: bool = False,
) -> Export:
    """Write ``samples.npz``, and with ``to`` a model of each sample: ``sample_001.xml`` and so on.

    The arrays are ``link_parameters`` (N, 10 n), ``effect_coefficients`` (N, m), ``shapes`` (N, s)
    and ``base_parameters`` (N, p), with the names of their columns as ``…_names``, and ``model``
    (N,), the number of each sample's model in ``models``. Models with other effects have
    coefficients of zero for those that they lack, and NaN for shapes and base parameters.
    """
    models = list(dict.fromkeys(",".join(s.model.effects) for s in samples))
    columns = {
        "link_parameters": _table([(s.model.link_parameters, s.link_parameters) for s in samples]),
        "effect_coefficients": _table(
            [(s.model.columns, s.effect_coefficients) for s in samples], missing=0.0
        ),
        "shapes": _table([(s.model.shapes, s.shapes) for s in samples]),
        "base_parameters": _table([(s.model.base_columns, s.values) for s in samples]),
    }
    content = io.BytesIO()
    arrays: dict[str, np.ndarray[Any, Any]] = {
        "models": np.array(models),
        "model": np.array([models.index(",".join(s.model.effects)) for s in samples]),
    }
    for key, (names, values) in columns.items():
        arrays |= {key: values, f"{key}_names": np.array(names)}
    np.savez(content, **arrays)  # type: ignore[arg-type]  # the names of arrays are keywords
    files, notes = {"samples.npz": content.getvalue()}, list[str]()
    if to != "npz":
        for k, sample in enumerate(samples, start=1):
            made, notes = mjcf_files(sample) if to == "mjcf" else urdf_files(sample)
            if to == "mjcf" and len(made) > 1:  # a model with the files that it includes
                files |= {f"sample_{k:03d}/{name}": text for name, text in made.items()}
                continue
            name, text = next(iter(made.items()))
            files[f"sample_{k:03d}{Path(name).suffix}"] = text
    return Export(write_folder(folder, files, force=force), tuple(notes))


def _table(
    samples: Sequence[tuple[Sequence[Parameter], Array]], *, missing: float = np.nan
) -> tuple[list[str], Array]:
    """Return the labels of all parameters, and a row of each sample's values."""
    labels = list(dict.fromkeys(p.label for parameters, _ in samples for p in parameters))
    values = np.full((len(samples), len(labels)), missing)
    for row, (parameters, numbers) in zip(values, samples, strict=True):
        row[[labels.index(p.label) for p in parameters]] = numbers
    return labels, values
