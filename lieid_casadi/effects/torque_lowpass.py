"""A torque signal that passed a low-pass filter before it was recorded."""

from functools import partial

import numpy as np
from scipy.signal import lfilter

from lieid_casadi.effects.arm_effect import ArmEffect, Array, SegmentModel, on_joint
from lieid_casadi.effects.effect import Coefficient
from lieid_casadi.effects.registry import register
from lieid_casadi.effects.torque_delay import change_where_known

EQUAL = 1e-9  # of a step, by which instants differ because of rounding
LEAST = 1e-3  # s; below it the column is the derivative, not the difference quotient


@register
class TorqueLowpass(ArmEffect):
    """The torque is recorded through a low-pass filter: τ_measured = F_T(τ), T in s.

    F_T is of first order, T·ẏ + y = τ with cut-off 1/(2πT) in Hz, and in balance at the start of
    every segment. Confused with `torque_delay`: to first order in T·d/dt both delay by T; only the
    filter also attenuates. Exported code computes the torque at the instant, without the filter.
    """

    name = "torque_lowpass"
    finding = ("The measured torque of {joints} is low-pass filtered",)
    formula = "T·d(τ_measured)/dt + τ_measured = τ"
    coefficients = (
        Coefficient("T", "s", lower=0.0, limit=0.2, meaning="time constant, 1/(2π·cut-off)"),
    )
    options = {
        "second_order": "a critically damped filter of second order, delay 2·T",
        "common": "one time constant for all joints: the controller's filter",
        "common_second_order": "of second order, one time constant for all joints",
    }
    needs_past = True
    on_torque_signal = True
    like_uncertain_friction = ("late",)
    export_note = "omitted: the torque is that of the instant, without the filter of its signal"
    trial_values = ((0.003,), (0.01,), (0.02,), (0.04,), (0.08,))
    revealed_by = "torque that changes quickly: high accelerations, reversals, rates above 100 Hz"
    confused_with = {
        "torque_delay": "only a filter attenuates; record accelerations up to its cut-off",
        "viscous": "a filtered inertia torque resembles damping; vary the frequency",
        "armature": "a filtered damping torque resembles inertia; vary the frequency",
    }
    typical = "cut-offs of 5 to 100 Hz, the same for all joints of a controller"

    def __init__(self, *, option: str = "") -> None:
        super().__init__(option=option)
        self.whole_arm = option.startswith("common")
        self.reach = "arm" if self.whole_arm else "joint"
        self._order = 2 if option.endswith("second_order") else 1
        if self._order == 2:
            self.formula = "(1 + T·d/dt)²·τ_measured = τ"

    def segment_columns(self, arm: SegmentModel, joint: int, values: Array) -> Array:
        if not self.whole_arm:
            change = self._change(arm, slice(joint, joint + 1), float(values[0]))
            return on_joint(change[:, 0], joint, arm.torque.shape[1])
        return self._change(arm, slice(None), float(values[0]))[:, :, None]

    def _change(self, arm: SegmentModel, joints: slice, time_constant: float) -> Array:
        """Return (F_T(τ) − τ)/T of some joints, zero where it depends on unknown friction.

        Its memory counts as its mean delay, so that it is compared with a delay on the same rows.
        """
        change = partial(self._filtered_change, arm.t, time_constant=time_constant)
        return change_where_known(arm, joints, self._order * time_constant, change)

    def _filtered_change(self, t: Array, torque: Array, time_constant: float) -> Array:
        """Return (F_T(τ) − τ)/T, and its limit for small T."""
        if time_constant < LEAST:
            return np.asarray(-self._order * np.gradient(torque, t, axis=0))
        filtered = torque
        for _ in range(self._order):
            filtered = first_order_lag(t, filtered, time_constant)
        return (filtered - torque) / time_constant


def first_order_lag(t: Array, x: Array, time_constant: float) -> Array:
    """Return y with T·ẏ + y = x, exact for an x that is linear between equidistant samples.

    A signal x (K, n) with other steps is interpolated onto K equidistant instants and back; y
    starts at the first x.
    """
    even = np.linspace(t[0], t[-1], len(t))
    step = (t[-1] - t[0]) / (len(t) - 1) / time_constant
    keep, mean = float(np.exp(-step)), float(-np.expm1(-step) / step)
    equal = np.allclose(t, even, rtol=0.0, atol=EQUAL * (even[1] - even[0]))
    given = x if equal else np.column_stack([np.interp(even, t, column) for column in x.T])
    state = mean * given[:1]
    y, _ = lfilter([1.0 - mean, mean - keep], [1.0, -keep], given, axis=0, zi=state)
    return y if equal else np.column_stack([np.interp(t, even, column) for column in y.T])
