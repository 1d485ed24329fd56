"""Checks of physical consistency, and the increase in error that it costs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.compiled import Compiled
from lieid_casadi.json_numbers import number_or_none
from lieid_casadi.robot.inertia import pseudo_inertia
from lieid_casadi.robot.robot import Robot

ROUNDING = 1e-8  # of the largest friction: the solver's tolerance


@dataclass(frozen=True, eq=False)
class Certificate:
    """Checks of identified parameters, independent of the solver.

    ``rms`` and ``rms_wls`` are the training errors of these parameters and of weighted least
    squares; ``gravity`` and ``stated_gravity`` the RMS of the gravity load in the recordings, of
    these parameters and of the stated inertias, N·m; None in older files, or without inertias.
    """

    regularization: float  # weight λ of the divergence from the reference bodies
    regularization_source: str  # ``cross-validation`` or ``given``
    pseudo_inertia_eigenvalue: Array  # (n,): smallest of each link (kg·m², kg·m and kg mixed)
    mass_matrix_eigenvalue: float  # smallest of the rigid M(q), without armature, over the poses
    poses: int  # random ones within the joint limits
    least_dissipation: float  # smallest sgn(q̇)·τ_f on a grid, N·m; infinite without friction
    divergence: Array  # (n,): entropic, of each link from its reference body; 0 if they are equal
    rms: Array  # (n,): N·m
    rms_wls: Array  # (n,): N·m
    gravity: Array | None = None  # (n,): N·m
    stated_gravity: Array | None = None  # (n,): N·m

    @property
    def holds(self) -> bool:
        """Whether inertias and M(q) are positive definite and friction is dissipative."""
        return bool(
            self.pseudo_inertia_eigenvalue.min() > 0.0
            and self.mass_matrix_eigenvalue > 0.0
            and self.least_dissipation >= 0.0
        )

    @property
    def cost(self) -> Array:
        """Relative increase of the training error per joint (n,) over weighted least squares."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            return np.asarray(self.rms / self.rms_wls - 1.0)

    def summary(self) -> str:
        """Return the result of the checks and the increase in error as text."""
        costs = " ".join(f"{100.0 * x:+.1f}" for x in self.cost)
        load = ""
        if self.gravity is not None:
            load = f" Gravity load that the recordings showed, RMS per joint: {_row(self.gravity)}"
            stated = self.stated_gravity
            load += f" N·m{'' if stated is None else f' (stated inertias: {_row(stated)})'}."
        friction = "" if np.isinf(self.least_dissipation) else ", friction is dissipative"
        found = (
            f"every link's pseudo-inertia is positive definite (smallest eigenvalue "
            f"{self.pseudo_inertia_eigenvalue.min():.2g}), M(q) is positive definite at "
            f"{self.poses} random poses ({self.mass_matrix_eigenvalue:.2g}){friction}"
        )
        return (
            f"Physically consistent: {found if self.holds else 'no'}. Change of the RMS training "
            f"error against weighted least squares, per joint: {costs} %. Regularization "
            f"{self.regularization:.2g} ({self.regularization_source}).{load}"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        values = {
            name: value.tolist() if isinstance(value, np.ndarray) else value
            for name, value in vars(self).items()
        }
        return values | {"least_dissipation": number_or_none(self.least_dissipation)}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Certificate:
        """Return the certificate of `to_dict`'s data."""
        values = dict[str, Any](data)
        values |= {n: np.array(x, float) for n, x in data.items() if isinstance(x, list)}
        if values["least_dissipation"] is None:
            values["least_dissipation"] = np.inf
        return cls(**values)


def _row(values: Array) -> str:
    return " ".join(f"{x:.3g}" for x in values)


def pseudo_inertia_eigenvalues(links: Array) -> Array:
    """Return the smallest eigenvalue of each link's pseudo-inertia (n,) of (10 n,)."""
    bodies = np.array([pseudo_inertia(link) for link in links.reshape(-1, 10)])
    return np.asarray(np.linalg.eigvalsh(bodies)[:, 0])


def least_mass_matrix_eigenvalue(
    compiled: Compiled, links: Array, *, poses: int, seed: int
) -> float:
    """Return the smallest eigenvalue of the rigid M(q) over random poses within the limits."""
    random = np.random.default_rng(seed)
    lower, upper = position_range(compiled.model.robot)
    q = random.uniform(lower, upper, (poses, compiled.n))
    return float(np.linalg.eigvalsh(compiled.mass_matrix(q, links)).min())


def least_dissipation(friction: Array, coefficients: Array) -> float:
    """Return the smallest friction of the rows, N·m; 0 if negative by rounding only."""
    torque = friction @ coefficients
    if not len(torque):
        return float("inf")
    least = float(torque.min())
    return max(least, 0.0) if least > -ROUNDING * np.abs(torque).max() else least


def position_range(robot: Robot) -> tuple[Array, Array]:
    """Return lower and upper positions (n,); ±π, or ±1 m, where no limits are stated."""
    reach = np.array([np.pi if joint.revolute else 1.0 for joint in robot.joints])
    lower, upper = robot.limit("position_lower"), robot.limit("position_upper")
    return np.where(np.isnan(lower), -reach, lower), np.where(np.isnan(upper), reach, upper)
