"""The whole model with a payload (4.3, Eqs. 16 and 18): torques of the new trajectory."""

from __future__ import annotations

import numpy as np
from arm import PAYLOADS, Array, N
from lab import CUTOFF, EQ_18, LINEAR, Lab, loaded_fit
from measure import errors, noise
from page import Claim, Section, joints, listed, show, table

from lieid_casadi.recording import process

TITLES = {
    "Eq. 10": "Eq. 10",
    "Eq. 17": "Eq. 16 without its load part (Eq. 17)",
    "Eqs. 16, 18, two stages": "Eqs. 16 and 18, the paper's two stages",
    "Eqs. 16, 18, three stages": "Eqs. 16 and 18, three stages",
    "Eqs. 16, 18, one fit": "Eqs. 16 and 18, one fit of excitation without load",
    "true": "the arm's own parameters",
}
LIMIT = 1.1  # times the error of the arm's own parameters


def section(lab: Lab) -> Section:
    """Predict runs with payloads by models that were identified without one."""
    floors, ratios, left_out = {}, {}, np.zeros(N)
    for mass, run in lab.loaded.items():
        floors[mass] = noise(run, LINEAR)
        segments = process(run, LINEAR)
        for name, fit in lab.payload_fits.items():
            found = errors(loaded_fit(fit, mass), segments)
            ratios[mass, name] = found.moving / floors[mass]
            left_out = np.maximum(left_out, found.left_out)
    rows: list[list[str | float]] = [
        [f"{mass:g} kg", title, *map(float, ratios[mass, name])]
        for mass in PAYLOADS
        for name, title in TITLES.items()
    ]
    worst = {name: np.max([ratios[mass, name] for mass in PAYLOADS], axis=0) for name in TITLES}
    beyond_true = {
        name: np.max([ratios[mass, name] / ratios[mass, "true"] for mass in PAYLOADS], axis=0)
        for name in TITLES
    }
    fastest = np.rad2deg(lab.fastest)
    body = (
        f"The new trajectory, up to {fastest:.0f} °/s, with payloads of known mass, centre and "
        "inertia. All models were identified without payload, except for the friction stage with "
        "3.035 kg. The numbers are RMS errors divided by the noise floor (torque noise from period "
        f"to period below {CUTOFF:g} Hz, {_span(floors)} N·m), for samples at least "
        f"{1 / CUTOFF:g} s away from standstill. At rest and at reversals joints stick for "
        "instants that the filter does not resolve; up to "
        f"{100 * left_out.max():.0f} % of the samples are left out.\n\n"
        + table(["payload", "model", *joints(N)], rows)
        + f"\nEq. 18 is `{EQ_18}`. The two stages of the paper are links and Eq. 17 from "
        "excitation, then Eq. 18 from single joints at 0.1 to 30 °/s. The cubic polynomial of "
        "Eq. 18 does not extrapolate to the speeds of the excitation. The third stage "
        "(`stages.py`) identifies links, offset and the polynomial again from the "
        "excitation, with the load-dependent and Stribeck friction of the second stage "
        "subtracted.\n"
    )
    return Section("Eqs. 16 and 18 under a payload", body, _claims(beyond_true, worst))


def _span(floors: dict[float, Array]) -> str:
    every = np.array(list(floors.values()))
    return f"{every.min():.3f} to {every.max():.3f}"


def _claims(beyond_true: dict[str, Array], worst: dict[str, Array]) -> tuple[Claim, ...]:
    def claim(source: str, name: str, text: str, *, within: bool = True) -> Claim:
        ratio = beyond_true[name]
        above = np.flatnonzero(ratio > LIMIT)
        return Claim(
            source,
            text,
            (len(above) == 0) == within,
            f"{ratio.min():.2f} to {ratio.max():.2f} times it, largest over the payloads; above "
            f"{LIMIT:g} on {listed(above)}. Over the noise floor: {worst[name].min():.2f} to "
            f"{worst[name].max():.2f}, the arm's own parameters {worst['true'].min():.2f} to "
            f"{worst['true'].max():.2f}",
        )

    near = "within 10 % of the error of the arm's own parameters with payload"
    return (
        claim(
            "this project", "Eqs. 16, 18, three stages", f"Eqs. 16 and 18 (three stages) are {near}"
        ),
        claim("this project", "Eq. 10", f"Eq. 10 is not {near}", within=False),
        claim("4.3", "Eqs. 16, 18, two stages", f"Eqs. 16 and 18 by two stages are {near}"),
    )


if __name__ == "__main__":
    show(section(Lab()))
