"""Functions of the motion that a joint's error may depend on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.identification import Fit
from lieid_casadi.identification.prediction import torque_along
from lieid_casadi.identification.uncertainty.noise_model import common_effect_columns
from lieid_casadi.recording.processed import Processed

Array = NDArray[np.float64]
STEEP = 10.0  # of the smoothed sign of another joint's velocity, relative to its top speed


def motion_columns(fit: Fit, segment: Processed) -> Array:
    """Return filtered functions of the motion along a segment (M, n, k).

    Those of common effects of a joint's own motion, of the rate of its torque (a delay), of its
    position, and of the velocities and directions of all joints (couplings).

    Parameters
    ----------
    fit : Fit
    segment : Processed
        With M filtered instants.
    """
    links = fit.link_parameters
    q, dq = (segment.filter(x) for x in (segment.q, segment.dq))
    load = segment.filter(fit.compiled.inverse_dynamics(segment.q, segment.dq, segment.ddq, links))
    time = segment.filtered_time
    torque = segment.filter(torque_along(fit.compiled, segment, fit.parameters, fit.shapes))
    rate = np.gradient(torque, time, axis=0) if len(time) > 1 else np.zeros_like(load)
    direction = np.tanh(STEEP * dq / np.maximum(np.abs(dq).max(axis=0), 1e-9))
    own = [np.ones_like(q), direction, np.abs(dq), q, load, rate, np.sin(2 * q), np.cos(2 * q)]
    others = np.concatenate([dq, direction], axis=1)
    return np.concatenate(
        [
            common_effect_columns(fit.compiled, segment, links),
            np.stack(own, axis=-1),
            np.repeat(others[:, None], fit.model.n, axis=1),
        ],
        axis=-1,
    )


def coupling_columns(segment: Processed) -> Array:
    """Return filtered positions and products of two velocities along a segment (M, n + n(n+1)/2).

    Springs between joints, and torque of wrong kinematics, follow them on every joint.
    """
    first, second = np.triu_indices(segment.n)
    products = segment.dq[:, first] * segment.dq[:, second]
    return np.concatenate([segment.filter(segment.q), segment.filter(products)], axis=1)
