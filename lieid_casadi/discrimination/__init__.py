"""Discrimination: the motion that tells rival effects apart, and how long it takes."""

from lieid_casadi.discrimination.discriminate import discriminate
from lieid_casadi.discrimination.discrimination import Discrimination, Pair

__all__ = ["Discrimination", "Pair", "discriminate"]
