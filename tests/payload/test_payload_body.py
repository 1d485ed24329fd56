"""From ten parameters to mass, centre and inertia; the nearest body that can exist."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lieid_casadi.payload.body import NAMES, physical, physical_slopes, told
from lieid_casadi.payload.feasible_body import possible_body
from lieid_casadi.robot.inertia import link_parameters, pseudo_inertia

numbers = st.floats(-1.0, 1.0, allow_subnormal=False)
bodies = st.tuples(
    st.floats(0.1, 20.0), st.tuples(numbers, numbers, numbers), st.tuples(*[numbers] * 6)
).map(lambda parts: np.array([parts[0], *parts[1], *parts[2]]))


@given(bodies)
def test_slopes_against_central_differences(parameters):
    step = 1e-6
    numeric = [
        (physical(parameters + step * unit) - physical(parameters - step * unit)) / (2 * step)
        for unit in np.eye(10)
    ]
    size = 1.0 + np.abs(physical_slopes(parameters)).max()
    assert np.allclose(physical_slopes(parameters), np.transpose(numeric), atol=1e-6 * size)


@given(bodies)
def test_quantities_depend_on_what_is_said(parameters):
    """A hidden direction along one parameter takes exactly the quantities that move with it."""
    slopes = np.abs(physical_slopes(parameters)) > 1e-9
    for k, unit in enumerate(np.eye(10)):
        # what moves is lost; a moment of zero moves nothing, and is lost all the same
        assert not np.any(slopes[:, k] & told(unit[None]))
    assert told(np.zeros((0, 10))).all()


def test_nothing_but_an_unseen_moment_is_lost():
    lost = {name for name, seen in zip(NAMES, told(np.eye(10)[2:3]), strict=True) if not seen}
    assert lost == {"com_y", "Ixx", "Ixy", "Iyz", "Izz"}


@settings(max_examples=12, deadline=None)
@given(bodies, st.integers(0, 2**32 - 1))
def test_possible_body_is_possible(parameters, seed):
    """Whatever was estimated, negative masses included."""
    random = np.random.default_rng(seed)
    parameters = parameters * random.choice([-1.0, 1.0])
    root = random.standard_normal((10, 10)) * np.array([0.1, *(0.02,) * 3, *(0.005,) * 6])[:, None]
    body = possible_body(parameters, root @ root.T, np.zeros((0, 10)))
    assert np.linalg.eigvalsh(pseudo_inertia(body))[0] > 0.0


def test_a_body_that_is_possible_and_well_known_stays():
    body = link_parameters(2.0, [0.1, 0.0, 0.05], np.diag([0.02, 0.03, 0.025]))
    std = np.array([1e-3, *(1e-4,) * 3, *(1e-4,) * 6])
    found = possible_body(body, np.diag(std**2), np.zeros((0, 10)))
    assert np.all(np.abs(found - body) < 0.2 * std)


def test_what_the_data_does_not_show_comes_from_a_ball():
    """A planar arm shows m, mcx, mcy, Izz; the others are finite and of the ball's size."""
    hidden = np.eye(10)[[3, 4, 5, 6, 7, 8]]
    body = np.array([2.0, 0.2, 0.0, 0, 0, 0, 0, 0, 0, 0.05])
    found = possible_body(body, np.diag([1e-4, 1e-5, 1e-5, *(0.0,) * 6, 1e-6]), hidden)
    assert np.linalg.eigvalsh(pseudo_inertia(found))[0] > 0.0
    assert found[0] == pytest.approx(2.0, abs=0.02)
    assert found[9] == pytest.approx(0.05, abs=2e-3)
    assert abs(found[3]) < 0.01
