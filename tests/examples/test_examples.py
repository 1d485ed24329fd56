"""The examples of optimal control, of a user's limits, of an experiment, and the notebook."""

import importlib.util
import json
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.cli.main import main
from lieid_casadi.excitation import capsules_of
from lieid_casadi.robot.pinocchio_model import build_pinocchio

sys.path.insert(0, str(Path(__file__).parents[2] / "examples"))

import mpc
import mpc_acados
import optimal_control

PANDA = lieid.robots.panda()


@pytest.mark.slow
def test_the_fastest_motion_keeps_the_limits_on_the_simulated_arm(tmp_path):
    plan, share, tracking = optimal_control.main(["-o", str(tmp_path / "motion.png")])
    assert plan.duration < 1.0
    np.testing.assert_allclose(np.abs(plan.tau / PANDA.limit("torque")).max(), 0.8, atol=1e-4)
    assert share < 1.0
    assert tracking < 5e-3
    assert (tmp_path / "motion.png").stat().st_size > 10_000


def test_a_model_of_acados_has_the_identified_arms_dynamics():
    arm = plant.demo_arm(lieid.robots.two_link(), hidden=None)
    model = mpc_acados.fill(mpc_acados.ModelExpressions(), mpc_acados.identified(arm))
    explicit = ca.Function("f", [model.x, model.u, model.p], [model.f_expl_expr])
    symbols = [model.x, model.xdot, model.u, model.p]
    implicit = ca.Function("g", symbols, [model.f_impl_expr])
    q, dq, ddq = np.array([[[0.3, -0.2]], [[0.5, 0.4]], [[2.0, -3.0]]])
    u = plant.move_along(arm, np.zeros(1), q, dq, ddq).tau[0]  # friction changes ddq by more than 3
    x, body = np.concatenate([q[0], dq[0]]), np.array([2, 0.2, 0, 0, 0.01, 0, 0.01, 0, 0, 0.01])
    np.testing.assert_allclose(explicit(x, u, np.zeros(10)).full()[2:, 0], ddq[0], atol=0.3)
    xdot = explicit(x, u, body)
    assert np.abs(implicit(x, xdot, u, body).full()).max() < 1e-10
    assert np.abs((xdot - explicit(x, u, np.zeros(10))).full()).max() > 0.1


@pytest.mark.slow
def test_model_predictive_control_arrives_with_the_identified_dynamics():
    runs = mpc.main(["--seconds", "2.2"])
    assert runs["identified"].error < 0.02
    assert runs["nominal"].error > 3.0 * runs["identified"].error
    for found in runs.values():
        speed = np.gradient(found.q, found.t, axis=0)
        assert np.all(np.abs(found.tau) <= PANDA.limit("torque"))
        assert np.all(np.abs(speed) <= PANDA.limit("velocity"))


EXAMPLE = Path(__file__).parents[2] / "examples" / "own_limits.py"


@pytest.mark.slow
def test_power_and_pillar():
    specification = importlib.util.spec_from_file_location("own_limits", EXAMPLE)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    found = module.design(starts=1, max_iterations=60)
    assert found.criterion == "friction_variance"
    assert "power of at most 25 W" in found.checked
    assert any(text.startswith("pillar: link 1") for text in found.checked)
    model = build_pinocchio(module.ROBOT)
    data = model.createData()
    motion = found.motion(100.0)
    capsules = [c for c in capsules_of(module.ROBOT) if c.link]
    for q, dq, ddq in zip(motion.q, motion.dq, motion.ddq, strict=True):
        assert pin.rnea(model, data, q, dq, ddq) @ dq <= 25.0
        pin.forwardKinematics(model, data, q)
        for capsule in capsules:
            for share in np.linspace(0.0, 1.0, 5):
                point = capsule.start + share * (capsule.end - capsule.start)
                beyond = np.abs(data.oMi[capsule.link].act(point) - [0.5, -0.55, 0.5])
                away = np.linalg.norm(np.maximum(beyond - [0.1, 0.15, 0.5], 0.0))
                assert away >= capsule.radius


pytest.importorskip("mujoco")


@pytest.mark.slow
def test_finds_the_friction_of_the_arm(request, tmp_path):
    program = request.config.rootpath / "examples" / "experiment_mujoco.py"
    record = f"'{sys.executable}' '{program}' {{trajectory}} {{recording}}"
    out = tmp_path / "out"
    assert main(["experiment", "two_link", "--yes", "-o", str(out), "--record", record]) == 0
    content = json.loads((out / "experiment.json").read_text())
    assert content["stopped"] == "all_named"
    (step,) = content["steps"]
    assert step["label"] == "stribeck:1"
    assert step["parameters"]["f_s-f_c"] == pytest.approx(1.5, rel=0.05)
    assert step["parameters"]["v_s"] == pytest.approx(0.25, rel=0.05)


NOTEBOOK = Path(__file__).parents[2] / "examples" / "find_the_missing_effect.ipynb"

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")
pytest.importorskip("ipykernel")


def texts(notebook):
    """Return what each code cell printed."""
    return [
        "".join(o["text"] for o in cell.outputs if o.output_type == "stream" and o.name == "stdout")
        for cell in notebook.cells
        if cell.cell_type == "code"
    ]


def falls(notebook):
    """Return the percentages of the last cell, joint by joint."""
    lines = texts(notebook)[-1].splitlines()
    return [float(line.split(":")[1].split("%")[0]) for line in lines]


@pytest.fixture(scope="module")
def stored():
    return nbformat.read(NOTEBOOK, as_version=4)


def test_stored_notebook_is_small_whole_and_free_of_errors(stored):
    assert NOTEBOOK.stat().st_size <= 200_000
    nbformat.validate(stored)
    code = [cell for cell in stored.cells if cell.cell_type == "code"]
    assert all(cell.execution_count == k + 1 for k, cell in enumerate(code))
    outputs = [output for cell in code for output in cell.outputs]
    assert not any(output.output_type == "error" for output in outputs)
    assert sum("image/png" in output.get("data", {}) for output in outputs) >= 2


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # of the kernel's own machinery
def test_notebook_runs_again_and_finds_the_hidden_effect(stored):
    fresh = nbformat.from_dict(stored)
    for cell in fresh.cells:
        if cell.cell_type == "code":
            cell.outputs, cell.execution_count = [], None
    here = {"metadata": {"path": str(NOTEBOOK.parents[1])}}
    nbclient.NotebookClient(fresh, timeout=300, kernel_name="python3", resources=here).execute()
    assert "effect_found\nload_friction on joint 1\n" in texts(fresh)
    shoulder, elbow = falls(fresh)
    assert shoulder > 50.0  # load friction is several times the noise there
    assert abs(elbow) < 10.0  # nothing is hidden there
    # other processors round differently
    assert falls(fresh) == pytest.approx(falls(stored), abs=3.0)
