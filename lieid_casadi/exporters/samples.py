"""Samples of a fit as files, for domain randomisation in simulators."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from lieid_casadi.exporters.export import Export
from lieid_casadi.exporters.mjcf import mjcf_files
from lieid_casadi.exporters.urdf import urdf_files
from lieid_casadi.identification.fit import Fit
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
    and ``base_parameters`` (N, p), with the names of their columns as ``…_names``.
    """
    model = samples[0].model
    arrays = {
        "link_parameters": [s.link_parameters for s in samples],
        "effect_coefficients": [s.effect_coefficients for s in samples],
        "shapes": [s.shapes for s in samples],
        "base_parameters": [s.values for s in samples],
    }
    names = {
        "link_parameters": model.link_parameters,
        "effect_coefficients": model.columns,
        "shapes": model.shapes,
        "base_parameters": model.base_columns,
    }
    content = io.BytesIO()
    labels = {f"{key}_names": [p.label for p in each] for key, each in names.items()}
    columns = {k: np.array(x) for k, x in (arrays | labels).items()}
    np.savez(content, **columns)  # type: ignore[arg-type]  # the names of arrays are keywords
    files, notes = {"samples.npz": content.getvalue()}, list[str]()
    if to != "npz":
        for k, sample in enumerate(samples, start=1):
            made, notes = mjcf_files(sample) if to == "mjcf" else urdf_files(sample)
            name, text = next(iter(made.items()))
            files[f"sample_{k:03d}{Path(name).suffix}"] = text
    return Export(write_folder(folder, files, force=force), tuple(notes))
