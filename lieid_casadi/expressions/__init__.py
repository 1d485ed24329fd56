"""CasADi functions of a model."""
