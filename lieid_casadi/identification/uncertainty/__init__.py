"""Standard deviations, noise of residuals, prediction bands and bootstrap."""
