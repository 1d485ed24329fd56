"""Files that the page saves: the fit, a report, C code, URDF."""

from __future__ import annotations

import io
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from lieid_casadi.comparison import compare
from lieid_casadi.exporters.export import export
from lieid_casadi.identification import identify
from lieid_casadi.identification.fit_file import content_of
from lieid_casadi.report import comparison_report, fit_report
from lieid_casadi.simulation import window_drift
from lieid_casadi.workbench.computing.computation import Computation
from lieid_casadi.workbench.state.session import ModelStep

Kind = Literal["fit", "report", "c", "urdf", "mjcf"]


def saved_file(
    state: Computation, step: ModelStep, *, kind: Kind, report: Callable[[str, float], None]
) -> tuple[str, bytes]:
    """Return the name and the content of a file.

    Parameters
    ----------
    state : Computation
    step : ModelStep
    kind : {"fit", "report", "c", "urdf", "mjcf"}
        Exports are zip files; for URDF and MJCF, the model is fitted with physically consistent
        inertias.
    report : callable
        Called with the name of a stage and the fraction done.
    """
    fit = state.fit(step, report)
    train, test = state.used(step)
    if kind == "fit":
        return "fit.json", content_of(fit)
    if kind == "report":
        drift = window_drift(fit, test) if test else None
        page = comparison_report(fit, compare(fit, test), drift) if test else fit_report(fit)
        return "report.html", page.encode(errors="replace")
    if kind in ("urdf", "mjcf") and fit.method != "feasible":
        fit = identify(fit.model, train, method="feasible", processing=fit.processing)
    with tempfile.TemporaryDirectory(prefix="lieid-") as folder:
        target = Path(folder) / kind
        export(fit, target, to=kind)
        return f"{fit.model.robot.name}_{kind}.zip", _zipped(target)


def _zipped(folder: Path) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(folder.rglob("*")):
            if file.is_file():
                archive.write(file, file.relative_to(folder.parent))
    return content.getvalue()
