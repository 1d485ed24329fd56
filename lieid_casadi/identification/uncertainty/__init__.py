"""Standard deviations, prediction bands, bootstrap and instrumental variables."""
