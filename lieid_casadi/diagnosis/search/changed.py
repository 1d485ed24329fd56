"""What has changed since a fit: the model is kept, its own held-out misfit is the null.

The fit's numbers may move within their uncertainties (rows of their own beside the measured
ones), so that what the fit never knew well is not taken for a change.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.comparison import compare
from lieid_casadi.diagnosis.diagnosis import Diagnosis, Step
from lieid_casadi.diagnosis.residual.projected_residual import Remainder
from lieid_casadi.diagnosis.residual.residual_description import described
from lieid_casadi.diagnosis.screening.aliases import aliases
from lieid_casadi.diagnosis.screening.context import Scene
from lieid_casadi.diagnosis.search.changed_effects import ChangeSearch
from lieid_casadi.errors import unique_warnings
from lieid_casadi.identification import Fit
from lieid_casadi.identification.temperature import center_temperature
from lieid_casadi.identification.uncertainty.noise_model import Noise
from lieid_casadi.recording import Recording, process

Array = NDArray[np.float64]
MOST_CHANGES = 6


def changed(
    fit: Fit,
    recordings: Sequence[Recording],
    *,
    seed: int,
    report: Callable[[str, float], None],
) -> Diagnosis:
    """Return what is no longer as the fit has it."""
    report("compare", 0.0)
    before = compare(fit, recordings)
    segments, _ = center_temperature(process(recordings, fit.processing), fit.temperature_mean)
    report("look for changes", 0.2)
    scene = Scene.of(fit, segments, kept=True)
    search = ChangeSearch(scene, held_out_noise(fit), seed)
    first = search.errors()
    steps: list[Step] = []
    while len(steps) < MOST_CHANGES:
        step = search.next_step()
        if step is None:
            break
        steps.append(step)
        report("look for changes", 0.2 + 0.1 * len(steps))
    left = search.left_over()
    out = {p.label for p in search.stand_ins(left)}
    if out:
        steps = [step for step in steps if step.label not in out]
        left = search.without(out)
    left = described(left, Remainder.of(scene, search.plain, search.beside()))
    verdict = "unexplained" if left else "effect_found" if steps else "sufficient"
    report("done", 1.0)
    return Diagnosis(
        mode="changed",
        verdict=verdict,
        joint_names=before.joint_names,
        noise_floor=search.null,
        noise_source="held_out",
        baseline_effects=tuple(fit.model.effects),
        baseline_train=None,
        baseline_test=before.rms,
        steps=tuple(steps),
        unexplained=left,
        rejected=tuple(search.rejected),
        aliases=aliases(search.bank, search.baseline),
        tried=len(scene.bank.candidates),
        fit=fit,
        warnings=unique_warnings(before.warnings),
        train=fit.provenance.recordings,
        test=before.recordings,
        baseline_moving=first,
    )


def held_out_noise(fit: Fit) -> tuple[Noise, ...]:
    """Return the noise of each joint's residual, as large as on data that the fit has not seen.

    It must not be taken from the new recording: a slow change would pass for the noise's memory.
    """
    ratio = np.nan_to_num(fit.rms_cv / np.maximum(fit.noise, 1e-300), nan=1.0)
    return tuple(
        n.times(max(float(r), 1.0)) for n, r in zip(fit.residual_noise, ratio, strict=True)
    )
