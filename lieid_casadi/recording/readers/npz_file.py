"""Recordings as NumPy archives: arrays t (N,), q, dq … (N, n), or q1, q2 … (N,) as in a CSV."""

from __future__ import annotations

import io
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lieid_casadi.atomic_file import atomic_binary
from lieid_casadi.errors import LieidWarning, RecordingError, UnknownColumnWarning
from lieid_casadi.messages import names_text
from lieid_casadi.recording.measurement import FIELDS, Measurement
from lieid_casadi.recording.readers import registry
from lieid_casadi.recording.readers.columns import (
    LABEL,
    is_name,
    measurement_of_columns,
    signal_names,
)

EXPECTED = "arrays t (N,), q (N, n) and optionally dq, tau, ddq, temp, i (N, n), load (N,)"


def read_npz(file: Path, options: registry.ReadOptions) -> Measurement:
    """Read an NPZ; pickled objects are refused, so that loading never runs code."""
    if file.stat().st_size == 0:
        raise RecordingError(f"{file}: found an empty file, expected {EXPECTED}")
    with registry.library_errors(file, "an NPZ of plain arrays"):
        arrays, unknown, warnings = _arrays(file, options)
        made = measurement_of_columns(_columns(arrays), str(file), options.n)
    if unknown:
        text = f"{file.name}: arrays with unknown names ignored: {names_text(unknown)}"
        warnings += (UnknownColumnWarning(text),)
    return replace(made, name=file.name, source_hash=registry.hash_of_file(file), warnings=warnings)


def write_npz(measurement: Measurement, file: Path) -> None:
    """Write a compressed NPZ."""
    arrays: dict[str, Any] = {"t": measurement.t}
    for prefix, field in FIELDS.items():
        if getattr(measurement, field) is not None:
            arrays[prefix] = getattr(measurement, field)
    if measurement.payload_label is not None:
        arrays[LABEL] = np.asarray(measurement.payload_label, dtype=np.str_)
    with atomic_binary(file) as out:
        np.savez_compressed(out, **arrays)


FORMAT = registry.RecordingFormat(suffixes=(".npz",), read=read_npz, write=write_npz)


def _arrays(
    file: Path, options: registry.ReadOptions
) -> tuple[dict[str, Any], list[str], tuple[LieidWarning, ...]]:
    """Return the arrays of the signals by name, the names of other members, and warnings."""
    with zipfile.ZipFile(file) as archive:
        infos = archive.infolist()
        stored = [info.filename.removesuffix(".npy") for info in infos]
        names, assumed = signal_names(stored, str(file), options.columns, options.joint_names)
        members = dict(zip(names, infos, strict=True))
        wanted = [name for name in names if is_name(name)]
        if "t" not in wanted or not {"q", "q1"} & set(wanted):
            found = names_text(stored) or "nothing"
            raise RecordingError(f"{file}: found {found}, expected {EXPECTED}")
        if sum(members[name].file_size for name in wanted) > registry.INFLATE_LIMIT:
            raise registry.beyond_limit(file, registry.INFLATE_LIMIT)
        arrays = {}
        for name in wanted:
            # a member never yields more than the size in the archive's directory
            with archive.open(members[name]) as content:
                arrays[name] = _array(content.read(), f"{file}: array {name}", name == LABEL)
    return arrays, [name for name in names if name not in wanted], assumed


def _columns(arrays: dict[str, Any]) -> dict[str, Any]:
    """Return one array for each column, of arrays of a whole signal or of one joint."""
    columns: dict[str, Any] = {}
    for name, x in arrays.items():
        if name in FIELDS and x.ndim == 2:
            columns |= {f"{name}{j + 1}": x[:, j] for j in range(x.shape[1])}
        else:
            columns[name] = x
    return columns


def _array(content: bytes, where: str, label: bool) -> np.ndarray[Any, Any]:
    """Return the array of a ``.npy`` member."""
    array = np.lib.format.read_array(io.BytesIO(content), allow_pickle=False)
    if array.dtype.kind not in ("iufbUS" if label else "iufb"):
        expected = "text or numbers" if label else "real numbers"
        raise RecordingError(f"{where} holds {array.dtype}, expected {expected}")
    return np.asarray(array)
