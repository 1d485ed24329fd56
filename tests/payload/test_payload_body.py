"""Physical quantities of a payload, and the nearest physically consistent body."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lieid_casadi.payload.body import (
    NAMES,
    identifiable_quantities,
    nearest_feasible_body,
    physical_jacobian,
    physical_quantities,
)
from lieid_casadi.robot.inertia import pseudo_inertia

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


@settings(max_examples=12, deadline=None)
@given(bodies, st.integers(0, 2**32 - 1))
def test_nearest_feasible_body_is_feasible(parameters, seed):
    """For any estimate, including negative masses."""
    random = np.random.default_rng(seed)
    parameters = parameters * random.choice([-1.0, 1.0])
    root = random.standard_normal((10, 10)) * np.array([0.1, *(0.02,) * 3, *(0.005,) * 6])[:, None]
    body = nearest_feasible_body(parameters, root @ root.T, np.zeros((0, 10)))
    assert np.linalg.eigvalsh(pseudo_inertia(body))[0] > 0.0


def test_hidden_directions_are_taken_from_the_reference_ball():
    """A planar arm identifies m, mcx, mcy, Izz; the other parameters are those of a ball."""
    hidden = np.eye(10)[[3, 4, 5, 6, 7, 8]]
    body = np.array([2.0, 0.2, 0.0, 0, 0, 0, 0, 0, 0, 0.05])
    found = nearest_feasible_body(body, np.diag([1e-4, 1e-5, 1e-5, *(0.0,) * 6, 1e-6]), hidden)
    assert np.linalg.eigvalsh(pseudo_inertia(found))[0] > 0.0
    assert found[0] == pytest.approx(2.0, abs=0.02)
    assert found[9] == pytest.approx(0.05, abs=2e-3)
    assert abs(found[3]) < 0.01
