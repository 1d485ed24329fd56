"""Tables V and VI: Eq. 10, Eq. 16 and the model of ref. 6, without load, and Fig. 6."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from arm import PRINTED, Array, N
from lab import CUTOFF, EQ_10, EQ_16, PAPERS_FILTERS, PERIOD, REF_6, Lab
from measure import Errors, errors, noise
from page import COLOURS, INK, Claim, Section, joints, listed, show, table

from lieid_casadi.recording import Recording, process

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MODELS = ("Eq. 10", "Eq. 16", "ref. 6")
BEYOND = {"Eqs. 16, 18, three stages": "Eq. 18 in three stages", "true": "the arm's own numbers"}


def section(lab: Lab) -> Section:
    """Compare the three models on the motion they were identified from and on another."""
    table_5, table_6 = (_compared(lab, r) for r in (lab.training, lab.verification))
    body = (
        "RMS error and correlation coefficient per joint, N·m, through the filters of 6.2 (mean "
        f"of the periods, zero-phase low-pass, here at {CUTOFF:g} Hz, central difference, RLOESS). "
        f"Eq. 10 is `{EQ_10}`, Eq. 16 without load `{EQ_16}`. The paper does not say what its ref. "
        f"6 has for friction: here `{REF_6}` with physically possible links, as that paper's "
        "abstract says. “Noise” is what the torque sensors' noise leaves in the mean of the "
        "periods; the arm's own numbers in the library's model show what these filters and "
        "standstill cost.\n\n"
        "**Table V, identification**\n\n"
        + _table(PRINTED["table_5"], table_5, _floor(lab, lab.training))
        + "\n**Table VI, a new trajectory**\n\n"
        + _table(PRINTED["table_6"], table_6, _floor(lab, lab.verification))
        + "\n**Fig. 6**: measured torque, Eq. 16 and its error on the new trajectory, the mean "
        "period.\n\n![Measured and estimated torques](figures/figure_6.png)\n"
    )
    claims = (
        *_ranking("6.4.1, Table V", PRINTED["table_5"], table_5),
        *_ranking("6.5.1, Table VI", PRINTED["table_6"], table_6),
        _where_slow(table_5["Eq. 16"]),
        _accurate(table_6["Eq. 16"], _floor(lab, lab.verification)),
    )
    pictures = {"figure_6": draw(table_6["Eq. 16"], PERIOD)}
    return Section("Tables V and VI, Fig. 6: models without load", body, claims, pictures)


def _compared(lab: Lab, recording: Recording) -> dict[str, Errors]:
    segments = process(recording, PAPERS_FILTERS)
    found = {name: errors(fit, segments) for name, fit in lab.no_load_fits.items()}
    for name, title in BEYOND.items():
        found[title] = errors(lab.payload_fits[name], segments)
    return found


def _floor(lab: Lab, recording: Recording) -> Array:
    return np.asarray(noise(recording, PAPERS_FILTERS) / np.sqrt(lab.periods))


def _table(printed: dict[str, Any], here: dict[str, Errors], floor: Array) -> str:
    rows: list[list[str | float]] = []
    for name in MODELS:
        rows.append([f"{name}, paper", "RMS", *printed[name]["rms"]])
        rows.append([f"{name}, plant", "RMS", *map(float, here[name].rms), here[name].total])
    rows += [
        [f"{name}, plant", "RMS", *map(float, here[name].rms), here[name].total]
        for name in BEYOND.values()
    ]
    rows.append(["noise, plant", "RMS", *map(float, floor), float(floor.sum())])
    for name in MODELS:
        rows.append([f"{name}, paper", "σ", *printed[name]["correlation"], "–"])
        rows.append([f"{name}, plant", "σ", *map(float, here[name].correlation), "–"])
    return table(["", "", *joints(N), "sum"], rows)


def _ranking(source: str, printed: dict[str, Any], here: dict[str, Errors]) -> list[Claim]:
    """Check “smaller residuals in all the joints”, in the paper's own table and here."""
    claims = []
    for other in ("Eq. 10", "ref. 6"):
        own = np.array(printed[other]["rms"]) - np.array(printed["Eq. 16"]["rms"])
        ours = here[other].rms - here["Eq. 16"].rms
        total = here["Eq. 16"].total / here[other].total - 1.0
        claims += [
            Claim(
                source,
                f"Eq. 16 leaves smaller residuals than {other} in all joints",
                bool(np.all(ours > 0.0)),
                f"larger here on {listed(np.flatnonzero(ours <= 0.0))}; in the paper's own "
                f"table on {listed(np.flatnonzero(own[:-1] <= 0.0))}",
                ranking=True,
            ),
            Claim(
                source,
                f"Eq. 16 leaves less than {other} in sum",
                bool(total < 0.0),
                f"{100 * total:+.1f} % here, {-100 * own[-1] / printed[other]['rms'][-1]:+.1f} % "
                "as printed",
                ranking=True,
            ),
        ]
    return claims


def _where_slow(found: Errors) -> Claim:
    larger = found.slow > found.fast
    return Claim(
        "6.4.1",
        "errors are larger where a joint's velocity is close to zero",
        bool(larger.all()),
        f"RMS of the slowest fifth over that of the rest: "
        f"{', '.join(f'{x:.1f}' for x in found.slow / found.fast)}",
    )


def _accurate(found: Errors, floor: Array) -> Claim:
    ratio = found.rms / floor
    return Claim(
        "6.5.1",
        "the simplified friction describes the dynamics accurately without load",
        bool(np.all(ratio < 1.5)),
        f"its error is {ratio.min():.1f} to {ratio.max():.1f} times the noise that is left",
    )


def draw(found: Errors, seconds: float, title: str = "Eq. 16") -> Figure:
    """Draw measured and estimated torque beside the error, joint by joint."""
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
