"""Triangular factors of blocks against a QR of all rows, also of ill-conditioned ones."""

from dataclasses import replace

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.compiled import kernels, triangular_factors
from lieid_casadi.compiled.triangular_factors import Triangle
from lieid_casadi.errors import IdentificationError, ModelError
from lieid_casadi.identification.regression import design_matrix
from lieid_casadi.identification.regression.array_factors import factors
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.identification.regression.least_squares import combine, joint_factors, solve
from lieid_casadi.identification.regression.motion_columns import MotionColumns
from lieid_casadi.recording import Processing, filtering, process
from lieid_casadi.recording.filtering import filter_memory, windows

FRICTION = "coulomb,viscous,offset,viscous_polynomial"


@pytest.fixture(scope="module")
def panda():
    return lieid.compile(lieid.Model(lieid.robots.panda(), FRICTION))


def motion(n, samples, *, size=1.0, seed=0):
    rng = np.random.default_rng(seed)
    middle = rng.normal(size=n)
    q, dq, ddq = size * rng.normal(size=(3, samples, n))
    return q + middle, dq, ddq


def stacked(arm, q, dq, ddq, tau):
    """[Y_b | τ] of all joints, one below another."""
    matrix = arm.base_regressor(q, dq, ddq)
    return np.concatenate([matrix, tau[:, :, None]], axis=2).reshape(-1, matrix.shape[2] + 1)


def without_compiler(monkeypatch):
    monkeypatch.setattr(kernels.CompilerFailure, "reason", "reported before")


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("samples", [5, 383, 384, 9001])
def test_factor_has_the_gram_matrix_of_the_whole_stack(panda, samples, threads):
    q, dq, ddq = motion(7, samples)
    tau = np.random.default_rng(1).normal(size=(samples, 7))
    whole = stacked(panda, q, dq, ddq, tau)
    r = combine(factors(panda, q, dq, ddq, tau, threads=threads), np.ones(7)).r
    scale = np.linalg.norm(whole, axis=0) + 1e-300
    error = (r / scale).T @ (r / scale) - (whole / scale).T @ (whole / scale)
    assert np.abs(error).max() < 1e-12


def test_each_joint_has_its_own_rows(panda):
    q, dq, ddq = motion(7, 1000)
    tau = np.random.default_rng(1).normal(size=(1000, 7))
    values = np.random.default_rng(2).normal(size=panda.model.base.count)
    error = panda.base_regressor(q, dq, ddq) @ values - tau
    found = [factor.misfit(values) for factor in factors(panda, q, dq, ddq, tau)]
    np.testing.assert_allclose(found, np.sum(error**2, axis=0), rtol=1e-12)


def relative_errors(arm, q, dq, ddq):
    """Errors of β of an exact τ = Y_b·β: by blocks, by one QR, by the Gram matrix."""
    truth = np.random.default_rng(3).uniform(0.5, 2.0, arm.model.base.count)
    matrix = arm.base_regressor(q, dq, ddq)
    tau = matrix @ truth
    whole = stacked(arm, q, dq, ddq, tau)
    scale = np.linalg.norm(whole[:, :-1], axis=0)
    by_blocks = solve(combine(factors(arm, q, dq, ddq, tau), np.ones(arm.n))).values
    basis, r = np.linalg.qr(whole[:, :-1] / scale)
    by_qr = np.linalg.solve(r, basis.T @ whole[:, -1]) / scale
    gram = (whole / np.append(scale, 1.0)).T @ (whole / np.append(scale, 1.0))
    by_gram = np.linalg.solve(gram[:-1, :-1], gram[:-1, -1]) / scale
    sizes = np.linalg.svd(r, compute_uv=False)
    norm = np.linalg.norm(truth)
    return sizes[0] / sizes[-1], *(
        np.linalg.norm(values - truth) / norm for values in (by_blocks, by_qr, by_gram)
    )


def test_small_singular_values_are_accurate(panda):
    """A motion of a few thousandths of a radian: the columns are nearly dependent."""
    condition, blocks, whole, gram = relative_errors(panda, *motion(7, 6000, size=0.003))
    assert condition > 1e5
    assert blocks < 20.0 * whole
    assert blocks < 1e-6
    assert gram > 1e3 * blocks


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


def test_without_a_compiler_the_factors_are_the_same(monkeypatch):
    arm = lieid.compile(lieid.Model(lieid.robots.two_link(), FRICTION))
    q, dq, ddq = motion(2, 700)
    tau = np.random.default_rng(1).normal(size=(700, 2))
    expected = [np.abs(f.r) for f in factors(arm, q, dq, ddq, tau)]
    without_compiler(monkeypatch)
    machine = lieid.compile(arm.model)
    for factor, r in zip(factors(machine, q, dq, ddq, tau), expected, strict=True):
        np.testing.assert_allclose(np.abs(factor.r), r, rtol=1e-9, atol=1e-9)


def test_strided_torque(panda):
    q, dq, ddq = motion(7, 500)
    wide = np.random.default_rng(1).normal(size=(500, 14))
    expected = factors(panda, q, dq, ddq, np.ascontiguousarray(wide[:, ::2]))
    for one, other in zip(factors(panda, q, dq, ddq, wide[:, ::2]), expected, strict=True):
        np.testing.assert_array_equal(one.r, other.r)


def test_a_sample_that_is_not_finite_is_named(panda):
    q, dq, ddq = motion(7, 2000)
    tau = np.zeros((2000, 7))
    tau[1234, 2] = np.nan
    with pytest.raises(IdentificationError, match="tau: sample 1234, joint 3 is nan"):
        factors(panda, q, dq, ddq, tau)


def test_torques_of_another_shape_are_refused(panda):
    q, dq, ddq = motion(7, 20)
    with pytest.raises(ModelError, match="tau"):
        factors(panda, q, dq, ddq, np.zeros((19, 7)))


def test_no_samples(panda):
    none = np.zeros((0, 7))
    assert all(not f.r.any() and f.rows == 0 for f in factors(panda, none, none, none, none))


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
