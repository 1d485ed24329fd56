"""Recordings as NumPy archives: arrays t (N,), q, dq, tau, ddq, temp, i (N, n), load (N,)."""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lieid_casadi.atomic_file import atomic_binary
from lieid_casadi.errors import LieidWarning, RecordingError, UnknownColumnWarning
from lieid_casadi.recording.readers.columns import FIELDS, LABEL
from lieid_casadi.recording.recording import Recording

EXPECTED = "arrays t (N,), q (N, n) and optionally dq, tau, ddq, temp, i (N, n), load (N,)"


def load_npz(
    file: Path,
    *,
    n: int | None = None,
    joint_names: Sequence[str] | None = None,
    topic: str | None = None,
) -> Recording:
    """Read an NPZ; pickled objects are refused, so that loading never runs code.

    Raises
    ------
    RecordingError
        Not an archive, a missing array, or a shape that does not fit.
    """
    content = file.read_bytes()
    arrays = _arrays(file, content)
    for name in ("t", "q"):
        if name not in arrays:
            found = ", ".join(arrays) or "nothing"
            raise RecordingError(f"{file}: found {found}, expected {EXPECTED}")
    for name, values in arrays.items():
        if (name == "t" or name in FIELDS) and values.dtype.kind not in "iufb":
            raise RecordingError(
                f"{file}: array {name} holds {values.dtype}, expected real numbers"
            )
    q = arrays["q"]
    if n is not None and q.ndim == 2 and q.shape[1] != n:
        raise RecordingError(f"{file}: found {q.shape[1]} joints in q, expected {n}")
    label = arrays.get(LABEL)
    unknown = [name for name in arrays if name not in ("t", LABEL, *FIELDS)]
    warnings: tuple[LieidWarning, ...] = ()
    if unknown:
        names = ", ".join(unknown[:8])
        warnings = (UnknownColumnWarning(f"{file.name}: arrays left aside: {names}"),)
    return Recording(
        t=arrays["t"],
        payload_label=None if label is None else tuple(str(x) for x in np.ravel(label)),
        name=file.name,
        source_hash=hashlib.sha256(content).hexdigest(),
        warnings=warnings,
        **{field: arrays[prefix] for prefix, field in FIELDS.items() if prefix in arrays},
    )


def save_npz(recording: Recording, file: Path) -> None:
    """Write a compressed NPZ."""
    arrays: dict[str, Any] = {"t": recording.t}
    for prefix, field in FIELDS.items():
        if getattr(recording, field) is not None:
            arrays[prefix] = getattr(recording, field)
    if recording.payload_label is not None:
        arrays[LABEL] = np.asarray(recording.payload_label, dtype=np.str_)
    with atomic_binary(file) as out:
        np.savez_compressed(out, **arrays)


def _arrays(file: Path, content: bytes) -> dict[str, Any]:
    if not content:
        raise RecordingError(f"{file}: found an empty file, expected {EXPECTED}")
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise RecordingError(f"{file}: found a single array, expected {EXPECTED}")
            return {name: archive[name] for name in archive.files}
    except RecordingError:
        raise
    except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        reason = str(error).splitlines()[0]
        raise RecordingError(f"{file}: not an NPZ of plain arrays ({reason})") from error
