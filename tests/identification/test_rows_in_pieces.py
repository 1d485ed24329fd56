"""Triangular factors of rows in pieces against the whole; columns shared by several models."""

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.compiled import kernels
from lieid_casadi.compiled.triangular_factors import Triangle
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.recording import Processing, process


def without_compiler(monkeypatch):
    monkeypatch.setattr(kernels.CompilerFailure, "reason", "reported before")


@pytest.mark.parametrize("compiled", [True, False])
def test_triangle_of_pieces_and_weights(compiled, monkeypatch):
    if not compiled:
        without_compiler(monkeypatch)
    rng = np.random.default_rng(0)
    matrix, torque, weights = rng.normal(size=(1300, 20)), rng.normal(size=1300), rng.random(1300)
    matrix[:, 7] = 0.0
    triangle = Triangle(21)
    for first, last in [(0, 3), (3, 3), (3, 600), (600, 1300)]:
        rows = slice(first, last)
        triangle.add(matrix[rows], torque[rows], weights=weights[rows])
    whole = np.column_stack([matrix, torque]) * weights[:, None]
    np.testing.assert_allclose(triangle.r.T @ triangle.r, whole.T @ whole, atol=1e-10)
    np.testing.assert_array_equal(np.tril(triangle.r, -1), 0.0)


def recorded(duration, seed):
    robot = lieid.robots.two_link()
    friction = plant.JointFriction(np.array([1.2, 0.5]), np.array([0.6, 0.3]), np.array([0.2, 0.1]))
    arm = plant.Arm(robot, plant.perturbed_inertias(robot, seed=3), friction)
    motion = plant.FourierTrajectory(robot, base_frequency=0.1, seed=seed)
    t = np.arange(0.0, duration, 0.01)
    return plant.measure_along(arm, t, *motion.at(t), sensors=plant.Sensors(rate=100.0))


def test_designs_of_several_models_share_their_filtered_columns():
    robot = lieid.robots.two_link()
    segments = process([recorded(3.0, 1), recorded(2.0, 2)], Processing(cutoff=2.0))
    known = [{} for _ in segments]
    models = [
        lieid.Model(robot, spec)
        for spec in ("viscous", "coulomb:2,transmission_coupling:1<2,viscous", "stribeck,viscous")
    ]
    for model in models:
        arm, shapes = lieid.compile(model), model.initial_shapes
        own = Design(arm, segments).rows(shapes, None)
        shared = Design(arm, segments, known=known).rows(shapes, None)
        for one, other in zip(own.joints, shared.joints, strict=True):
            np.testing.assert_array_equal(one.columns, other.columns)
            np.testing.assert_array_equal(one.matrix, other.matrix)
    marked = [{key: np.full_like(values, 7.0) for key, values in store.items()} for store in known]
    reused = Design(lieid.compile(models[0]), segments, known=marked).rows(np.zeros(0), None)
    assert all(np.all(joint.matrix == 7.0) for joint in reused.joints)
