"""Identification of a payload at the tool from a fit without it and a run with it."""

from lieid_casadi.payload.estimate import NotIdentified, PayloadEstimate
from lieid_casadi.payload.identify import identify_payload

__all__ = ["NotIdentified", "PayloadEstimate", "identify_payload"]
