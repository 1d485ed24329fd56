"""Standard deviations, prediction bands, bootstrap and cross-validation."""
