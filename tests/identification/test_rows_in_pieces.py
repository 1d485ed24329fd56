"""Triangular factors of rows in pieces, and designs in chunks, against the whole."""

from dataclasses import replace

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.compiled import kernels, triangular_factors
from lieid_casadi.compiled.triangular_factors import Triangle
from lieid_casadi.identification.regression import design_matrix
from lieid_casadi.identification.regression.design_matrix import Design, MotionColumns
from lieid_casadi.identification.regression.least_squares import joint_factors
from lieid_casadi.recording import Processing, filtering, process
from lieid_casadi.recording.filtering import filter_memory, windows


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


def test_triangular_is_at_most_square():
    assert triangular_factors.triangular(np.ones((3, 2))).shape == (2, 2)
    assert triangular_factors.triangular(np.zeros((0, 2))).shape == (0, 2)


def test_rows_in_chunks_are_the_same(monkeypatch):
    """A design without kept columns, on several segments of several windows each."""
    model = lieid.Model(lieid.robots.two_link(), "coulomb,viscous,offset,stribeck:1")
    arm = lieid.compile(model)
    segments = process([recorded(30.0, 1), recorded(3.0, 2)], Processing(cutoff=2.0))
    segments = tuple(replace(s, options=replace(s.options, trim=0.25)) for s in segments)
    for segment in segments:
        margin = filter_memory(segment.rate, segment.cutoff)
        pieces = windows(len(segment), segment.kept, margin, 300)
        segment.__dict__["windows"] = tuple(pieces)
    assert len(segments[0].windows) > 3
    whole = Design(arm, segments).rows(model.initial_shapes, None)
    parts = Design(arm, segments, held=0).rows(model.initial_shapes, None)
    assert len(list(parts.chunks())) == 1  # of 32 MB
    monkeypatch.setattr(design_matrix, "CHUNK_BYTES", 4000)
    parts = Design(arm, segments, held=0).rows(model.initial_shapes, None)
    assert len(list(parts.chunks())) > 3
    np.testing.assert_array_equal(parts.lengths, whole.lengths)
    for one, other in zip(joint_factors(parts), joint_factors(whole), strict=True):
        np.testing.assert_allclose(np.abs(one.r), np.abs(other.r), rtol=1e-9, atol=1e-9)
    values = np.random.default_rng(0).normal(size=model.base.count)
    for one, other in zip(parts.residuals(values), whole.residuals(values), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)
    for one, other in zip(parts.joints, whole.joints, strict=True):
        np.testing.assert_array_equal(one.instant, other.instant)
        np.testing.assert_array_equal(one.columns, other.columns)
        np.testing.assert_allclose(one.matrix, other.matrix, atol=1e-12)


def recorded(duration, seed):
    robot = lieid.robots.two_link()
    friction = plant.JointFriction(np.array([1.2, 0.5]), np.array([0.6, 0.3]), np.array([0.2, 0.1]))
    arm = plant.Arm(robot, plant.perturbed_inertias(robot, seed=3), friction)
    motion = plant.FourierTrajectory(robot, base_frequency=0.1, seed=seed)
    t = np.arange(0.0, duration, 0.01)
    return plant.measure_along(arm, t, *motion.at(t), sensors=plant.Sensors(rate=100.0))


def test_designs_of_several_models_share_their_filtered_columns(monkeypatch):
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
    monkeypatch.setattr(MotionColumns, "_evaluated", None)  # all columns are known
    Design(lieid.compile(models[0]), segments, known=known)


def test_long_recordings_give_nearly_the_same_fit(monkeypatch):
    """In chunks only the folds of cross-validation and the covariance differ slightly."""
    model = lieid.Model(lieid.robots.two_link(), "coulomb,viscous,offset")
    recording, options = recorded(120.0, 1), Processing(cutoff=4.0)
    noise = np.random.default_rng(0).normal(size=recording.tau.shape)
    recording = replace(recording, tau=recording.tau + 0.1 * noise)
    whole = lieid.identify(model, recording, processing=options)
    monkeypatch.setattr(design_matrix, "HELD_BYTES", 0)
    monkeypatch.setattr(design_matrix, "CHUNK_BYTES", 200_000)
    monkeypatch.setattr(filtering, "WINDOW", 1000)
    parts = lieid.identify(model, recording, processing=options)
    np.testing.assert_allclose(parts.values, whole.values, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(parts.rms_train, whole.rms_train, rtol=1e-9)
    np.testing.assert_allclose(parts.rms_train_raw, whole.rms_train_raw, rtol=1e-9)
    np.testing.assert_allclose(parts.rms_cv, whole.rms_cv, rtol=0.05)
    np.testing.assert_allclose(parts.std, whole.std, rtol=0.4)
