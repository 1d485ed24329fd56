"""Export of a fit by format: C for controllers, URDF and MJCF for simulators."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.c.export import export_c
from lieid_casadi.exporters.mjcf.export import export_mjcf
from lieid_casadi.exporters.urdf.export import export_urdf
from lieid_casadi.identification.fit import Fit


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
    *,
    to: Literal["c", "urdf", "mjcf"],
    prefix: str | None = None,
    functions: Sequence[str] | None = None,
    runtime: Sequence[str] = (),
    float32: bool = False,
    force: bool = False,
) -> Export:
    """Write a fit for a controller or a simulator.

    Parameters
    ----------
    fit : Fit
        For ``urdf`` and ``mjcf`` of method ``feasible``.
    folder : str or Path
        Made if it does not exist; written as a whole or not at all.
    to : {"c", "urdf", "mjcf"}
        C99 code with its self-test, a URDF with a MuJoCo fragment of the joints, or a MuJoCo
        model.
    prefix : str, optional
        Of all C names; ``arm`` if left out.
    functions : sequence of str, optional
        C functions to write, see `lieid_casadi.exporters.c.export.export_c`; all if left out.
    runtime : sequence of str
        Numbers that are arguments of the C functions instead of constants: ``payload``,
        ``parameters``.
    float32 : bool
        C in single precision.
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
            runtime=runtime,
            float32=float32,
            force=force,
        )
        return Export(made.files, made.notes)
    if to not in ("urdf", "mjcf"):
        raise ExportError(f"format {to!r}; expected 'c', 'urdf' or 'mjcf'")
    if prefix is not None or functions is not None or runtime or float32:
        raise ExportError("prefix, functions, runtime and float32 apply to C code; expected to='c'")
    if to == "mjcf":
        model = export_mjcf(fit, folder, force=force)
        return Export((model.mjcf,), model.notes)
    written = export_urdf(fit, folder, force=force)
    return Export((written.urdf, written.mjcf, written.isaac), written.notes)
