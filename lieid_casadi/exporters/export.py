"""Export of a fit by format: C for controllers, URDF and MJCF for simulators."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.c.export import c_files
from lieid_casadi.exporters.mjcf import mjcf_files
from lieid_casadi.exporters.urdf import urdf_files
from lieid_casadi.identification.fit import Fit
from lieid_casadi.output_folder import check_folder, write_folder


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
        Of all C names, so that one program can contain several arms; ``arm`` if left out.
    functions : sequence of str, optional
        C functions to write, of `lieid_casadi.exporters.c.functions.NAMES`; those that they
        call are added. Default: all that the fit has. Forward dynamics are left out, with a
        note, if the mass matrix is not positive definite in a pose within the joint limits.
    runtime : sequence of str
        Numbers that are arguments of the C functions instead of constants: ``payload`` (ten link
        parameters of a body at the tool), ``parameters`` (all link parameters, effect coefficients
        and shape parameters).
    float32 : bool
        C in single precision, and a self-test with the tolerance of such values.
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
    check_folder(folder, force=force)
    if to not in ("c", "urdf", "mjcf"):
        raise ExportError(f"format {to!r}; expected 'c', 'urdf' or 'mjcf'")
    if to == "c":
        files, notes = c_files(
            fit,
            prefix="arm" if prefix is None else prefix,
            functions=functions,
            runtime=runtime,
            float32=float32,
        )
    elif prefix is not None or functions is not None or runtime or float32:
        raise ExportError("prefix, functions, runtime and float32 apply to C code; expected to='c'")
    else:
        files, notes = mjcf_files(fit) if to == "mjcf" else urdf_files(fit)
    return Export(write_folder(folder, files, force=force), tuple(notes))
