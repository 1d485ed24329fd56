"""Errors on recordings of real arms against those of ordinary least squares, per joint.

The effects were chosen by cross-validation on the training part alone; `REFERENCE` is the RMS of
Pinocchio's regressor + Coulomb + viscous + offset + q̈ per joint on the same part, N·m.
"""

from dataclasses import replace

import numpy as np
import pytest
from real_arms import PANDA, TX40, needs

import lieid_casadi as lieid
from lieid_casadi.identification.prediction import torque_along
from lieid_casadi.identification.regression.design_matrix import Design
from lieid_casadi.identification.regression.fixed_point import fixed_point
from lieid_casadi.recording import Processing, process

pytestmark = pytest.mark.real
REFERENCE = {
    "tx40": [1.92, 1.65, 1.26, 0.66, 1.01, 0.57],
    "panda": [0.32, 0.17, 0.21, 0.15, 0.12, 0.06, 0.05],
}


def rms(x):
    return np.sqrt(np.mean(x**2, axis=0))


@needs(PANDA / "panda.urdf")
def test_panda_without_rotor_inertia_and_with_presliding():
    fingers = ("panda_finger_joint1", "panda_finger_joint2")
    robot = lieid.Robot.from_urdf(PANDA / "panda.urdf", lock=fingers)
    run = lieid.Recording.load(PANDA / "excitation.csv.gz")
    middle = run.t[0] + 0.65 * run.duration
    train, test = run.cut(None, middle), run.cut(middle, None)
    plain, fit = (
        lieid.identify(lieid.Model(robot, effects), train, processing=Processing(cutoff=3.0))
        for effects in ("coulomb,viscous,offset", "coulomb,viscous,offset,presliding")
    )
    assert np.mean((fit.rms_cv / plain.rms_cv) ** 2) < 1.0
    (segment,) = process(test, fit.processing)
    error = rms(segment.filter(segment.tau) - fit.predict_processed(segment))
    assert np.all(error < REFERENCE["panda"])


@needs(TX40 / "tx40.urdf")
def test_tx40_with_coupled_wrist_joints():
    """Every third block of 0.6 s is held out, with a margin for the filter's response."""
    robot = lieid.Robot.from_urdf(TX40 / "tx40.urdf")
    run = lieid.Recording.load(TX40 / "excitation.csv.gz").cut(None, 7.8)
    (segment,) = process(run, Processing(cutoff=20.0, trim=0.0))
    held = (segment.t / 0.6).astype(int) % 3 == 2
    model = lieid.Model(
        robot, "coulomb,viscous,offset,armature,stribeck,transmission_coupling/rotor:5<6+6<5"
    )
    compiled = lieid.compile(model)
    known = replace(segment, moving=segment.moving & ~held[:, None])
    state, settled = fixed_point(Design(compiled, [known]), "wls", lambda *_: None, None)
    assert settled
    predicted = torque_along(compiled, segment, state.parameters, state.shapes)
    error = segment.filter(segment.tau - predicted)
    blocks = (segment.filtered_time / 0.6).astype(int) % 3 == 2
    assert np.all(rms(error[blocks]) < REFERENCE["tx40"])
    values = dict(zip([c.label for c in model.base_columns], state.solution.values, strict=True))
    rotor = [values[f"transmission_coupling/rotor.I_a:{k}"] for k in (5, 6)]
    assert rotor[0] == pytest.approx(rotor[1], rel=0.3)
    assert rotor[0] == pytest.approx(values["armature.I_a:6"], rel=0.4)
