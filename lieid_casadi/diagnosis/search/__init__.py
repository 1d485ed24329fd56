"""Stepwise search for effects: one search, and its two problems, missing and changed effects."""
