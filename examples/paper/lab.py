"""Measurements of section 6 on the plant, and the fits that tables and figures share.

Each is computed at first use and cached.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from arm import (
    HEAVIEST,
    PAYLOADS,
    PRINTED,
    ROBOT,
    Array,
    N,
    sensors,
    true_arm,
    true_friction,
    with_payload,
)
from filters import paper_filtered
from friction_runs import SWEEP_RATE, friction_runs
from stages import combine_stages

import lieid_casadi as lieid
from lieid_casadi import plant
from lieid_casadi.excitation import Torque
from lieid_casadi.excitation.excite import Excitation
from lieid_casadi.excitation.friction_sweep import SPEEDS
from lieid_casadi.friction_curves import (
    FrictionCurve,
    FrictionFit,
    fit_friction,
    friction_curve,
)
from lieid_casadi.identification import Fit
from lieid_casadi.identification.identify import identify_segments
from lieid_casadi.plant.ideal_tracking import TrueMotion
from lieid_casadi.recording import Processing, Recording

PERIOD: float = PRINTED["period"]
EQ_10 = "coulomb,viscous,offset"
EQ_16 = "coulomb,viscous,offset,viscous_polynomial"
REF_6 = EQ_10  # with physically consistent links
EQ_18 = "viscous,viscous_polynomial,stribeck/two_width,load_friction/paper"
CUTOFF = 10.0  # Hz; the paper states none
LINEAR = Processing(cutoff=CUTOFF)
_F = true_friction().rows()
TRUE = {  # by names of the library
    "viscous.f_v": _F["f_v1"],
    "viscous_polynomial.f_v2": _F["f_v2"],
    "viscous_polynomial.f_v3": _F["f_v3"],
    "stribeck/two_width.f_c": _F["f_c"],
    "stribeck/two_width.v_c": _F["f_c1"],
    "stribeck/two_width.f_s": _F["f_s"],
    "stribeck/two_width.v_s": _F["f_s1"],
    "load_friction/paper.f_tau": _F["f_tau"],
    "load_friction/paper.f_tau1": _F["f_tau1"],
    "load_friction/paper.f_tau2": _F["f_tau2"],
    "offset.f_b": _F["f_b"],
}


@dataclass(frozen=True)
class Lab:
    """Measurements on the plant and fits to them.

    Attributes
    ----------
    periods : int
        Number of periods of each excitation run.
    speeds : tuple of float
        Speeds of the friction runs, rad/s.
    centres : int
        Number of middle positions of the friction runs of each joint, which give loads from
        smallest to largest.
    starts, criterion_starts : int
        Number of random starts of the two excitations, and of each criterion in Table III.
    controlled : bool
        Whether a joint controller tracks the trajectories, or the arm follows them exactly.
    """

    periods: int = PRINTED["periods"]
    speeds: tuple[float, ...] = tuple(SPEEDS)
    centres: int = 3
    starts: int = 1
    criterion_starts: int = 5
    controlled: bool = True
    _motions: dict[tuple[int, float], TrueMotion] = field(default_factory=dict, repr=False)

    @classmethod
    def quick(cls) -> Lab:
        """Return a lab with fewer periods, speeds and starts, and without a controller."""
        return cls(periods=3, speeds=tuple(SPEEDS[::2]), criterion_starts=1, controlled=False)

    @cached_property
    def excitations(self) -> tuple[Excitation, Excitation]:
        """One trajectory for identification and another for verification (criterion C1)."""
        model = lieid.Model(ROBOT, effects=EQ_16)
        first, second = (
            lieid.excite(
                model,
                start_pose=np.zeros(N),
                starts=self.starts,
                seed=seed,
                margin=1.0,
                limits=(Torque(dry=0.0, viscous=0.0),),
            )
            for seed in (0, 1)
        )
        return first, second

    @property
    def fastest(self) -> float:
        """Largest speed of the second trajectory, rad/s."""
        t = np.linspace(0.0, PERIOD, 2000)
        return float(np.abs(self.excitations[1].trajectory.at(t).dq).max())

    @cached_property
    def training(self) -> Recording:
        """First trajectory without payload."""
        return self._run(0, 0.0, seed=10)

    @cached_property
    def verification(self) -> Recording:
        """Second trajectory without payload."""
        return self._run(1, 0.0, seed=11)

    @cached_property
    def loaded(self) -> dict[float, Recording]:
        """The second trajectory with each payload (kg)."""
        return {mass: self._run(1, mass, seed=20 + k) for k, mass in enumerate(PAYLOADS)}

    @cached_property
    def repetitions(self) -> tuple[Recording, Recording]:
        """Both trajectories without payload, with another realization of the noise."""
        first, second = (self._run(k, 0.0, seed=12 + k) for k in (0, 1))
        return first, second

    def _run(self, which: int, payload: float, *, seed: int) -> Recording:
        arm, key = true_arm(payload), (which, payload)
        if key not in self._motions:
            # At rest at both ends: the periods differ by noise only, so that one is simulated.
            period = _Periodic(self.excitations[which])
            t = np.linspace(0.0, PERIOD, round(1000.0 * PERIOD) + 1)
            self._motions[key] = (
                plant.move(arm, period)
                if self.controlled
                else plant.move_along(arm, t, *period.at(t))
            )
        motion = _repeated(self._motions[key], self.periods)
        name = f"trajectory {which + 1}, {payload:g} kg"
        return plant.measure(arm, motion, sensors(), seed=seed, name=name)

    @cached_property
    def no_load_fits(self) -> dict[str, Fit]:
        """The three models of Tables V and VI, identified through the paper's filters."""
        return {
            name: identify_segments(
                lieid.compile(lieid.Model(ROBOT, effects=effects)),
                paper_filtered(self.training, CUTOFF),
                method=method,
            ).complete()
            for name, effects, method in (
                ("Eq. 10", EQ_10, "wls"),
                ("Eq. 16", EQ_16, "wls"),
                ("ref. 6", REF_6, "feasible"),
            )
        }

    def curve(self, fit: Fit, joint: int, payload: float, draw: int = 0) -> FrictionCurve:
        """Return the friction curve of a joint with a payload.

        Parameters
        ----------
        fit : Fit
            Its links and the payload give the load torque.
        joint : int
            From 0.
        payload : float
            kg.
        draw : int
            Number of the noise realization.
        """
        runs = [
            plant.measure_along(
                true_arm(payload),
                *motion,
                sensors=replace(sensors(SWEEP_RATE), rate=None, velocity="none"),
                seed=10000 * draw + 1000 * joint + 10 * k + int(payload),
                name=f"joint {joint + 1}, {payload:g} kg",
            )
            for k, motion in enumerate(friction_runs(joint, self.speeds, self.centres))
        ]
        return friction_curve(loaded_fit(fit, payload), runs, joint, processing=LINEAR)

    @cached_property
    def first_stage(self) -> Fit:
        """Eq. 16 without load, through the linear filter: links for the friction stage."""
        return self._identified(EQ_16)

    @cached_property
    def curves(self) -> dict[int, FrictionCurve]:
        """Friction of every joint (from 0) under the heaviest payload (6.4.2)."""
        return {j: self.curve(self.first_stage, j, HEAVIEST) for j in range(N)}

    @cached_property
    def verification_curves(self) -> dict[int, dict[float, FrictionCurve]]:
        """Friction of every joint (from 0) under the payloads of 6.5.2, by mass."""
        return {
            j: {mass: self.curve(self.first_stage, j, mass) for mass in PAYLOADS} for j in range(N)
        }

    @cached_property
    def friction(self) -> dict[int, FrictionFit]:
        """Eq. 8 fitted to each of them."""
        return {j: fit_friction(curve, EQ_18) for j, curve in self.curves.items()}

    @cached_property
    def payload_fits(self) -> dict[str, Fit]:
        """Models identified without a payload that predict torques with one."""
        two, three = (
            combine_stages(self.first_stage, self.friction, [self.training], refit=refit)
            for refit in (False, True)
        )
        return {
            "Eq. 10": self._identified(EQ_10),
            "Eq. 17": self.first_stage,
            "Eqs. 16, 18, two stages": two,
            "Eqs. 16, 18, three stages": three,
            "Eqs. 16, 18, one fit": self._identified(f"{EQ_18},offset"),
            "true": self.truth,
        }

    @cached_property
    def truth(self) -> Fit:
        """The true parameters of the plant in the library's model."""
        known = {f"{name}:{j + 1}": x for name, row in TRUE.items() for j, x in enumerate(row)}
        return _with_numbers(self.first_stage, true_arm().parameters, known, f"{EQ_18},offset")

    def _identified(self, effects: str) -> Fit:
        model = lieid.Model(ROBOT, effects=effects)
        return lieid.identify(model, self.training, processing=LINEAR)


def _with_numbers(fit: Fit, links: Array, numbers: dict[str, float], effects: str) -> Fit:
    """Return a fit with these links (70,) and these values of its effects' parameters."""
    model = lieid.Model(ROBOT, effects=effects)
    parameters = np.concatenate([links, [numbers.get(c.label, 0.0) for c in model.columns]])
    return replace(
        fit,
        model=model,
        parameters=parameters,
        values=model.base.combination @ parameters,
        shapes=np.array([numbers[s.label] for s in model.shapes]),
    )


class _Periodic:
    """One period of an excitation, for the plant."""

    def __init__(self, excitation: Excitation) -> None:
        self.duration, self._trajectory = PERIOD, excitation.trajectory

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        motion = self._trajectory.at(np.asarray(t, dtype=float))
        return motion.q, motion.dq, motion.ddq


def _repeated(motion: TrueMotion, periods: int) -> TrueMotion:
    step = motion.t[1] - motion.t[0]
    signals = {
        name: np.concatenate([getattr(motion, name)[:-1]] * periods)
        for name in motion.__dataclass_fields__
        if name != "t"
    }
    return TrueMotion(t=step * np.arange(len(signals["q"])), **signals)


def loaded_fit(fit: Fit, payload: float) -> Fit:
    """Return a fit with a payload of known mass (kg), centre and inertia added to the links."""
    links = with_payload(fit.link_parameters, payload)
    parameters = np.concatenate([links, fit.effect_coefficients])
    return replace(fit, parameters=parameters, values=fit.model.base.combination @ parameters)
