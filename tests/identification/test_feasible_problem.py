"""The convex problem: two solvers, frames and units, friction on a finer grid."""

import numpy as np
import pytest
from robot.random_arms import random_link

import lieid_casadi as lieid
from lieid_casadi.identification.feasible.dissipation import dissipation_rows
from lieid_casadi.identification.feasible.problem import ConvexSolver, FeasibleProblem
from lieid_casadi.identification.regression.least_squares import Factor, triangular
from lieid_casadi.robot.inertia import pseudo_inertia


def rows_of(model, rng, samples=400, noise=0.3):
    """Factor of random states of an arm whose true inertias differ from the references."""
    compiled = lieid.compile(model)
    q, dq, ddq = (rng.normal(0.0, s, (samples, model.n)) for s in (1.0, 1.0, 3.0))
    truth = np.concatenate([random_link(rng) for _ in range(model.n)])
    coefficients = rng.uniform(0.1, 1.0, len(model.columns))
    matrix = compiled.base_regressor(q, dq, ddq).reshape(-1, model.base.count)
    torque = matrix @ model.base.combination @ np.concatenate([truth, coefficients])
    torque = torque + rng.normal(0.0, noise, len(torque))
    return Factor(triangular(np.column_stack([matrix, torque]) / noise), len(torque))


def friction_rows(model, *, velocity, load):
    n = model.n
    return dissipation_rows(
        lieid.compile(model),
        model.initial_shapes,
        velocity=np.full(n, velocity),
        load=np.full(n, load),
        temperature=np.zeros(n),
        lower=np.full(n, -np.pi),
        upper=np.full(n, np.pi),
    )


def problem_of(model, factor, rng):
    references = np.array([pseudo_inertia(random_link(rng)) for _ in range(model.n)])
    friction = friction_rows(model, velocity=2.0, load=20.0)
    return FeasibleProblem.of(model, references, friction, factor)


def test_friction_dissipates_between_the_points_of_the_grid():
    """Data of friction that drives the joint at speed: f_v2 below −f_v/v."""
    rng = np.random.default_rng(9)
    model = lieid.Model(lieid.robots.two_link(), "coulomb,viscous,viscous_polynomial,offset")
    compiled = lieid.compile(model)
    q, dq, ddq = (rng.normal(0.0, s, (600, 2)) for s in (1.0, 0.8, 3.0))
    columns = compiled.base_regressor(q, dq, ddq).reshape(-1, model.base.count)
    names = [c.name for c in model.columns]
    wanted = {"coulomb.f_c": 0.2, "viscous.f_v": 1.0, "offset.f_b": -3.0}
    wanted |= {"viscous_polynomial.f_v2": -1.5, "viscous_polynomial.f_v3": 0.1}
    friction = np.array([wanted[name] for name in names])
    # joint 2 is dissipative without constraints
    friction[names.index("viscous_polynomial.f_v2") + 2] = -0.3
    truth = np.concatenate([model.robot.link_parameters, friction])
    torque = columns @ model.base.combination @ truth + rng.normal(0, 0.01, len(columns))
    factor = Factor(triangular(np.column_stack([columns, torque]) / 0.01), len(torque))
    problem = problem_of(model, factor, rng)
    solution = ConvexSolver(problem).solve(factor, 1e-3)
    coefficients = dict(zip([c.label for c in model.columns], solution[20:], strict=True))
    v = np.linspace(1e-4, 2.0, 2000)
    driving = 0.2 + v - 1.5 * v**2 + 0.1 * v**3
    assert driving.min() < -0.5
    for j in ("1", "2"):
        powers = [
            "coulomb.f_c",
            "viscous.f_v",
            "viscous_polynomial.f_v2",
            "viscous_polynomial.f_v3",
        ]
        found = [coefficients[f"{name}:{j}"] for name in powers]
        assert np.polynomial.polynomial.polyval(v, found).min() > -0.01
        assert coefficients[f"offset.f_b:{j}"] < -1.0  # the offset is not constrained
    # a negative coefficient alone is not constrained
    assert coefficients["viscous_polynomial.f_v2:2"] == pytest.approx(-0.3, abs=0.05)


def test_coupled_joints_dissipate_together():
    """f_v·q̇₁ on joint 2: alone it can drive, with enough friction on both joints it cannot."""
    model = lieid.Model(lieid.robots.two_link(), "viscous,transmission_coupling:2<1")
    rows = friction_rows(model, velocity=1.0, load=0.0)
    order = [c.label for c in model.columns]
    assert order == [
        "viscous.f_v:1",
        "viscous.f_v:2",
        "transmission_coupling.f_v:2",
        "transmission_coupling.f_c:2",
    ]
    # [1, c/2; c/2, 1] is positive semidefinite iff |c| ≤ 2
    assert (rows @ [1.0, 1.0, 1.9, 0.0]).min() >= 0.0
    assert (rows @ [1.0, 1.0, 2.1, 0.0]).min() < 0.0
    # dry friction of the coupling alone drives at some speeds
    assert (rows @ [1.0, 1.0, 0.0, 0.5]).min() < 0.0


def test_coupled_joints_of_a_whole_arm_are_examined_on_a_part_of_their_motions():
    robot = lieid.robots.panda()
    couplings = [f"transmission_coupling:{j + 2}<{j + 1}" for j in range(robot.n - 1)]
    model = lieid.Model(robot, ["viscous", "load_friction", "torque_ripple:4", *couplings])
    rows = friction_rows(model, velocity=1.0, load=1.0)
    values = np.array([float(c.label.startswith("viscous")) for c in model.columns])
    assert (rows @ values).min() > 0.0
    for j in range(robot.n):  # friction that drives one joint alone, and no other
        (column,) = (k for k, c in enumerate(model.columns) if c.label == f"viscous.f_v:{j + 1}")
        driving = values.copy()
        driving[column] = -1e-3
        assert (rows @ driving).min() < 0.0


def test_friction_with_load_and_states_reaches_full_sliding():
    model = lieid.Model(lieid.robots.two_link(), "presliding/load:1,viscous:1")
    rows = friction_rows(model, velocity=2.0, load=10.0)
    # columns z/w → 1, |load|, q̇: f_c + f_τ·|τ| + f_v·v over |τ| in 0, 5, 10 and v up to 2
    assert (rows @ [1.0, -0.09, 0.0]).min() == pytest.approx(0.1, abs=1e-6)
    assert (rows @ [1.0, 0.0, -0.4]).min() == pytest.approx(0.2, abs=1e-6)
