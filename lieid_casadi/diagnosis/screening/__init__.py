"""What each candidate effect would explain of the residual of a fitted model."""
