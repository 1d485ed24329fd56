"""Versions and recordings that the results come from."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version

from lieid_casadi.comparison import Comparison
from lieid_casadi.identification import Fit
from lieid_casadi.identification.provenance import Source
from lieid_casadi.report.section import Section


def provenance_section(
    fit: Fit, comparison: Comparison | None = None, *, loaded: Sequence[Source] = ()
) -> Section:
    """Return versions, and names and hashes of all recordings.

    Parameters
    ----------
    fit : Fit
    comparison : Comparison, optional
        Its recordings are listed as tests.
    loaded : sequence of Source
        Recordings with a payload.
    """
    sources = [("training", source) for source in fit.provenance.recordings]
    if comparison is not None:
        sources += [("test", source) for source in comparison.recordings]
    sources += [("with payload", source) for source in loaded]
    data = {
        "facts": [
            ("robot", fit.model.robot.name),
            ("fitted with lieid-casadi", fit.provenance.version),
            ("cut-off", f"{fit.processing.cutoff:.4g} Hz"),
            ("Python", platform.python_version()),
            *((name, _version(name)) for name in ("casadi", "numpy", "scipy")),
        ],
        "sources": [(use, source.name or "–", source.sha256 or "–") for use, source in sources],
    }
    return Section("Provenance", "provenance.html", data, folded=True)


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
