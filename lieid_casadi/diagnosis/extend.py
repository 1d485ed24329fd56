"""Add named effects to a fit and refit: before and after."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lieid_casadi.comparison import compare
from lieid_casadi.effects import parse_effects
from lieid_casadi.errors import EffectError
from lieid_casadi.identification import Fit, identify
from lieid_casadi.model import Model
from lieid_casadi.recording import Recording

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Extension:
    """Result of :func:`extend`.

    Attributes
    ----------
    added : tuple of str
    before, after : Fit
        Both on the same training recordings.
    rms_train, rms_test : (2, n)
        Before and after, N·m; ``rms_test`` None without a test.
    """

    added: tuple[str, ...]
    before: Fit
    after: Fit
    rms_train: Array
    rms_test: Array | None

    @property
    def parameters(self) -> list[dict[str, Any]]:
        """The rows of the parameter table that are new."""
        old = {(row["name"], row["joint"]) for row in self.before.parameter_table()}
        table = self.after.parameter_table()
        return [row for row in table if (row["name"], row["joint"]) not in old]

    def to_dict(self) -> dict[str, Any]:
        """Return what ``lieid extend --json`` writes."""
        tested = self.rms_test is not None
        pairs = {"rms_train": self.rms_train, "rms_test": self.rms_test}
        return {
            "added": list(self.added),
            "before": {"effects": self.before.model.effects}
            | {k: None if v is None else v[0].tolist() for k, v in pairs.items()},
            "after": {"effects": self.after.model.effects}
            | {k: None if v is None else v[1].tolist() for k, v in pairs.items()},
            "fall": (1.0 - (pairs["rms_test"] if tested else self.rms_train)[1]  # type: ignore[index]
                     / (pairs["rms_test"] if tested else self.rms_train)[0]).tolist(),  # type: ignore[index]
            "parameters": self.parameters,
            "fit": self.after.to_dict(),
        }  # fmt: skip

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw both models' errors per joint; not shown."""
        from lieid_casadi.diagnosis.waterfall_plot import draw_waterfall

        pair = self.rms_train if self.rms_test is None else self.rms_test
        measured = "training" if self.rms_test is None else "test"
        labels = ["before", f"+ {', '.join(self.added)}"]
        return draw_waterfall(list(pair), labels, None, measured, ax)


def extend(
    fit: Fit,
    effects: str,
    train: Recording | Sequence[Recording],
    test: Recording | Sequence[Recording] | None = None,
    *,
    progress: Callable[[str, float], None] | None = None,
) -> Extension:
    """Add effects to a fit's model, refit both on ``train`` and compare them on ``test``.

    Parameters
    ----------
    effects : str
        ``stribeck:4,load_friction:2+3``; joints from 1.

    Raises
    ------
    EffectError
        An unknown effect, one that the model has, or a joint that does not move.
    """
    model = fit.model
    wanted = parse_effects(effects, model.n)
    have = {placement.label for placement in model.placements}
    known = [p.label for p in wanted if p.label in have]
    if known:
        raise EffectError(f"the model has {', '.join(known)} already")
    _check_motion(wanted, train)
    larger = Model.of_placements(model.robot, (*model.placements, *wanted))
    report = progress or (lambda stage, fraction: None)
    report("before", 0.0)
    before = identify(model, train, method=fit.method, processing=fit.processing)
    report("after", 0.3)
    after = identify(larger, train, method=fit.method, processing=fit.processing)
    rms_test = None
    if test is not None:
        report("test", 0.8)
        rms_test = np.array([compare(before, test).rms, compare(after, test).rms])
    report("done", 1.0)
    added = tuple(placement.label for placement in wanted)
    return Extension(added, before, after, np.array([before.rms_train, after.rms_train]), rms_test)


def _check_motion(wanted: Sequence[Any], train: Recording | Sequence[Recording]) -> None:
    recordings = [train] if isinstance(train, Recording) else list(train)
    for placement in wanted:
        for joint in (placement.joint, placement.source):
            if joint is None or joint >= recordings[0].n:
                continue
            if all(np.ptp(r.q[:, joint]) < 1e-6 for r in recordings):
                raise EffectError(
                    f"{placement.label}: joint {joint + 1} does not move in the training "
                    "recordings; expected motion to see the effect"
                )
