"""Triangular factors of rows in pieces against the whole; columns shared by several models."""

import numpy as np

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.recording import Processing, process


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
