"""Export of a fit by format: C for controllers, URDF, MJCF and USD for simulators."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.c.export import c_files
from lieid_casadi.exporters.isaaclab import isaaclab_files
from lieid_casadi.exporters.mjcf import mjcf_files
from lieid_casadi.exporters.ur_friction import ur_friction_files
from lieid_casadi.exporters.urdf import urdf_files
from lieid_casadi.exporters.usd import usd_files
from lieid_casadi.identification.fit import Fit
from lieid_casadi.model import Parameter
from lieid_casadi.output_folder import check_folder, write_folder

Format = Literal["c", "urdf", "mjcf", "usd", "isaaclab", "ur-friction"]


@dataclass(frozen=True)
class Export:
    """Result of :func:`lieid_casadi.export`.

    Attributes
    ----------
    files : tuple of Path
        What was written.
    notes : tuple of str
        What the format cannot state, and what its users have to set.
    """

    files: tuple[Path, ...]
    notes: tuple[str, ...]


def export(
    fit: Fit,
    folder: str | Path,
    to: Format,
    *,
    prefix: str | None = None,
    payload: bool = False,
    into: str | Path | None = None,
    force: bool = False,
) -> Export:
    """Write a fit for a controller or a simulator.

    Parameters
    ----------
    fit : Fit
        For ``urdf``, ``mjcf`` and ``usd`` of method ``feasible``.
    folder : str or Path
        Made if it does not exist; written as a whole or not at all.
    to : {"c", "urdf", "mjcf", "usd", "isaaclab", "ur-friction"}
        C99 code with its self-test (without forward dynamics, with a note, if the mass matrix is
        not positive definite in a pose within the joint limits), a URDF, a MuJoCo model, a USD
        stage of your own, Isaac Lab's actuators, or friction for Universal Robots' direct torque
        control.
    prefix : str, optional
        Of all C names, so that one program can contain several arms; ``arm`` if left out.
    payload : bool
        The C functions have a body at the tool (ten link parameters) as an argument.
    into : str or Path, optional
        For ``usd``, ``urdf`` and ``mjcf``: the file into whose copy the numbers are written, such
        as the export of another arm of the same robot. Needed for ``usd``; the default of the
        others is the file that the robot was read from.
    force : bool
        Replace what an earlier export wrote into the folder; other files are kept.

    Returns
    -------
    Export

    Raises
    ------
    ExportError
        The fit cannot be exported to this format; the message says why.
    OutputError
        The folder has other content or cannot be written.
    """
    if to not in get_args(Format):
        hint = (
            f"; did you mean export(fit, …, {str(folder)!r})?" if folder in get_args(Format) else ""
        )
        raise ExportError(f"format {str(to)!r}; expected {', '.join(get_args(Format))}{hint}")
    check_folder(folder, force=force)
    if to != "c" and (prefix is not None or payload):
        raise ExportError("prefix and payload apply to C code; expected to='c'")
    if to not in ("usd", "urdf", "mjcf") and into is not None:
        raise ExportError("into applies to urdf, mjcf and usd; expected one of these")
    if to == "c":
        names = "arm" if prefix is None else prefix
        files, notes = c_files(fit, prefix=names, payload=payload)
    elif to in ("ur-friction", "isaaclab"):
        files, notes = (ur_friction_files if to == "ur-friction" else isaaclab_files)(fit)
    else:
        files, notes = {"urdf": urdf_files, "mjcf": mjcf_files, "usd": usd_files}[to](fit, into)
    return Export(write_folder(folder, files, force=force), tuple(notes))


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
