"""Reports: self-contained HTML files with embedded figures."""

from lieid_casadi.report.page import Section, data_uri, render
from lieid_casadi.report.reports import (
    comparison_report,
    diagnosis_report,
    effect_page,
    experiment_report,
    extension_report,
    fit_report,
    payload_report,
    premises_report,
)

__all__ = [
    "Section",
    "comparison_report",
    "data_uri",
    "diagnosis_report",
    "effect_page",
    "experiment_report",
    "extension_report",
    "fit_report",
    "payload_report",
    "premises_report",
    "render",
]
