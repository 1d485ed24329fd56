"""The example of a user's limit, criterion and keep-out box, checked by Pinocchio."""

import importlib.util
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from lieid_casadi.excitation import capsules_of
from lieid_casadi.robot.pinocchio_model import build_pinocchio

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
