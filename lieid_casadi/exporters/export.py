"""Export of a fit by format: C for controllers, URDF and MJCF for simulators."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.c_export import export_c
from lieid_casadi.exporters.urdf_export import export_urdf
from lieid_casadi.identification.fit import Fit


@dataclass(frozen=True)
class Export:
    """The files of an export, and notes for their users."""

    files: tuple[Path, ...]
    notes: tuple[str, ...]


def export(
    fit: Fit,
    folder: str | Path,
    *,
    to: Literal["c", "urdf"],
    prefix: str | None = None,
    functions: Sequence[str] | None = None,
    force: bool = False,
) -> Export:
    """Write a fit for a controller or a simulator.

    Parameters
    ----------
    fit : Fit
        For ``urdf`` of method ``feasible``.
    folder : str or Path
        Made if it does not exist; written as a whole or not at all.
    to : {"c", "urdf"}
        C99 code with its self-test, or a URDF with a MuJoCo fragment of the joints.
    prefix : str, optional
        Of all C names; ``arm`` if left out.
    functions : sequence of str, optional
        C functions to write, see `lieid_casadi.exporters.c_export.export_c`; all if left out.
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
    if to == "c":
        made = export_c(
            fit,
            folder,
            prefix="arm" if prefix is None else prefix,
            functions=functions,
            force=force,
        )
        return Export(made.files, made.notes)
    if to != "urdf":
        raise ExportError(f"format {to!r}; expected 'c' or 'urdf'")
    if prefix is not None or functions is not None:
        raise ExportError("prefix and functions apply to C code; expected to='c'")
    written = export_urdf(fit, folder, force=force)
    return Export((written.urdf, written.mjcf), written.notes)
