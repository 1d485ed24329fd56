"""What is wrong as findings: by how much errors fall, and the options that correct all of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.premises.correction import Correction, correction_of, options_of
from lieid_casadi.premises.findings import Finding, fall
from lieid_casadi.premises.screen import Alternative, Errors
from lieid_casadi.recording import Recording

#: A joint shows a premise if the correction lowers its error to this part.
SHOWS = 0.7


@dataclass(frozen=True, eq=False)
class Wrong:
    """An alternative that holds, with the errors (n,) before and after its correction, N·m."""

    alternative: Alternative
    before: Array
    after: Array
    ratios: Array  # (n,) of the errors relative to the torque
    basis: str = ""  # the fit whose errors these are
    certain: bool = False
    otherwise: str = ""  # the sentence where no error falls
    added: str = ""  # a further sentence

    @classmethod
    def of(
        cls,
        alternative: Alternative,
        before: Errors,
        after: Errors,
        kind: int = 0,
        *,
        certain: bool = False,
    ) -> Wrong:
        """Return an alternative with the errors of the free fit (0) or of the stated one (1)."""
        first = before.rms[kind]
        if alternative.premise == "torque_unit":
            first = first * after.scale / before.scale  # in the same unit
        ratios = (after.relative / before.relative)[kind]
        basis = " (with the stated inertias)" if kind else ""
        return cls(alternative, first, after.rms[kind], ratios, basis, certain)

    def then(self, later: Wrong) -> Wrong:
        """Return an order or a mounting that was found in two steps as one."""
        own = later.alternative
        correction = self.alternative.correction.then(own.correction)
        value, joints = own.value, own.joints
        if "order" in value:
            matrix = correction.position if value["signals"] == "all" else correction.torque
            order = np.argmax(matrix, axis=1)
            value = {**value, "order": (order + 1).tolist()}
            joints = tuple(np.flatnonzero(order != np.arange(len(order)))[:3].tolist())
        return replace(
            later,
            alternative=replace(
                own, what=own.again or own.what, correction=correction, value=value, joints=joints
            ),
            before=self.before,
            ratios=self.ratios * later.ratios,
            certain=self.certain or later.certain,
        )

    def finding(self, remedy: str) -> Finding:
        """Return it as a finding."""
        own, shown = self.alternative, np.flatnonzero(self.ratios < SHOWS)
        text = self.otherwise
        if shown.size or not text:
            shown = shown if shown.size else np.array([int(np.argmin(self.ratios))])
            text = f"{own.what} {fall(self.before, self.after, shown.tolist())}{self.basis}."
        return Finding(
            own.premise,
            own.joints or most_shown(self.ratios),
            own.value,
            text.replace("{}", remedy) + self.added,
            remedy,
            certain=self.certain,
            error_before=rounded(self.before),
            error_after=rounded(self.after),
            ratio=float(f"{mean_ratio(self.ratios):.3g}"),
        )


def findings_of(found: Sequence[Wrong], recording: Recording) -> list[Finding]:
    """Return what was found, each after the corrections before it, as findings.

    Their remedies are the options that correct the recording when they are given together, in
    place of those that it was read with, as far as options can state that.
    """
    n, before = recording.n, recording.corrections
    steps = [correction_of([text], n) for text in before]
    steps += [wrong.alternative.correction for wrong in found]
    total = options_of(reduce(Correction.then, steps, Correction.none(n)))
    joined = dict[tuple[object, ...], Wrong]()
    for wrong in found:
        own = wrong.alternative
        mounted = own.premise == "gravity_direction"
        key = (own.premise, () if mounted else own.value.get("signals", own.joints))
        first = joined.pop(key, None)
        joined[key] = wrong if first is None else first.then(wrong)
    made = []
    for wrong in joined.values():
        remedy, read = wrong.alternative.remedy, ""
        if not remedy:
            options = options_of(wrong.alternative.correction) or {}
            names = [*(x for x in options if options[x]), *(text.split()[0] for text in before)]
            stated = {name: (total or options)[name] for name in names}
            if not any(stated.values()):
                if not before:
                    continue  # a later correction takes it back
                # options that change nothing replace those before
                stated = {"": f"--joint-order {' '.join(str(j + 1) for j in range(n))}"}
            remedy = " ".join(text for text in in_columns_of(recording, stated).values() if text)
            if before:
                read = f" The recording was read with {' '.join(before)}, which this replaces."
        finding = wrong.finding(remedy)
        made.append(replace(finding, sentence=finding.sentence + read))
    return made


def in_columns_of(recording: Recording, options: Mapping[str, str]) -> dict[str, str]:
    """Return options that go with the columns and torque constants a recording was read with."""
    made = dict(options)
    columns, constants = (
        made.get(name, "").partition(" ")[2] for name in ("--columns", "--torque-constants")
    )
    if columns and constants and recording.torque_constants is not None:
        products = np.array(constants.split(","), dtype=float) * recording.torque_constants
        numbers = ",".join(f"{x:.4g}" for x in products)
        return made | {"--columns": "", "--torque-constants": f"--torque-constants {numbers}"}
    if columns and recording.columns:
        stated, new = (
            dict(text.split("=", 1) for text in texts)
            for texts in (recording.columns, columns.split(","))
        )
        kept = {n: c for n, c in stated.items() if n not in new and n not in new.values()}
        every = kept | {name: stated.get(column, column) for name, column in new.items()}
        made["--columns"] = f"--columns {','.join('='.join(pair) for pair in every.items())}"
    return made


def mean_ratio(ratios: Array) -> float:
    """Return the mean ratio on the joints that show a premise; 1 if none does."""
    shown = ratios[ratios < SHOWS]
    return float(np.exp(np.mean(np.log(shown)))) if shown.size else 1.0


def most_shown(ratios: Array) -> tuple[int, ...]:
    """Return up to three joints on which the error falls most."""
    return tuple(sorted(int(j) for j in np.argsort(ratios)[:3] if ratios[j] < SHOWS))


def rounded(values: Array) -> tuple[float, ...]:
    """Return numbers with four digits."""
    return tuple(float(f"{x:.4g}") for x in values)
