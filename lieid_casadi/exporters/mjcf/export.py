"""``lieid export FIT --to mjcf``: a MuJoCo model in a folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from lieid_casadi.exporters.mjcf.model import mjcf_text
from lieid_casadi.exporters.urdf.export import check_possible, file_name
from lieid_casadi.identification.fit import Fit
from lieid_casadi.output_folder import check_folder, write_folder


@dataclass(frozen=True)
class MjcfExport:
    """The file of an export, and notes for its users."""

    mjcf: Path
    notes: tuple[str, ...]


def export_mjcf(fit: Fit, folder: str | Path, *, force: bool = False) -> MjcfExport:
    """Write ``ROBOT.xml``, a MuJoCo model, into a folder.

    ``fit``: of method ``feasible``; ``folder``: made if it does not exist; written as a whole or
    not at all; ``force``: replace what an earlier export wrote into the folder; other files are
    kept.
    Raises `ExportError`: the fit's masses and inertias are not certified to be physically
    consistent; the message has the command that makes a fit whose are. Raises `OutputError`: the
    folder has other content or cannot be written.
    """
    check_folder(folder, force=force)
    check_possible(fit)
    text, notes = mjcf_text(fit)
    name = f"{file_name(fit.model.robot.name)}.xml"
    (written,) = write_folder(folder, {name: text.encode()}, force=force)
    return MjcfExport(written, tuple(notes))
