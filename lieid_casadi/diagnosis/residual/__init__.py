"""Description of the residual that no effect of the library explains."""
