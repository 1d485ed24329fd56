"""Measured and predicted torque along a segment, with signals that an error can depend on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.prediction import torque_along
from lieid_casadi.recording.processing.process import Processed

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Series:
    """One segment of a test at M instants; all signals are filtered as in the fit.

    Attributes
    ----------
    recording : str
        Name of the recording.
    time : (M,)
        s, on the recording's own clock.
    measured, predicted : (M, n)
        N·m.
    q, dq, ddq : (M, n)
        rad, rad/s, rad/s².
    sign : (M, n)
        Direction of motion: −1, 1, or 0 at rest.
    load : (M, n)
        τ_load, rigid torque of the model, N·m.
    temperature : (M, n) or None
        °C.
    """

    recording: str
    time: Array
    measured: Array
    predicted: Array
    q: Array
    dq: Array
    ddq: Array
    sign: Array
    load: Array
    temperature: Array | None = None

    @property
    def error(self) -> Array:
        """Measured − predicted torque (M, n), N·m."""
        return self.measured - self.predicted

    @property
    def moving(self) -> NDArray[np.bool_]:
        """True where a joint moves (M, n)."""
        return np.asarray(self.sign != 0.0)


def series_along(
    fit: Fit, segment: Processed, *, added: Array | float = 0.0
) -> tuple[Series, Array]:
    """Return the series of a segment, and its error (K, n) on the grid, not filtered, N·m.

    Parameters
    ----------
    fit : Fit
    segment : Processed
        Of K instants.
    added : (K, n)
        Torque in addition to the fit's on the grid, N·m.
    """
    assert segment.tau is not None  # checked by compare
    torque = torque_along(fit.compiled, segment, fit.parameters, fit.shapes) + added
    load = fit.compiled.inverse_dynamics(segment.q, segment.dq, segment.ddq, fit.link_parameters)
    dq = segment.filter(segment.dq)
    temperature = segment.temperature
    if temperature is not None:
        temperature = segment.filter(temperature)
        if fit.temperature_mean is not None:  # temperatures of the segment are relative to it
            temperature = temperature + fit.temperature_mean
    series = Series(
        recording=segment.recording.name,
        time=segment.filtered_time,
        measured=segment.filter(segment.tau),
        predicted=segment.filter(torque),
        q=segment.filter(segment.q),
        dq=dq,
        ddq=segment.filter(segment.ddq),
        sign=np.where(segment.filtered_moving, np.sign(dq), 0.0),
        load=segment.filter(load),
        temperature=temperature,
    )
    return series, segment.tau - torque
