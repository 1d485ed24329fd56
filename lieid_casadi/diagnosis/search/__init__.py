"""Stepwise selection of effects, with evidence and rivals."""
