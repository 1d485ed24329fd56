"""A real arm without payload, and with the torque of one added by Pinocchio."""

from dataclasses import replace

import numpy as np
from real_arms import UR10E, needs, ur10e_fit, ur10e_run

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.plant.rigid import rigid_torques
from lieid_casadi.recording import process
from lieid_casadi.robot.inertia import link_parameters

TRAIN, RUN = ("excitation_30s", "excitation_50s"), "excitation_14_harmonics"
pytestmark = needs(UR10E / f"{RUN}.csv.gz")
CUTOFF = lieid.Processing(cutoff=7.0)
EFFECTS = "coulomb,viscous,offset"
MASS, COM = 5.0, np.array([0.02, 0.05, 0.1])
GAINS = np.array([14.87, 13.26, 11.13, 10.62, 11.03, 11.47])  # as the source states them


def with_body(robot, run):
    """Return the recording with the torque of a body at the tool added."""
    body = link_parameters(MASS, COM, np.diag([0.03, 0.03, 0.02]))
    links = robot.link_parameters
    models = [
        plant.build_pinocchio(robot, x) for x in (links, plant.with_payload(robot, links, body))
    ]
    (segment,) = process(run, CUTOFF)
    bare, loaded = (rigid_torques(m, segment.q, segment.dq, segment.ddq) for m in models)
    extra = [np.interp(run.t, segment.t, column) for column in (loaded - bare).T]
    return replace(run, tau=run.tau + np.column_stack(extra), source_hash="with a body")


def test_an_unloaded_run_has_no_significant_payload():
    fit = ur10e_fit(EFFECTS)
    found = lieid.identify_payload(fit, ur10e_run(RUN))
    assert abs(found.mass) < 3.0 * found.mass_std
    assert found.mass_std < 0.1
    assert found.explained
    whitened = np.linalg.solve(np.linalg.cholesky(found.covariance), found.parameters)
    assert whitened @ whitened < 29.6  # chi-square of ten numbers, p = 0.001


def test_a_body_added_to_measured_torque():
    fit = ur10e_fit(EFFECTS)
    found = lieid.identify_payload(fit, with_body(fit.model.robot, ur10e_run(RUN)))
    assert abs(found.mass - MASS) < 3.0 * found.mass_std
    assert np.all(np.abs(found.com - COM) < 3.5 * found.com_std)
    assert np.all(found.com_std < 5e-3)


def test_gains_from_measured_currents_and_a_body():
    """Close to the gains stated with the recordings, which are themselves uncertain."""
    robot = ur10e_fit(EFFECTS).model.robot

    def amperes(run):
        return replace(run, tau=None, current=run.tau / GAINS)

    found = lieid.drive_gains(
        robot,
        [amperes(ur10e_run(name)) for name in TRAIN],
        amperes(with_body(robot, ur10e_run(RUN))),
        mass=MASS,
        processing=CUTOFF,
    )
    assert np.all(np.abs(found.gains - GAINS) < 3.5 * found.std)
    assert np.all(found.std[1:] < 0.05 * GAINS[1:])
