"""Sections of reports: one per file, with its template."""
