"""The whole model under a payload (4.3, Eqs. 16 and 18): torques of the new trajectory."""

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
    "true": "the arm's own numbers",
}
BAR = 1.1


def section(lab: Lab) -> Section:
    """Predict runs with payloads from models that have never been driven with one."""
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
    fastest = np.rad2deg(lab.fastest)
    body = (
        f"The new trajectory, up to {fastest:.0f} °/s, with payloads that were weighed. No model "
        "was identified with a payload but the friction stage with 3.035 kg. RMS error over the "
        f"noise floor (from period to period, {CUTOFF:g} Hz, {_span(floors)} N·m), of samples at "
        f"least {1 / CUTOFF:g} s away from standstill: at rest and at reversals stiction holds "
        f"joints for instants that no filter resolves (up to {100 * left_out.max():.0f} % are left "
        "out).\n\n"
        + table(["payload", "model", *joints(N)], rows)
        + f"\nEq. 18 is `{EQ_18}`. Two stages, as in the paper: links and Eq. 17 from "
        "excitation, then Eq. 18 from single joints at 0.1 to 30 °/s. Its polynomial in velocity "
        "is cubic and knows nothing of the speeds of an excitation, where it runs off. The third "
        "stage identifies links, offset and that polynomial once more from the excitation, with "
        "the load and Stribeck friction of the second taken off.\n"
    )
    return Section("Eqs. 16 and 18 under a payload", body, _claims(worst))


def _span(floors: dict[float, Array]) -> str:
    every = np.array(list(floors.values()))
    return f"{every.min():.3f} to {every.max():.3f}"


def _claims(worst: dict[str, Array]) -> tuple[Claim, ...]:
    def claim(source: str, name: str, text: str, *, within: bool = True) -> Claim:
        above = np.flatnonzero(worst[name] > BAR)
        return Claim(
            source,
            text,
            (len(above) == 0) == within,
            f"{worst[name].min():.2f} to {worst[name].max():.2f} times it, worst of the payloads; "
            f"above {BAR:g} on {listed(above)}",
        )

    near = "within 10 % of the noise floor with payload"
    return (
        claim("bar", "Eqs. 16, 18, three stages", f"Eqs. 16 and 18 (three stages) are {near}"),
        claim("bar", "Eq. 10", f"Eq. 10 is not {near}", within=False),
        claim("4.3", "Eqs. 16, 18, two stages", f"Eqs. 16 and 18 by two stages are {near}"),
    )


if __name__ == "__main__":
    show(section(Lab()))
