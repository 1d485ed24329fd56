"""Friction of one joint: its curve, and a friction model fitted to it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from lieid_casadi.effects import Effect
from lieid_casadi.friction_curves.extraction import LoadSource, friction_curve
from lieid_casadi.friction_curves.fit_curve import fit_friction
from lieid_casadi.friction_curves.friction_fit import FrictionFit
from lieid_casadi.friction_curves.ranking import rank_friction_models
from lieid_casadi.identification.fit import Fit
from lieid_casadi.recording import Processing, Recording
from lieid_casadi.robot.robot import Robot


def friction(
    arm: Robot | Fit,
    recordings: Recording | Sequence[Recording],
    joint: int,
    *,
    effects: str | Iterable[str | Effect] | None = None,
    processing: Processing | None = None,
    load: LoadSource | None = None,
    seed: int = 0,
) -> FrictionFit:
    """Fit a friction model to the motion of one joint in both directions (Eq. 15).

    The steps are `lieid_casadi.friction_curves.friction_curve`, and `fit_friction` or
    `rank_friction_models` of that package.

    Parameters
    ----------
    arm : Robot or Fit
        Source of link parameters: identified ones and armatures of a fit, or nominal ones.
    recordings : Recording or sequence of Recording
        Recordings with torques.
    joint : int
        From 0.
    effects : str or sequence of str or Effect, optional
        Name of a friction model, or effects such as ``"coulomb,viscous,load_friction"``. Without
        it, the models of the literature are fitted and that with the smallest BIC is returned.
    processing : Processing, optional
        Filter options; by default the cut-off is chosen from the spectrum.
    load : {"model", "measured"}, optional
        Source of the load that friction may depend on, see `friction_curve`.
    seed : int
        Seed of the random starting points.

    Returns
    -------
    FrictionFit
        Its ``curve`` is the friction curve.

    Raises
    ------
    RecordingError
        The joint does not pass the same positions in both directions.
    EffectError
        An effect is unknown or acts on another joint.
    """
    curve = friction_curve(arm, recordings, joint, processing=processing, load=load)
    if effects is None:
        return rank_friction_models(curve, seed=seed)[0].fit
    return fit_friction(curve, effects, seed=seed)
