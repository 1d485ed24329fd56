"""Physical quantities of a payload."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from lieid_casadi.payload.body import (
    NAMES,
    identifiable_quantities,
    physical_jacobian,
    physical_quantities,
)

numbers = st.floats(-1.0, 1.0, allow_subnormal=False)
bodies = st.tuples(
    st.floats(0.1, 20.0), st.tuples(numbers, numbers, numbers), st.tuples(*[numbers] * 6)
).map(lambda parts: np.array([parts[0], *parts[1], *parts[2]]))


@given(bodies)
def test_jacobian_against_central_differences(parameters):
    step = 1e-6
    numeric = [
        (
            physical_quantities(parameters + step * unit)
            - physical_quantities(parameters - step * unit)
        )
        / (2 * step)
        for unit in np.eye(10)
    ]
    size = 1.0 + np.abs(physical_jacobian(parameters)).max()
    assert np.allclose(physical_jacobian(parameters), np.transpose(numeric), atol=1e-6 * size)


def test_a_hidden_first_moment_hides_five_quantities():
    hidden = {
        name
        for name, visible in zip(NAMES, identifiable_quantities(np.eye(10)[2:3]), strict=True)
        if not visible
    }
    assert hidden == {"com_y", "Ixx", "Ixy", "Iyz", "Izz"}
