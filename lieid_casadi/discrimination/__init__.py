"""Discrimination: the motion that separates rival effects, and how long it must be run."""

from lieid_casadi.discrimination.discriminate import discriminate
from lieid_casadi.discrimination.discrimination import Discrimination, RivalPair

__all__ = ["Discrimination", "RivalPair", "discriminate"]
