"""What Python shows of an object on one line: what it is, and its size or result."""

import numpy as np
import pytest

import lieid_casadi as lieid

ROBOT = lieid.robots.two_link()


@pytest.fixture(scope="module")
def run():
    """Return motion of both joints with viscous friction of 0.5 N·m·s/rad, and noise of 0.1 N·m."""
    t = np.arange(0.0, 10.0, 0.01)
    angle = np.outer(t, [1.0, 2.0])
    q, dq, ddq = np.sin(angle), [1, 2] * np.cos(angle), [-1, -4] * np.sin(angle)
    rigid = lieid.compile(ROBOT).inverse_dynamics(q, dq, ddq, ROBOT.link_parameters)
    noise = 0.1 * np.random.default_rng(0).standard_normal(q.shape)
    return lieid.Recording.from_arrays(t, q, dq, rigid + 0.5 * dq + noise, name="run")


@pytest.fixture(scope="module")
def fit(run):
    return lieid.identify(lieid.Model(ROBOT, "viscous"), run)


def test_data(run, fit):
    assert repr(ROBOT) == "<Robot two_link: 2 joints>"
    assert repr(run) == "<Recording run: 2 joints, 1000 rows, q, dq, tau>"
    assert repr(fit).startswith("<Fit of two_link: viscous; ")


def test_results(run, fit):
    """Results hold arrays of all samples, which a line leaves out."""
    text = repr(lieid.compare(fit, run))
    assert text.startswith("<Comparison")
    assert "array" not in text
    assert "\n" not in text
