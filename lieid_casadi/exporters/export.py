"""Export of a fit by format: C for controllers, URDF, MJCF and USD for simulators."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from lieid_casadi.errors import ExportError
from lieid_casadi.exporters.c.export import c_files
from lieid_casadi.exporters.isaaclab import isaaclab_files
from lieid_casadi.exporters.mjcf import mjcf_files
from lieid_casadi.exporters.ur_friction import ur_friction_files
from lieid_casadi.exporters.urdf import urdf_files
from lieid_casadi.exporters.usd import usd_files
from lieid_casadi.identification.fit import Fit
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
    functions: Sequence[str] | None = None,
    runtime: Sequence[str] = (),
    compensated: Fit | None = None,
    stage: str | Path | None = None,
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
        C99 code with its self-test, a URDF, a MuJoCo model, a USD stage of your own,
        Isaac Lab's actuators, or friction for Universal Robots' direct torque control.
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
    compensated : Fit, optional
        For ``ur-friction``: a fit of motion under direct torque with the default scales.
    stage : str or Path, optional
        For ``usd``: the stage into whose copy the numbers are written.
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
    if to != "c" and (prefix is not None or functions is not None or runtime):
        raise ExportError("prefix, functions and runtime apply to C code; expected to='c'")
    if to != "ur-friction" and compensated is not None:
        raise ExportError("compensated applies to ur-friction; expected to='ur-friction'")
    if to != "usd" and stage is not None:
        raise ExportError("stage applies to usd; expected to='usd'")
    if to == "c":
        names = "arm" if prefix is None else prefix
        files, notes = c_files(fit, prefix=names, functions=functions, runtime=runtime)
    elif to == "ur-friction":
        files, notes = ur_friction_files(fit, compensated)
    elif to == "usd":
        files, notes = usd_files(fit, stage)
    else:
        files, notes = {"urdf": urdf_files, "mjcf": mjcf_files, "isaaclab": isaaclab_files}[to](fit)
    return Export(write_folder(folder, files, force=force), tuple(notes))
