"""Texts of a comparison: verdict, table, notebook."""

import numpy as np
import pytest
from comparison import two_link_data as arm

import lieid_casadi as lieid
from lieid_casadi.comparison.comparison import verdict


@pytest.fixture(scope="module")
def fit():
    return arm.fit()


def test_a_systematic_error_is_stated_with_its_joint(fit):
    correct = verdict(lieid.compare(fit, arm.recording(10.0, seed=2, noise=0.4, name="run 2")))
    assert correct.startswith("run 2 (8.96 s): the error in motion is ")
    assert "no systematic error is detectable" in correct
    _, q, _, _ = arm.motion(10.0, seed=2)
    extra = np.column_stack([np.zeros(len(q)), 3.0 * q[:, 1]])
    wrong = verdict(lieid.compare(fit, arm.recording(10.0, seed=2, noise=0.2, extra=extra)))
    assert "On joint 2 the error in motion is " in wrong
    assert " times the noise floor: part of it is systematic" in wrong


def test_verdict_without_any_torque():
    t = np.arange(0.0, 12.0, 0.005)
    q = np.column_stack([np.sin(t), np.cos(2 * t)])
    none = lieid.Recording.from_arrays(t, q, None, np.zeros((len(t), 2)))
    comparison = lieid.compare(arm.fit(), none)
    assert "the measured torque is zero" in verdict(comparison)
    assert "noise floor" not in verdict(comparison)
    assert comparison.to_dict()["relative_rms"] == [None, None]
    assert comparison.to_dict()["correlation"] == [None, None]
