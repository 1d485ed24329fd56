"""`lieid.symbolic` of fits with every effect of the library, against `Fit.predict`."""

import dataclasses
import pickle

import casadi as ca
import numpy as np
import pytest
from exporters.c_arms import made_fit
from robot.random_arms import random_arm

import lieid_casadi as lieid
from lieid_casadi.effects import LIBRARY, ArmEffect, make
from lieid_casadi.errors import ModelError
from lieid_casadi.expressions.symbolic import symbolic
from lieid_casadi.robot.inertia import pose

PANDA = dataclasses.replace(
    lieid.robots.panda().with_drives(lieid.Drive(stiffness=500.0)),
    tool=pose((0.05, 0.02, 0.12), (0.1, -0.2, 0.3)),
)
SHORT = dataclasses.replace(PANDA, joints=PANDA.joints[:3])
SAMPLES = 4  # a recording too short to be filtered: predicted as it was measured
NAMES = [
    f"{kind.name}/{option}" if option else kind.name
    for kind in LIBRARY
    for option in ("", *kind.options)
]
NEED_PAST = [name for name in NAMES if getattr(make(name), "needs_past", False)]
AT_ONE_INSTANT = [name for name in NAMES if name not in NEED_PAST]
COMBINED = (
    "coulomb,viscous,offset,armature,stribeck:4,load_friction:2+3,load_friction/paper:1,"
    "load_friction/motoring:5,temperature_friction:1,warm_up:7,position_friction:4,"
    "transmission_coupling:5<6,base_tilt,payload,external_wrench"
)


def fit_with(name):
    effect = make(name)
    return made_fit(SHORT, [f"{name}:2<3" if effect.couples else effect])


def recording(n, seed=3):
    random = np.random.default_rng(seed)
    q, dq, ddq, tau = random.uniform(-1.5, 1.5, (4, SAMPLES, n))
    temperature = random.uniform(20.0, 50.0, (SAMPLES, n))
    t = 0.01 * np.arange(SAMPLES)
    return lieid.Recording.from_arrays(
        t, q, dq, tau, ddq=ddq, temperature=temperature, command=q
    )  # no error of position: the torque is then that which the drives deliver


def moments(fit, run):
    """Inputs of a function at each sample of a recording, by name."""
    for k in range(SAMPLES if not fit.model.states else 1):  # states are initial ones at first
        inputs = {name: getattr(run, name)[k] for name in ("q", "dq", "ddq", "temperature")}
        yield k, inputs | {"states": fit.model.initial_states, "time": run.t[k] - run.t[0]}


def call(function, inputs):
    """Call a function with those of the inputs that it has; return its first output."""
    given = {name: inputs[name] for name in function.name_in()}
    return function(**given)[function.name_out(0)].full()


@pytest.mark.parametrize("name", AT_ONE_INSTANT)
def test_the_measured_torque_is_that_of_predict(name):
    fit, run = fit_with(name), recording(3)
    function = symbolic(fit, as_measured=True).inverse_dynamics
    expected = fit.predict(run)
    for k, inputs in moments(fit, run):
        scale = np.abs(expected[k]).max()
        np.testing.assert_allclose(
            call(function, inputs)[:, 0], expected[k], rtol=0, atol=1e-10 * scale
        )


MEASUREMENT = [
    name for name in NAMES if isinstance(make(name), ArmEffect) and make(name).on_measurement
]


@pytest.mark.parametrize("name", MEASUREMENT)
def test_the_drives_torque_excludes_effects_of_the_measurement(name):
    fit, run = fit_with(name), recording(3)
    function, expected = symbolic(fit).inverse_dynamics, made_fit(SHORT, "").predict(run)
    for k, inputs in moments(fit, run):
        scale = np.abs(expected[k]).max()
        np.testing.assert_allclose(
            call(function, inputs)[:, 0], expected[k], rtol=0, atol=1e-10 * scale
        )


@pytest.mark.parametrize("name", NEED_PAST)
def test_effects_that_need_the_past_are_refused_as_measured(name):
    with pytest.raises(ModelError, match=f"{name}:.*as_measured=False"):
        symbolic(fit_with(name), as_measured=True)


@pytest.fixture(scope="module", params=["panda", "random"])
def combined(request):
    """A fit with friction of every kind and effects on the whole arm."""
    if request.param == "panda":
        return made_fit(PANDA, COMBINED)
    arm = random_arm(np.random.default_rng(8), 5)
    fit = made_fit(arm, "coulomb,viscous,armature,load_friction/square:2,payload,base_tilt")
    parameters = fit.parameters.copy()
    square = [column.name.endswith("f_tau_square") for column in fit.model.columns]
    parameters[10 * arm.n :][square] = 2e-4  # friction changes by less than the load does
    return dataclasses.replace(fit, parameters=parameters)


def test_parts_add_up_to_the_torque(combined):
    arm, run = symbolic(combined, smooth_velocity=0.05), recording(combined.model.n)
    links_alone = symbolic(made_fit(combined.model.robot, ""))
    for _, inputs in moments(combined, run):
        load = call(links_alone.inverse_dynamics, inputs)
        parts = call(arm.mass_matrix, inputs) @ inputs["ddq"][:, None]
        parts += call(arm.coriolis, inputs) @ inputs["dq"][:, None] + call(arm.gravity, inputs)
        parts += call(arm.friction, inputs | {"load": load})
        torque = call(arm.inverse_dynamics, inputs)
        np.testing.assert_allclose(parts, torque, rtol=0, atol=1e-11 * np.abs(torque).max())


def test_forward_dynamics_solve_the_inverse_ones(combined):
    """Load friction makes the equation nonlinear; its residual is below 1e-9."""
    arm = symbolic(combined, smooth_velocity=0.05)
    random = np.random.default_rng(5)
    for _ in range(50):
        q, dq, ddq = random.uniform(-1.5, 1.5, (3, combined.model.n))
        temperature = random.uniform(20.0, 50.0, combined.model.n)
        inputs = {"q": q, "dq": dq, "ddq": ddq, "temperature": temperature, "time": 3.0}
        tau = call(arm.inverse_dynamics, inputs)
        found = call(arm.forward_dynamics, inputs | {"tau": tau})
        residual = call(arm.inverse_dynamics, inputs | {"ddq": found}) - tau
        assert np.abs(residual).max() < 1e-9


def test_derivatives_of_forward_dynamics_are_finite_differences(combined):
    arm = symbolic(combined, smooth_velocity=0.05)
    random = np.random.default_rng(6)
    q, dq, ddq = random.uniform(0.2, 1.5, (3, combined.model.n))
    inputs = {"q": q, "dq": dq, "ddq": ddq, "temperature": 40.0 + q, "time": 2.0}
    inputs["tau"] = call(arm.inverse_dynamics, inputs)[:, 0]
    names = [name for name in arm.forward_dynamics_derivatives.name_in() if name in inputs]
    blocks = arm.forward_dynamics_derivatives(**{name: inputs[name] for name in names})
    for block, name in (("ddq_q", "q"), ("ddq_dq", "dq"), ("ddq_tau", "tau")):
        slopes = []
        for j in range(combined.model.n):
            step = np.zeros(combined.model.n)
            step[j] = 1e-5
            ahead, behind = (
                call(arm.forward_dynamics, inputs | {name: inputs[name] + sign * step})
                for sign in (1, -1)
            )
            slopes.append((ahead - behind)[:, 0] / 2e-5)
        expected = np.column_stack(slopes)
        np.testing.assert_allclose(
            blocks[block].full(), expected, rtol=0, atol=1e-5 * np.abs(expected).max()
        )


def test_derivatives_are_finite_at_rest_with_a_smooth_velocity(combined):
    arm = symbolic(combined, smooth_velocity=0.01)
    function = arm.inverse_dynamics
    symbols = [function.sx_in(name) for name in function.name_in()]
    torque = function(*symbols)
    motion = ca.vertcat(*symbols[:2])
    hessian, gradient = ca.hessian(ca.sum1(torque), motion)
    evaluate = ca.Function("derivatives", symbols, [hessian, gradient])
    at_rest = [np.zeros(symbol.shape) for symbol in symbols]
    assert all(np.isfinite(value.full()).all() for value in evaluate(*at_rest))


def test_parameters_of_a_model_are_inputs(combined):
    """The same numbers give the same torque, whether they are folded in or passed."""
    fixed, free = symbolic(combined), symbolic(combined.model)
    run = recording(combined.model.n)
    values = {
        "parameters": combined.link_parameters,
        "effects": combined.effect_coefficients,
        "shapes": combined.shapes,
    }
    for _, inputs in moments(combined, run):
        expected = call(fixed.inverse_dynamics, inputs)
        if combined.temperature_mean is not None:
            values["temperature"] = inputs["temperature"] - combined.temperature_mean
        found = call(free.inverse_dynamics, inputs | values)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * np.abs(expected).max())
    general = symbolic(lieid.Model(PANDA, "coulomb"))
    assert general.inverse_dynamics.name_in() == ["q", "dq", "ddq", "parameters", "effects"]
    assert general.mass_matrix.name_in() == ["q", "parameters", "effects"]


def test_base_regressor_times_base_parameters_is_the_torque(combined):
    arm, run = symbolic(combined), recording(combined.model.n)
    links_alone = symbolic(made_fit(combined.model.robot, ""))
    beta = combined.model.base.combination @ combined.parameters
    for _, inputs in moments(combined, run):
        load = call(links_alone.inverse_dynamics, inputs)
        torque = call(arm.inverse_dynamics, inputs)
        ours = call(arm.base_regressor, inputs | {"load": load}) @ beta
        np.testing.assert_allclose(ours, torque[:, 0], rtol=0, atol=1e-8 * np.abs(torque).max())


def test_a_payload_is_added_to_the_last_link():
    """As `Fit.predict` with the payload effect, whose body has no inertia of its own."""
    carried = made_fit(PANDA, "payload")
    body = np.concatenate([carried.effect_coefficients, np.zeros(6)])
    arm, run = symbolic(made_fit(PANDA, ""), free=["payload"]), recording(7)
    expected = carried.predict(run)
    for k, inputs in moments(carried, run):
        torque = call(arm.inverse_dynamics, inputs | {"payload": body})
        np.testing.assert_allclose(torque[:, 0], expected[k], rtol=0, atol=1e-10 * 100)


def test_memory_in_continuous_time_agrees_with_the_exact_step():
    """ż integrated with small steps against the step that `Fit.predict` takes."""
    fit = made_fit(lieid.robots.two_link(), "presliding:1")
    arm, model = symbolic(fit), fit.model
    dq, duration, steps = np.array([0.3, -0.2]), 0.1, 4000
    rhs = arm.f_explicit
    assert rhs.name_in() == ["x", "u"]
    x = np.concatenate([np.zeros(2), dq, model.initial_states])
    z = x[4:]
    for k in range(steps):
        state = np.concatenate([x[:2] + k * duration / steps * dq, dq, z])
        z = z + duration / steps * rhs(state, np.zeros(2)).full()[4:, 0]
    width = fit.shapes[0]
    exact = width * (1.0 - np.exp(-abs(dq[0]) * duration / width))
    np.testing.assert_allclose(z, [exact], rtol=2e-3)


def test_explicit_and_implicit_dynamics_agree(combined):
    arm = symbolic(combined, smooth_velocity=0.05)
    n = combined.model.n
    x, u = np.random.default_rng(1).uniform(-1, 1, (2, 2 * n))[:, : 2 * n]
    further = {"temperature": np.full(n, 40.0), "time": 1.0}
    inputs = {"x": x, "u": u[:n]} | further
    xdot = call(arm.f_explicit, inputs)
    residual = call(arm.f_implicit, inputs | {"xdot": xdot})
    assert np.abs(residual).max() < 1e-9


@pytest.fixture(scope="module")
def indefinite():
    """A fit whose last link has a negative inertia."""
    fit = made_fit(lieid.robots.two_link(), "")
    parameters = fit.parameters.copy()
    parameters[10:] = -parameters[10:]
    return dataclasses.replace(fit, parameters=parameters)


def test_forward_dynamics_of_an_indefinite_mass_matrix_are_refused(indefinite):
    with pytest.raises(ModelError, match="--method feasible"):
        _ = symbolic(indefinite).forward_dynamics
    assert symbolic(indefinite, allow_indefinite=True).forward_dynamics.n_in() == 3


def test_load_friction_that_leaves_the_acceleration_undetermined_is_refused():
    """Friction that changes by more than the load: no drive that moves has it."""
    fit = made_fit(lieid.robots.two_link(), "load_friction/square")
    for size, refused in ((2.0, True), (0.005, False)):
        parameters = fit.parameters.copy()
        parameters[20:] = size
        arm = symbolic(dataclasses.replace(fit, parameters=parameters))
        if refused:
            for name in ("forward_dynamics", "f_explicit"):
                with pytest.raises(ModelError, match=r"friction .* changes by more than the load"):
                    getattr(arm, name)
        else:
            assert arm.forward_dynamics.name_in() == ["q", "dq", "tau"]


FIT = made_fit(PANDA, COMBINED)


def test_free_groups_are_inputs_with_the_fits_values():
    groups = ["friction:2", "payload", "link6", "stribeck:4"]
    fixed, free = symbolic(FIT, free=["payload"]), symbolic(FIT, free=groups)
    assert list(free.free) == ["friction_2", "link6", "stribeck_4"]
    assert free.free["link6"].labels[0] == "m6"
    assert all(label.endswith(":2") for label in free.free["friction_2"].labels)
    function = free.inverse_dynamics
    given = {name: group.nominal for name, group in free.free.items()}
    random = np.random.default_rng(0)
    inputs = {name: random.normal(size=function.size_in(name)) for name in function.name_in()}
    expected = fixed.inverse_dynamics(
        **{name: inputs[name] for name in fixed.inverse_dynamics.name_in()}
    )["tau"]
    got = function(**(inputs | given))["tau"]
    np.testing.assert_allclose(got.full(), expected.full(), rtol=1e-12)
    heavier = given | {"link6": 1.5 * given["link6"]}
    assert np.abs((function(**(inputs | heavier))["tau"] - expected).full()).max() > 1e-3


@pytest.mark.parametrize(
    ("groups", "words"),
    [
        (["fricton:3"], "did you mean friction"),
        (["link99"], "expected some of friction, payload, link1"),
        (["friction:99"], "names no joints 1 to 7"),
        (["friction:4", "stribeck:4"], "is in friction:4 and stribeck:4"),
    ],
)
def test_unknown_groups_are_refused(groups, words):
    with pytest.raises(ModelError, match=words):
        symbolic(FIT, free=groups)


def test_misuse_states_what_is_expected():
    with pytest.raises(ModelError, match="expected a Robot, a Model or a Fit"):
        symbolic("panda")
    with pytest.raises(ModelError, match="expected one or 7"):
        symbolic(FIT, smooth_velocity=[0.1, 0.2])
    with pytest.raises(ModelError, match="pickle the fit"):
        pickle.dumps(symbolic(FIT))
    shown = repr(symbolic(FIT))
    assert "mass_matrix: q -> M (n, n)" in shown
    assert "forward_dynamics: (q, dq, tau) -> ddq" in shown


@pytest.mark.parametrize("effect", ["smooth/ddq:1", "smooth/dq.ddq:1"])
def test_a_function_of_the_acceleration_has_a_mass_matrix_and_forward_dynamics(effect):
    robot = lieid.robots.two_link()
    fit = made_fit(robot, f"coulomb,viscous,armature,{effect}")
    small = np.where([c.name.startswith("smooth") for c in fit.model.columns], 0.05, 1.0)
    links, coefficients = fit.parameters[:20], fit.parameters[20:] * small
    values = fit.model.base.combination @ np.concatenate([links, coefficients])
    fit = dataclasses.replace(fit, values=values, parameters=np.concatenate([links, coefficients]))
    arm = symbolic(fit)
    q, dq, tau = np.array([0.3, 0.5]), np.array([0.5, -0.8]), np.array([4.0, -2.0])
    ddq = arm.forward_dynamics(q, dq, tau)
    found = arm.inverse_dynamics(q, dq, ddq).full().ravel()
    np.testing.assert_allclose(found, tau, atol=1e-9)
    step = 1e-6
    ends = [[arm.inverse_dynamics(q, 0, x * e).full() for x in (step, -step)] for e in np.eye(2)]
    slopes = np.hstack([(after - before) / (2 * step) for after, before in ends])
    np.testing.assert_allclose(arm.mass_matrix(q).full(), slopes, atol=1e-6)
