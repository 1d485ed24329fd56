"""Identification in stages: links, friction of single joints, links again (sections 4.1 to 4.3).

The first stage identifies the links with simple friction (Eq. 11) from excitation. The second stage
fits a nonlinear friction model (Eq. 8) to the friction curve of each joint (Eq. 15). Friction runs
are slow, so terms that grow with speed do not extrapolate to the speeds of an excitation: put
together with the links (Eq. 16) they leave large errors. The third stage, which the paper does not
have, therefore identifies the links and these terms again from the excitation, with the dry
friction of the second stage subtracted.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

from lieid_casadi.effects import Effect
from lieid_casadi.errors import ModelError
from lieid_casadi.friction_curves.agreement import FrictionAgreement, compare_friction
from lieid_casadi.friction_curves.combined_fit import combine_stages
from lieid_casadi.friction_curves.extraction import LoadSource, friction_curve
from lieid_casadi.friction_curves.fit_curve import fit_friction
from lieid_casadi.friction_curves.friction_fit import FrictionFit
from lieid_casadi.identification.fit import Fit
from lieid_casadi.identification.identify import Method, identify
from lieid_casadi.model import Model
from lieid_casadi.recording import Processing, Recording
from lieid_casadi.recording.recording import listed


@dataclass(frozen=True, eq=False)
class StagedFit:
    """Result of `identify_in_stages`.

    Attributes
    ----------
    first_stage : Fit
        Links with simple friction, from the excitation.
    friction : dict of int to FrictionFit
        Second stage: the friction model of each joint (from 0) that has friction runs.
    fit : Fit
        The combined model, see `combine_stages`.
    """

    first_stage: Fit
    friction: dict[int, FrictionFit]
    fit: Fit

    def compare(self, joint_fit: Fit) -> tuple[FrictionAgreement, ...]:
        """Compare the friction of each joint with that of one fit of all parameters."""
        return tuple(compare_friction(own, joint_fit) for own in self.friction.values())

    def to_dict(self) -> dict[str, Any]:
        """Return the first stage and the friction of each joint for JSON."""
        return {
            "first_stage": self.first_stage.to_dict(),
            "friction": [own.to_dict() for own in self.friction.values()],
        }

    def __repr__(self) -> str:
        joints = ", ".join(str(joint + 1) for joint in self.friction)
        return f"<StagedFit: {self.fit!r}, friction runs of joints {joints or 'none'}>"


def identify_in_stages(
    model: Model,
    excitation: Recording | Sequence[Recording],
    friction_runs: Mapping[int, Recording | Sequence[Recording]],
    friction_effects: str | Iterable[str | Effect] = "paper",
    *,
    refit: bool = True,
    method: Method = "wls",
    load: LoadSource | None = None,
    processing: Processing | None = None,
    friction_processing: Processing | None = None,
    seed: int = 0,
) -> StagedFit:
    """Identify links from excitation and friction from runs of single joints (Eqs. 11 to 16).

    Parameters
    ----------
    model : Model
        Model of the first stage. That of the paper (Eq. 11) has the effects coulomb, viscous,
        viscous_polynomial and offset.
    excitation : Recording or sequence of Recording
        Motion of all joints, without payload.
    friction_runs : mapping of int to Recording or sequence of Recording
        Forward and backward motion of single joints, by joint from 0. Joints without runs keep
        the friction of the first stage.
    friction_effects : str or sequence of str or Effect
        Friction model of the second stage, see `fit_friction`; ``"paper"`` is Eq. 8.
    refit : bool
        Whether links and friction that grows with speed are identified again (third stage).
        Without it the result is that of the paper's two stages.
    method : str
        Method of the first stage, see `identify`.
    load : {"model", "measured"}, optional
        Source of the load torque of the friction runs, see `friction_curve`; ``"measured"`` for
        runs with a payload.
    processing, friction_processing : Processing, optional
        Filter options of the excitation and of the friction runs.
    seed : int
        Seed of the starting points of the second stage.

    Returns
    -------
    StagedFit

    Raises
    ------
    ModelError
        No friction runs are given.
    LieidError
        As `identify`, `friction_curve` and `fit_friction`.
    """
    if not friction_runs:
        raise ModelError("no friction runs given; expected runs of at least one joint")
    first_stage = identify(model, excitation, method=method, processing=processing)
    effects = friction_effects if isinstance(friction_effects, str) else list(friction_effects)

    def fitted(joint: int) -> FrictionFit:
        curve = friction_curve(
            first_stage, friction_runs[joint], joint, processing=friction_processing, load=load
        )
        return fit_friction(curve, effects, seed=seed)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        friction = dict(zip(friction_runs, pool.map(fitted, friction_runs), strict=True))
    given = listed(excitation)
    return StagedFit(
        first_stage, friction, combine_stages(first_stage, friction, given, refit=refit)
    )
