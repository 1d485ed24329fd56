"""Motions that are found sooner."""

from functools import partial

import pytest

from lieid_casadi.excitation import excite
from lieid_casadi.experiments import motion


@pytest.fixture(autouse=True, scope="package")
def short_searches():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(motion, "EXCITATION_STARTS", 1)
        patch.setattr(motion, "EVALUATIONS", 60)
        patch.setattr(motion, "STARTS", 20)
        patch.setattr(motion, "excite", partial(excite, max_iterations=20))
        yield
