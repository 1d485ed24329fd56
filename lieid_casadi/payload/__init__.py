"""What hangs on the tool: a payload's mass, centre of mass and inertia, by a fit without it."""

from lieid_casadi.payload.estimate import FeasibleBody, NotIdentified, PayloadEstimate
from lieid_casadi.payload.identify import identify_payload

__all__ = ["FeasibleBody", "NotIdentified", "PayloadEstimate", "identify_payload"]
