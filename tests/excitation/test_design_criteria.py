"""Criteria and scalings of a design."""

import numpy as np

import lieid_casadi as lieid
from lieid_casadi.excitation import (
    excite,
)

PANDA = lieid.robots.panda()


def test_combined_criterion_improves_log_det():
    """C1's bound on −log det: never much worse than C3's, better than C2's."""
    options = {
        "limits": (), "acceleration": 5.0, "free_start": True, "starts": 1, "margin": 1.0,
    }  # fmt: skip
    model = lieid.Model(PANDA)
    names = "combined", "condition", "hadamard"
    c1, c2, c3 = (excite(model, criterion=name, **options) for name in names)
    assert c1.neg_log_det < c2.neg_log_det
    assert c1.condition_number < 2.0 * c2.condition_number < c3.condition_number


def test_thresholds_of_the_combined_criterion_end_the_search():
    """Eq. 20 as printed: below Δ₁ with −log det at most Δ₂, verified, in fewer iterations."""
    options = {"duration": 6.0, "starts": 1, "criterion": "combined", "limits": ()}
    model = lieid.Model(lieid.robots.two_link())
    full = excite(model, **options)
    threshold = 1.3 * full.condition_number
    bound = full.neg_log_det + 0.5
    early = excite(model, condition_threshold=threshold, neg_log_det_threshold=bound, **options)
    assert full.condition_number < early.condition_number <= threshold
    assert early.neg_log_det <= bound
    assert early.max_violation == 0.0
    assert len(early.history) < len(full.history)


def test_unit_norm_scaling_is_named_and_used():
    model = lieid.Model(lieid.robots.two_link(), effects="coulomb,viscous")
    options = {"duration": 6.0, "starts": 1, "criterion": "condition", "limits": ()}
    scaled = excite(model, scaling="unit_norm", **options)
    plain = excite(model, **options)
    assert scaled.to_dict()["scaling"] == "unit_norm"
    motion = scaled.trajectory.at(0.06 * np.arange(100))
    base = lieid.compile(model).base_regressor(motion.q, motion.dq, motion.ddq).reshape(200, -1)
    assert np.isclose(scaled.condition_number, np.linalg.cond(base / np.linalg.norm(base, axis=0)))
    assert scaled.condition_number < plain.condition_number


def test_prior_scaling_is_named_and_used():
    model = lieid.Model(lieid.robots.two_link())
    options = {
        "duration": 6.0, "starts": 1, "criterion": "condition", "max_iterations": 60,
        "limits": (),
    }  # fmt: skip
    plain, prior = excite(model, **options), excite(model, scaling="prior", **options)
    assert prior.to_dict()["scaling"] == "prior"
    assert prior.condition_number != plain.condition_number
