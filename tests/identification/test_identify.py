"""Identification on the simulated arm, whose dynamics and effects are implemented separately."""

import re
from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from plant.recordings import recorded
from threadpoolctl import threadpool_info, threadpool_limits

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.blas_threads import blas_on_one_thread
from lieid_casadi.effects import Coefficient, Effect, Shape
from lieid_casadi.errors import (
    AliasWarning,
    BoundWarning,
    FrictionAtRestWarning,
    IdentificationError,
    ModelError,
    RoughFitWarning,
    UnidentifiableWarning,
)
from lieid_casadi.identification import fit_warnings
from lieid_casadi.recording import Processing

ROBOT = lieid.robots.two_link()
FRICTION = plant.JointFriction(np.array([1.2, 0.5]), np.array([0.6, 0.3]), np.array([0.2, -0.1]))
CUTOFF = Processing(cutoff=8.0)


def measured(*effects, robot=ROBOT, friction=FRICTION, seed=0, duration=20.0, **sensors):
    """A recording at 200 Hz of an arm whose inertias differ from the nominal ones."""
    arm = plant.Arm(robot, plant.perturbed_inertias(robot, seed=3), friction, tuple(effects))
    ideal = plant.Sensors(rate=200.0, **sensors)
    return arm, recorded(arm, seed, seconds=duration, step=0.005, sensors=ideal)


def true_base(model, arm):
    links = arm.parameters
    friction = {"coulomb": arm.friction.coulomb, "viscous": arm.friction.viscous}
    friction["offset"] = arm.friction.offset
    effects = [friction[c.name.split(".")[0]][c.joint] for c in model.columns]
    return model.base.combination @ np.concatenate([links, effects])


@pytest.mark.parametrize("method", ["ols", "wls", "robust"])
def test_base_parameters_are_recovered(method):
    model = lieid.Model(ROBOT, "coulomb,viscous,offset")
    arm, recording = measured(torque_noise=0.05)
    fit = lieid.identify(model, recording, method=method, processing=CUTOFF)
    error = fit.values - true_base(model, arm)
    assert np.abs(error / fit.std).max() < 4.0
    # 0.05 N·m of white noise at 200 Hz through a low-pass of 8 Hz gives 0.05·√(16/200)
    np.testing.assert_allclose(fit.noise, 0.0141, rtol=0.4)
    assert np.all(fit.std > 0.0)


@pytest.mark.parametrize("method", ["wls", "robust"])
def test_a_joint_without_torque_does_not_outweigh_the_others(method):
    """As one whose torque was not recorded: it is fitted exactly."""
    _, recording = measured(torque_noise=0.05)
    lost = replace(recording, tau=recording.tau * [1.0, 0.0])
    model = lieid.Model(ROBOT, "coulomb,viscous,offset")
    fits = [lieid.identify(model, lost, method=m, processing=CUTOFF) for m in (method, "ols")]
    weighted, plain = (fit.rms_train[0] for fit in fits)
    assert weighted < 1.5 * plain


def test_the_fit_is_the_least_squares_solution_of_filtered_columns():
    """Against numpy.linalg.lstsq on columns that this test filters and stacks itself."""
    from scipy.signal import butter, sosfiltfilt

    model = lieid.Model(ROBOT, "viscous,offset")
    _, recording = measured(torque_noise=0.1)
    fit = lieid.identify(model, recording, method="ols", processing=CUTOFF)
    (segment,) = lieid.recording.process(recording, fit.processing)
    columns = lieid.compile(model).base_regressor(segment.q, segment.dq, segment.ddq)
    filter_ = butter(4, CUTOFF.cutoff, fs=segment.rate, output="sos")
    edge, step = round(0.5 * segment.rate), int(segment.rate / (4 * CUTOFF.cutoff))
    inside = slice(edge, len(segment.t) - edge, step)
    matrix = sosfiltfilt(filter_, columns, axis=0)[inside].reshape(-1, model.base.count)
    torque = sosfiltfilt(filter_, segment.tau, axis=0)[inside].reshape(-1)
    expected = np.linalg.lstsq(matrix, torque, rcond=None)[0]
    np.testing.assert_allclose(fit.values, expected, rtol=1e-6, atol=1e-8)


def test_a_shape_at_its_bound_is_reported():
    """A parabola is the limit of Stribeck curves of increasing width."""
    model = lieid.Model(ROBOT, "coulomb,viscous,offset,stribeck:1")
    _, recording = measured(plant.ViscousPolynomial(0, quadratic=-0.3), torque_noise=0.0)
    fit = lieid.identify(model, recording, processing=CUTOFF)
    (warning,) = [w for w in fit.warnings if isinstance(w, BoundWarning)]
    assert "stribeck.v_s:1 reached its bound" in str(warning)


def test_absorbed_armature_of_the_first_joint_is_reported():
    model = lieid.Model(ROBOT, "coulomb,viscous,offset,armature")
    _, recording = measured(torque_noise=0.02)
    fit = lieid.identify(model, recording, processing=CUTOFF)
    (warning,) = [
        w for w in fit.warnings if isinstance(w, AliasWarning) and "armature.I_a:1" in str(w)
    ]
    assert "Izz1" in str(warning)
    assert "armature.I_a:1" not in {p.label for p in model.base_columns}


def test_samples_at_rest_are_excluded_and_reported():
    model = lieid.Model(ROBOT, "coulomb,viscous,offset")
    arm, moving = measured(torque_noise=0.02)
    rest = np.full((1000, 2), 1.0)
    recording = lieid.Recording.from_arrays(
        np.arange(5000) * 0.005,
        np.vstack([moving.q, np.tile(moving.q[-1], (1000, 1))]),
        np.vstack([moving.dq, 0 * rest]),
        # at rest dry friction holds up to its limit: any torque
        np.vstack([moving.tau, moving.tau[-1] + 3.0 * rest]),
    )
    fit = lieid.identify(model, recording, processing=CUTOFF)
    assert np.abs((fit.values - true_base(model, arm)) / fit.std).max() < 5.0
    (warning,) = [w for w in fit.warnings if isinstance(w, FrictionAtRestWarning)]
    assert re.search(r"joint 1 \((19|20) %\)", str(warning))


def test_directions_that_are_not_excited_are_reported():
    model = lieid.Model(ROBOT, "viscous")
    arm, recording = measured()
    q, dq = recording.q.copy(), recording.dq.copy()
    q[:, 1], dq[:, 1] = 0.3, 0.0
    t = recording.t
    ddq = np.gradient(dq, t, axis=0)
    still = plant.measure_along(arm, t, q, dq, ddq, sensors=plant.Sensors(rate=200.0))
    fit = lieid.identify(model, still, processing=CUTOFF)
    names = " ".join(str(w) for w in fit.warnings if isinstance(w, UnidentifiableWarning))
    assert "viscous.f_v:2" in names
    assert np.isfinite(fit.values).all()


@pytest.mark.parametrize(
    ("duration", "method", "rough"), [(4.0, "wls", 1), (6.0, "feasible", 1), (20.0, "wls", 0)]
)
def test_recordings_that_determine_the_parameters_roughly_are_reported(duration, method, rough):
    _, recording = measured(torque_noise=0.5, duration=duration)
    effects = "coulomb,viscous,offset,load_friction,torque_ripple,viscous_polynomial"
    fit = lieid.identify(
        lieid.Model(ROBOT, effects), recording, method=method, processing=Processing(cutoff=3.0)
    )
    found = [str(w) for w in fit.warnings if isinstance(w, RoughFitWarning)]
    assert len([text for text in found if "lieid excite" in text]) == len(found) == rough


@pytest.mark.parametrize(("error", "warnings"), [(1e-9, 0), (1e-2, 1)])  # of 1 N·m
def test_an_exact_fit_is_not_rough(error, warnings):
    rows = SimpleNamespace(joints=[SimpleNamespace(torque=np.ones(10))])
    found = fit_warnings.rough(np.array([error]), np.array([2.0 * error]), rows)
    assert len(found) == warnings


def test_short_recordings_have_a_held_out_error():
    """Three seconds are less than one block of a low-pass of 3 Hz."""
    _, recording = measured(torque_noise=0.5, duration=3.0)
    model = lieid.Model(ROBOT, "coulomb,viscous,offset")
    fit = lieid.identify(model, recording, processing=Processing(cutoff=3.0))
    assert np.all(fit.rms_cv > 1.05 * fit.rms_train)


def test_a_recording_at_rest_identifies_nothing():
    model, (_, recording) = lieid.Model(ROBOT, "coulomb,viscous,offset"), measured()
    with pytest.raises(IdentificationError, match="no joint moves"):
        lieid.identify(model, replace(recording, q=0.0 * recording.q, dq=0.0 * recording.dq))


def test_condition_number_does_not_depend_on_the_choice_of_base():
    """σ₁/σ_r of the stacked full regressor, by NumPy on the full columns."""
    model = lieid.Model(ROBOT, "viscous,offset")
    _, recording = measured()
    fit = lieid.identify(model, recording, method="ols", processing=CUTOFF)
    (segment,) = lieid.recording.process(recording, fit.processing)
    arm = lieid.compile(model)
    full = np.concatenate(
        [
            arm.regressor(segment.q, segment.dq, segment.ddq),
            arm.effect_columns(segment.q, segment.dq, segment.ddq),
        ],
        axis=2,
    )
    sizes = np.linalg.svd(segment.filter(full).reshape(-1, full.shape[2]), compute_uv=False)
    rank = model.base.count
    assert fit.conditioning.condition_number == pytest.approx(sizes[0] / sizes[rank - 1], rel=1e-6)
    assert sizes[rank] < 1e-10 * sizes[0]


def test_prediction_is_finite_in_every_row_at_its_own_times():
    model = lieid.Model(ROBOT, "coulomb,viscous,offset")
    _, recording = measured(torque_noise=0.02)
    fit = lieid.identify(model, recording, processing=CUTOFF)
    t = recording.t.copy()
    t[2000:] += 4.0  # a gap
    short = np.r_[0:3, 10:2000, 2000:4000]  # and a first segment of three rows
    t[10:] += 1.0
    odd = lieid.Recording.from_arrays(t[short], recording.q[short], recording.dq[short])
    torque = fit.predict(odd)
    assert torque.shape == (len(short), 2)
    assert np.isfinite(torque).all()
    inside = slice(200, 1800)
    error = torque[inside] - recording.tau[short][inside]
    assert np.sqrt(np.mean(error**2)) < 0.2


def test_invalid_requests_are_refused():
    model = lieid.Model(ROBOT, "coulomb")
    _, recording = measured(duration=5.0)
    with pytest.raises(IdentificationError, match="unknown method 'magic'"):
        lieid.identify(model, recording, method="magic")
    with pytest.raises(IdentificationError, match=r"held_shapes has shape \(2,\); expected \(0,\)"):
        lieid.identify(model, recording, held_shapes=[0.1, 0.2])
    with pytest.raises(IdentificationError, match="no recordings"):
        lieid.identify(model, [])
    no_torque = lieid.Recording.from_arrays(recording.t, recording.q, recording.dq)
    with pytest.raises(ModelError, match="no torque"):
        lieid.identify(model, no_torque)
    with pytest.raises(ModelError, match="2 joints; robot 'panda' has 7"):
        lieid.identify(lieid.Model(lieid.robots.panda()), recording)


@pytest.mark.parametrize("shapes", [(), (Shape("k", "1", lower=0.1, upper=10.0, initial=1.0),)])
def test_an_effect_that_is_not_finite_is_refused(shapes):
    class Root(Effect):
        name = "root"
        formula = "f·√q̇"
        coefficients = (Coefficient("f", "N·m"),)
        signals = ("dq",)

        def columns(self, s, shape):
            return [ca.sqrt(s.dq) * shape.get("k", 1.0)]

    Root.shapes = shapes
    bare = replace(ROBOT, joints=tuple(replace(j, link=None) for j in ROBOT.joints), source=None)
    model = lieid.Model(bare, [Root()])
    with pytest.raises(IdentificationError, match="joint 1: a column of the regression is not"):
        lieid.identify(model, measured(duration=5.0)[1], processing=CUTOFF)


def test_linear_algebra_is_on_one_thread_and_the_setting_is_restored():
    def threads():
        return [x["num_threads"] for x in threadpool_info() if x["user_api"] == "blas"]

    with threadpool_limits(2, user_api="blas"):
        before = threads()
        assert 2 in before
        assert set(blas_on_one_thread(threads)()) == {1}
        assert threads() == before
