"""Reports: self-contained HTML files with embedded figures."""

from lieid_casadi.report.page import render
from lieid_casadi.report.picture import data_uri
from lieid_casadi.report.reports import (
    comparison_report,
    diagnosis_report,
    fit_report,
    payload_report,
)
from lieid_casadi.report.section import Section

__all__ = [
    "Section",
    "comparison_report",
    "data_uri",
    "diagnosis_report",
    "fit_report",
    "payload_report",
    "render",
]
