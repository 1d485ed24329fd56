"""Fig. 7: four friction models with three payloads that were not used to fit them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from arm import HEAVIEST, PAYLOADS, Array, N
from lab import Lab
from measure import smaller
from page import COLOURS, Claim, Section, joints, show, table

from lieid_casadi.friction_curves import FrictionCurve, FrictionFit, fit_friction

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MODELS = {
    "paper": "Eq. 8",
    "gao2017": "ref. 7",
    "he2021": "ref. 14",
    "madsen2020": "ref. 25",
}
EFFECTS = {  # the paper's model, and those of the literature, as far as they were available
    "paper": "viscous,viscous_polynomial,stribeck/two_width,load_friction/paper",
    "gao2017": "coulomb,stribeck,load_friction,viscous",
    "he2021": "coulomb,viscous,stribeck,load_friction/stribeck",
    "madsen2020": "viscous,viscous_polynomial,presliding/square",
}
NOTES = {
    "gao2017": "Gao et al., IROS 2017: published as one formula of velocity, temperature and load, "
    "whose terms were not available. Interpreted here as a Stribeck curve, viscous friction and "
    "dry friction in proportion to |load|, at constant temperature",
    "he2021": "He et al., ROBIO 2021: published as a Stribeck curve at low speed whose depth "
    "depends on the load; its terms were not available. Interpreted here as the load-dependent "
    "part of Bittencourt et al., IROS 2010, with exponent 2",
    "madsen2020": "Madsen et al., Control Engineering Practice 2020, in the form of the authors' "
    "program AURT, (F_c + F_cl·τ²)·h + powers of velocity, where h is the sign. Interpreted here "
    "as one Dahl element for h, powers 1 to 3, and no joint flexibility",
}
EXAMPLE = 2  # joint 3, the paper's example


def section(lab: Lab) -> Section:
    """Fit all models to friction with the heaviest payload and predict it with the others."""
    fits = {
        model: [lab.friction[j] if model == "paper" else fit_friction(lab.curves[j], EFFECTS[model])
                for j in range(N)]
        for model in MODELS
    }  # fmt: skip
    found = {
        model: np.array(
            [
                [
                    prediction_error(fits[model][j], lab.verification_curves[j][mass])
                    for j in range(N)
                ]
                for mass in PAYLOADS
            ]
        )
        for model in MODELS
    }
    rows: list[list[str | float]] = [
        [f"{mass:g} kg", title, *map(float, found[model][k])]
        for k, mass in enumerate(PAYLOADS)
        for model, title in MODELS.items()
    ]
    notes = "\n".join(f"- {MODELS[m]}: {note}." for m, note in NOTES.items())
    body = (
        f"Models fitted to the friction with {HEAVIEST:g} kg (Fig. 5), compared with friction "
        "measured with the other payloads: RMS error, N·m. The paper shows its numbers only in a "
        "figure. The models of refs. 7, 14 and 25 are reconstructions from published abstracts "
        f"and code:\n\n{notes}\n\n"
        + table(["payload", "model", *joints(N)], rows)
        + "\n![RMS error of four friction models](figures/figure_7.png)\n"
    )
    best = np.array(
        [
            [_smallest(fits, j, lab.verification_curves[j][mass]) for j in range(N)]
            for mass in PAYLOADS
        ],
        dtype=float,
    )  # 1, 0, or NaN where it is not significant
    margin = np.stack([found[m] for m in list(MODELS)[1:]]).min(axis=0) / found["paper"]
    claims = (
        Claim(
            "6.5.2",
            "Eq. 8 has the smallest error with every payload on joint 3",
            _all(best[:, EXAMPLE]),
            f"the best other model has {margin[:, EXAMPLE].min():.1f} to "
            f"{margin[:, EXAMPLE].max():.1f} times its error",
            ranking=True,
        ),
        Claim(
            "6.5.2",
            "Eq. 8 has the smallest error with every payload on all seven joints",
            _all(best),
            f"significantly smallest in {int(np.nansum(best))} of {best.size} cases; the best "
            f"other model has {margin.min():.1f} to {margin.max():.1f} times its error",
            ranking=True,
        ),
    )
    return Section(
        "Fig. 7: friction models with other payloads", body, claims, {"figure_7": draw(found)}
    )


def prediction_errors(fit: FrictionFit, curve: FrictionCurve) -> Array:
    """Return measured − predicted friction (G,) at the points of another curve, N·m."""
    return np.asarray(curve.friction - fit.friction(curve.speed, load=curve.load))


def prediction_error(fit: FrictionFit, curve: FrictionCurve) -> float:
    """Return the RMS of measured − predicted friction over the points of another curve, N·m."""
    return float(np.sqrt(np.mean(prediction_errors(fit, curve) ** 2)))


def smallest(own: Array, others: list[Array]) -> bool | None:
    """Return whether errors (G,) have the smallest RMS; None if that is not significant."""
    verdicts = [smaller(own, other) for other in others]
    return False if False in verdicts else None if None in verdicts else True


def _smallest(fits: dict[str, list[FrictionFit]], joint: int, curve: FrictionCurve) -> bool | None:
    own, *others = (prediction_errors(fits[model][joint], curve) for model in MODELS)
    return smallest(own, others)


def _all(best: Array) -> bool | None:
    if np.any(best == 0.0):
        return False
    return None if np.any(np.isnan(best)) else True


def draw(found: dict[str, np.ndarray]) -> Figure:
    """Draw bars per joint and model, with one panel per payload."""
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(
        1, len(PAYLOADS), figsize=(11.0, 3.6), sharey=True, layout="constrained"
    )
    width = 0.8 / len(MODELS)
    for k, (axis, mass) in enumerate(zip(axes, PAYLOADS, strict=True)):
        for m, (model, title) in enumerate(MODELS.items()):
            place = np.arange(1, N + 1) + (m - 1.5) * width
            axis.bar(place, 1e3 * found[model][k], width, color=COLOURS[m], label=title)
        axis.set_yscale("log")
        axis.set_title(f"{mass:g} kg", loc="left", fontsize=10)
        axis.set_xlabel("joint")
        axis.set_xticks(range(1, N + 1))
        axis.grid(axis="y", alpha=0.25)
    axes[0].set_ylabel("RMS error, mN·m")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, frameon=False)
    return figure


if __name__ == "__main__":
    show(section(Lab()))
