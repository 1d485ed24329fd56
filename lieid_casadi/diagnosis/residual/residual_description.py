"""What stays unexplained, with its shape and a formula."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.diagnosis.residual.projected_residual import Remainder
from lieid_casadi.diagnosis.residual.shapes import shapes_of
from lieid_casadi.diagnosis.residual.symbolic_formula import Form, form_of
from lieid_casadi.diagnosis.residual.unexplained import Unexplained
from lieid_casadi.diagnosis.screening.context import Scene
from lieid_casadi.identification.uncertainty.noise_model import Noise

Array = NDArray[np.float64]
HELPS = 0.5  # of what was explained in training, on the test: a formula that says less is not told
SEEN = 1e-4  # of a column: a direction with less of the model's own is not fitted


@dataclass(frozen=True, eq=False)
class Ahead:
    """The same fit along training and test, for formulas that must hold on both."""

    train: Scene
    test: Scene
    noise: tuple[Noise, ...]

    def carries(self, form: Form, part: Unexplained) -> bool:
        """Whether the test's error falls where the formula is added with its training numbers."""
        scenes = (self.train, self.test)
        remainders = [Remainder.of(s, self.noise, s.baseline(self.noise)) for s in scenes]
        columns = [
            r.columns(part.joint, [np.column_stack([t.along(s) for t in form.terms])
                                   for s in r.signals])
            for r in remainders
        ]  # fmt: skip
        own = [self._whitened(s, s.columns) for s in scenes]
        size = np.linalg.norm(own[0], axis=0)
        size[size == 0.0] = 1.0
        absorbed = np.linalg.lstsq(own[0] / size, columns[0], rcond=SEEN)[0] / size[:, None]
        rows = remainders[1].baseline.joint(part.joint)
        before = self._whitened(self.test, self.test.residual)[rows]
        after = before - ((columns[1] - own[1] @ absorbed) @ np.array(form.values))[rows]
        fall = float(np.sum(before**2) - np.sum(after**2))
        return fall >= HELPS * part.fraction * float(np.sum(before**2))

    def _whitened(self, scene: Scene, values: Sequence[Array]) -> Array:
        rows = zip(self.noise, values, scene.runs, strict=True)
        return np.concatenate([n.whiten(v, runs) for n, v, runs in rows])


def described(
    left: Sequence[Unexplained], remainder: Remainder, ahead: Ahead | None = None
) -> tuple[Unexplained, ...]:
    """Return unexplained parts with their shapes, and a formula where a short one is found.

    A formula that the test contradicts is left out.
    """
    found = []
    for u in left:
        form = form_of(u, remainder)
        if form is not None and ahead is not None and not ahead.carries(form, u):
            form = None
        found.append(replace(u, shapes=shapes_of(u, remainder), form=form))
    return tuple(found)
