"""Checks of a finished search: what is removed again, rivals, and how stable the choice is."""
