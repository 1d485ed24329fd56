"""Tables V and VI: Eq. 10, Eq. 16 and the model of ref. 6 without load; Figs. 4 and 6."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from arm import PRINTED, Array, N
from filters import paper_filtered
from lab import CUTOFF, EQ_10, EQ_16, PERIOD, REF_6, Lab
from measure import Errors, difference, errors
from page import COLOURS, INK, Claim, Section, joints, listed, show, table

from lieid_casadi.recording import Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MODELS = ("Eq. 10", "Eq. 16", "ref. 6")
REFERENCES = {
    "Eqs. 16, 18, three stages": "Eq. 18 in three stages",
    "true": "the arm's own parameters",
}


def section(lab: Lab) -> Section:
    """Compare the three models on the trajectory of the identification and on another one."""
    table_5, table_6 = (_errors(lab, r) for r in (lab.training, lab.verification))
    noise_5, noise_6 = (_noise(lab, k) for k in (0, 1))
    body = (
        "RMS error and correlation coefficient per joint, N·m, through the filters of section 6.2 "
        f"(mean of the periods, zero-phase low-pass at {CUTOFF:g} Hz, central difference, RLOESS; "
        f"the paper does not state the cut-off). Eq. 10 is `{EQ_10}`, Eq. 16 without load is "
        f"`{EQ_16}`. The paper does not state the friction model of its ref. 6. It must contain an "
        "offset: without one, the offset of joint 2 in Table IV (−0.2567 N·m) alone would be more "
        "than the error printed for ref. 6 (0.2282 N·m). Ref. 6 is therefore "
        f"`{REF_6}` with physically consistent links, as its abstract states. “Noise” is the RMS "
        "difference between two realizations of the noise after the same filters, divided by √2. "
        "“The "
        "arm's own parameters” are the true parameters in the library's model; their error is "
        "due to the filters, to velocity noise and to friction at standstill, and no model can be "
        "expected to have a smaller one.\n\n"
        "**Table V, identification**\n\n"
        "Table V compares nested models on the recording from which they were identified: Eq. 16 "
        "contains Eq. 10, so that a smaller error there is expected of any further terms and is no "
        "evidence for them. Table VI, a new trajectory, is.\n\n"
        + _table(PRINTED["table_5"], table_5, noise_5)
        + "\n**Fig. 4**: measured torque, Eq. 16 and its error on the identification trajectory, "
        "mean period.\n\n![Measured and estimated torques, identification]"
        "(figures/figure_4.png)\n\n"
        "**Table VI, a new trajectory**\n\n"
        + _table(PRINTED["table_6"], table_6, noise_6)
        + "\n**Fig. 6**: measured torque, Eq. 16 and its error on the new trajectory, mean "
        "period.\n\n![Measured and estimated torques, verification](figures/figure_6.png)\n"
    )
    claims = (
        *ranking("6.4.1, Table V", PRINTED["table_5"], table_5),
        *ranking("6.5.1, Table VI", PRINTED["table_6"], table_6),
        _superimposing(table_5["Eq. 16"]),
        _where_slow(table_5["Eq. 16"]),
        _accurate(table_6["Eq. 16"], table_6[REFERENCES["true"]]),
    )
    figures = {
        "figure_4": draw(table_5["Eq. 16"], PERIOD),
        "figure_6": draw(table_6["Eq. 16"], PERIOD),
    }
    return Section("Tables V and VI, Figs. 4 and 6: models without load", body, claims, figures)


def _errors(lab: Lab, recording: Recording) -> dict[str, Errors]:
    segments = paper_filtered(recording, CUTOFF)
    found = {name: errors(fit, segments) for name, fit in lab.no_load_fits.items()}
    for name, title in REFERENCES.items():
        found[title] = errors(lab.payload_fits[name], segments)
    return found


def _noise(lab: Lab, which: int) -> Array:
    """Return the RMS (n,) of the torque noise after the filters, N·m.

    RLOESS is not linear, so that two noisy recordings are compared.
    """
    one, other = (
        np.concatenate([s.filter(s.tau) for s in paper_filtered(recording, CUTOFF)])
        for recording in ((lab.training, lab.verification)[which], lab.repetitions[which])
    )
    return np.asarray(np.sqrt(0.5 * np.mean((one - other) ** 2, axis=0)))


def _table(printed: dict[str, Any], here: dict[str, Errors], noise: Array) -> str:
    rows: list[list[str | float]] = []
    for name in MODELS:
        rows.append([f"{name}, paper", "RMS", *printed[name]["rms"]])
        rows.append([f"{name}, plant", "RMS", *map(float, here[name].rms), here[name].total])
    rows += [
        [f"{name}, plant", "RMS", *map(float, here[name].rms), here[name].total]
        for name in REFERENCES.values()
    ]
    rows.append(["noise, plant", "RMS", *map(float, noise), float(noise.sum())])
    for name in MODELS:
        rows.append([f"{name}, paper", "σ", *printed[name]["correlation"], "–"])
        rows.append([f"{name}, plant", "σ", *map(float, here[name].correlation), "–"])
    return table(["", "", *joints(N), "sum"], rows)


def ranking(source: str, printed: dict[str, Any], here: dict[str, Errors]) -> list[Claim]:
    """Check “smaller residuals in all the joints”, in the paper's own table and here."""
    claims = []
    for other in ("Eq. 10", "ref. 6"):
        own = np.array(printed[other]["rms"]) - np.array(printed["Eq. 16"]["rms"])
        change = difference(here["Eq. 16"], here[other])
        low, high = (100.0 * x / here[other].total for x in change.total_interval)
        claims += [
            Claim(
                source,
                f"Eq. 16 has smaller residuals than {other} on all joints",
                change.all_smaller,
                f"significantly smaller here on {listed(change.smaller)}, larger on "
                f"{listed(change.larger)}; larger in the paper's own table on "
                f"{listed(np.flatnonzero(own[:-1] <= 0.0))}",
                ranking=True,
            ),
            Claim(
                source,
                f"the sum of the RMS errors of Eq. 16 is smaller than that of {other}",
                change.total_smaller,
                f"{100 * change.total / here[other].total:+.1f} % here (95 % interval {low:+.1f} "
                f"to {high:+.1f} %), {-100 * own[-1] / printed[other]['rms'][-1]:+.1f} % as "
                "printed",
                ranking=True,
            ),
        ]
    return claims


def _superimposing(found: Errors) -> Claim:
    lowest = found.correlation.min()
    return Claim(
        "6.4.1, Fig. 4",
        "the estimated torques of joints 2 to 4 and 6 almost coincide with the measured ones",
        bool(found.correlation[[1, 2, 3, 5]].min() >= 0.997),
        "correlation coefficients "
        f"{', '.join(f'{x:.4f}' for x in found.correlation[[1, 2, 3, 5]])} (paper: 0.9973 or "
        f"more); lowest of all joints {lowest:.4f}",
    )


def _where_slow(found: Errors) -> Claim:
    return Claim(
        "6.4.1",
        "errors are larger where the velocity of a joint is close to zero",
        bool(np.all(found.slow > found.fast)),
        "RMS of the slowest fifth of the samples over that of the others: "
        f"{', '.join(f'{x:.1f}' for x in found.slow / found.fast)}",
    )


def _accurate(found: Errors, true: Errors) -> Claim:
    ratio = found.rms / true.rms
    return Claim(
        "6.5.1",
        "the simplified friction describes the dynamics accurately without load",
        None,
        f"the paper states no limit; the error is {ratio.min():.1f} to {ratio.max():.1f} times "
        "that of the arm's own parameters through the same filters",
    )


def draw(found: Errors, seconds: float, title: str = "Eq. 16") -> Figure:
    """Draw measured and estimated torque, and the error, for each joint."""
    from matplotlib import pyplot as plt

    n = found.measured.shape[1]
    figure, axes = plt.subplots(
        n, 2, figsize=(9.0, 1.25 * n + 0.8), sharex=True, layout="constrained"
    )
    shown = found.time - found.time[0] <= seconds
    time = found.time[shown] - found.time[0]
    for j, (torque, error) in enumerate(axes):
        measured, predicted = found.measured[shown, j], found.predicted[shown, j]
        torque.plot(time, measured, color=INK, lw=1.8)
        torque.plot(time, predicted, color=COLOURS[2], lw=1.1, ls="--")
        error.plot(time, measured - predicted, color=COLOURS[1], lw=0.8)
        torque.set_ylabel(f"joint {j + 1}", fontsize=9)
        for axis in (torque, error):
            axis.grid(alpha=0.25)
            axis.tick_params(labelsize=8)
    axes[0, 0].set_title(f"measured (dark) and {title} (dashed), N·m", loc="left", fontsize=9)
    axes[0, 1].set_title("measured − estimated, N·m", loc="left", fontsize=9)
    for axis in axes[-1]:
        axis.set_xlabel("s", fontsize=9)
    return figure


if __name__ == "__main__":
    show(section(Lab()))
