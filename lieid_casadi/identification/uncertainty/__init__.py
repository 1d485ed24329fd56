"""Standard deviations, noise of residuals, shape intervals and draws."""
