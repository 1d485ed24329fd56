"""The same tables from recordings of a real arm, as far as they allow."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from figure_5 import draw_curve
from figure_7 import EFFECTS, MODELS, prediction_errors, smallest
from lab import EQ_10, EQ_16, EQ_18, REF_6
from measure import Errors, difference, errors
from page import Claim, Section, joints, listed, show, table
from tables_5_6 import draw

import lieid_casadi as lieid
from lieid_casadi.friction_curves import FrictionFit, fit_friction, friction_curve
from lieid_casadi.recording import Processing, Recording, process

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from lieid_casadi.friction_curves import FrictionCurve

UR10E_GAINS = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)  # N·m/A, with the recordings
CUTOFF = Processing(cutoff=7.0)
SHOWN_SECONDS = 15.0


@dataclass(frozen=True)
class Recorded:
    """Recordings of an arm: for identification, for tests, and of one joint alone.

    ``joint`` counts from 0; ``constants`` (N·m/A) turn currents into torques.
    """

    name: str
    robot: Path
    train: tuple[Path, ...]
    test: tuple[Path, ...]
    alone: Path | None = None
    joint: int = 0
    constants: tuple[float, ...] | None = None

    def load(self, path: Path) -> Recording:
        """Read one recording."""
        return Recording.load(path, torque_constants=self.constants)


def ur10e() -> Recorded | None:
    """Return the UR10e under LIEID_RECORDINGS, or None if it is not there."""
    stated = os.environ.get("LIEID_RECORDINGS")
    folder = Path(stated) / "ur10e" if stated else None
    if folder is None or not folder.is_dir():
        return None
    return Recorded(
        "UR10e",
        folder / "ur10e.urdf",
        tuple(folder / f"excitation_{k}s.csv.gz" for k in (30, 50)),
        (folder / "excitation_14_harmonics.csv.gz",),
        folder / "joint_2_alone_currents.csv.gz",
        1,
        UR10E_GAINS,
    )


def section(recorded: Recorded | None) -> Section:
    """Make Tables V and VI and Figs. 5 to 7 from recordings."""
    if recorded is None:
        return Section(
            "A real arm",
            "No recordings of a real arm were available when this page was made, so this part is "
            "left out. Set `LIEID_RECORDINGS` to the folder that contains `ur10e/`, or give "
            "`--robot`, `--train` and `--test`.",
        )
    robot = lieid.Robot.load(recorded.robot)
    train, test = ([recorded.load(p) for p in paths] for paths in (recorded.train, recorded.test))
    fits = {
        title: lieid.identify(
            lieid.Model(robot, effects=f"armature,{effects}"),
            train,
            method=method,
            processing=CUTOFF,
        )
        for title, effects, method in (
            ("Eq. 10", EQ_10, "wls"),
            ("Eq. 16", EQ_16, "wls"),
            ("ref. 6", REF_6, "feasible"),
            ("Eq. 18", f"{EQ_18},offset", "wls"),
        )
    }
    trained, tested = (
        {k: errors(fit, s) for k, fit in fits.items()}
        for s in (process(train, CUTOFF), process(test, CUTOFF))
    )
    body = (
        f"{recorded.name}, torque from motor currents, low-pass {CUTOFF.cutoff:g} Hz. There are no "
        "runs with a payload, no temperatures and no true parameters, so that Table IV is left "
        "out and section 6.5.2 is limited to one joint. The models are those above with "
        "`armature`, because torques from motor currents include the rotor inertia; Eq. 18 is "
        "fitted to the excitation in one step.\n\n"
        f"**Identification** ({', '.join(_stem(p) for p in recorded.train)}) and **another "
        f"trajectory** ({', '.join(_stem(p) for p in recorded.test)})\n\n"
        + table(["", "", *joints(robot.n), "sum"], [*_rows(trained, "V"), *_rows(tested, "VI")])
        + "\n![Measured and estimated torques](figures/recorded_6.png)\n"
    )
    claims = [
        *_claims(recorded.name, trained, "as Table V"),
        *_claims(recorded.name, tested, "as Table VI"),
    ]
    pictures = {"recorded_6": draw(tested["Eq. 16"], SHOWN_SECONDS)}
    if recorded.alone is not None:
        text, claim, picture = _friction(recorded, fits["Eq. 18"])
        body += text
        claims.append(claim)
        pictures["recorded_5"] = picture
    return Section(f"A real arm: {recorded.name}", body, tuple(claims), pictures)


def _stem(path: Path) -> str:
    return f"`{path.name.split('.')[0]}`"


def _rows(found: dict[str, Errors], name: str) -> list[list[str | float]]:
    rows: list[list[str | float]] = [
        [f"as Table {name}, {title}", "RMS", *map(float, e.rms), e.total]
        for title, e in found.items()
    ]
    return rows + [
        [f"as Table {name}, {title}", "σ", *map(float, e.correlation), "–"]
        for title, e in found.items()
    ]


def _claims(arm: str, found: dict[str, Errors], where: str) -> list[Claim]:
    claims = []
    for better, other in (("Eq. 16", "Eq. 10"), ("Eq. 16", "ref. 6"), ("Eq. 18", "Eq. 16")):
        change = difference(found[better], found[other])
        total = change.total / found[other].total
        claims.append(
            Claim(
                f"{arm}, {where}",
                f"{better} has smaller residuals than {other} on all joints",
                change.all_smaller,
                f"significantly smaller on {listed(change.smaller)}, larger on "
                f"{listed(change.larger)}; sum {100 * total:+.1f} %",
                ranking=True,
            )
        )
    return claims


def _friction(recorded: Recorded, whole: lieid.Fit) -> tuple[str, Claim, Figure]:
    """Fit the four models to the first half of one joint's motion and test on the second."""
    assert recorded.alone is not None
    alone = recorded.load(recorded.alone)
    middle = float(0.5 * (alone.t[0] + alone.t[-1]))
    first, second = (
        friction_curve(whole, part, recorded.joint, processing=CUTOFF)
        for part in (alone.cut(None, middle), alone.cut(middle, None))
    )
    fits = {model: fit_friction(first, EFFECTS[model]) for model in MODELS}
    residuals = {model: prediction_errors(fit, second) for model, fit in fits.items()}
    found = {model: float(np.sqrt(np.mean(e**2))) for model, e in residuals.items()}
    rows: list[list[str | float]] = [
        [title, fits[m].rms, fits[m].correlation, found[m]] for m, title in MODELS.items()
    ]
    others = [found[m] for m in list(MODELS)[1:]]
    text = (
        f"\n**As Figs. 5 and 7**: joint {recorded.joint + 1} alone, forward and "
        f"backward ({_stem(recorded.alone)}), {_range(first)}; models fitted to the first half of "
        "the recording and tested on the second, N·m.\n\n"
        + table(["model", "RMS, fitted", "σ, fitted", "RMS, second half"], rows)
        + "\n![Friction over speed, coloured by load](figures/recorded_5.png)\n"
    )
    claim = Claim(
        f"{recorded.name}, as 6.5.2",
        "Eq. 8 has the smallest error of the four friction models on other motion",
        smallest(residuals["paper"], [residuals[m] for m in list(MODELS)[1:]]),
        f"{found['paper']:.3f} N·m; the others {', '.join(f'{x:.3f}' for x in others)}",
        ranking=True,
    )
    return text, claim, _draw(fits["paper"], fits["he2021"])


def _range(curve: FrictionCurve) -> str:
    return (
        f"{np.rad2deg(curve.speed.min()):.2g} to {np.rad2deg(curve.speed.max()):.3g} °/s under "
        f"{curve.load.min():.2g} to {curve.load.max():.3g} N·m"
    )


def _draw(*fits: FrictionFit) -> Figure:
    from matplotlib import colormaps
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, len(fits), figsize=(8.5, 3.4), sharey=True, layout="constrained")
    curve = fits[0].curve
    speed = np.rad2deg(np.geomspace(curve.speed.min(), curve.speed.max(), 80))
    for axis, fit, title in zip(axes, fits, (MODELS["paper"], MODELS["he2021"]), strict=True):
        draw_curve(axis, fit, speed, colormaps["viridis"])
        axis.set_title(f"{title}, {axis.get_title(loc='left')}", loc="left", fontsize=9)
    figure.supxlabel("speed, °/s (bright: large load)", fontsize=9)
    figure.supylabel("friction, N·m", fontsize=9)
    return figure


if __name__ == "__main__":
    show(section(ur10e()))
