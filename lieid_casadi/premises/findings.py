"""What a check of the premises found, and the options that correct all of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any, Literal

import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.premises.correction import Correction, correction_of, options_of
from lieid_casadi.premises.screen import Alternative, Errors
from lieid_casadi.recording import Recording
from lieid_casadi.tables import Table, figures, html, make_table

Verdict = Literal["sound", "doubtful", "wrong"]


@dataclass(frozen=True)
class Finding:
    """A premise that the recording contradicts."""

    premise: str  # name, such as gravity_direction
    joints: tuple[int, ...]  # from 0; at most three
    value: Mapping[str, Any]  # its keys depend on the premise
    sentence: str
    remedy: str  # the option or edit that corrects it
    certain: bool = False  # whether it makes the verdict ``wrong``
    error_before: tuple[float, ...] | None = None  # (n) of the plain fit, N·m
    error_after: tuple[float, ...] | None = None  # (n) the same with the correction
    ratio: float | None = None  # of after to before, on the joints that show it

    def to_dict(self) -> dict[str, Any]:
        """Return the finding for JSON; joints from 1."""
        return {
            "premise": self.premise,
            "joints": [j + 1 for j in self.joints],
            "value": dict(self.value),
            "error_before": None if self.error_before is None else list(self.error_before),
            "error_after": None if self.error_after is None else list(self.error_after),
            "ratio": self.ratio,
            "sentence": self.sentence,
            "remedy": self.remedy,
        }


def fall(before: Array, after: Array, joints: Sequence[int]) -> str:
    """Return the fall of the errors (n,) of some joints in words."""
    numbers = [str(j + 1) for j in joints]
    names = f"joint{'s' if len(numbers) > 1 else ''} {', '.join(numbers)}"
    if len(numbers) > 2 and joints[-1] - joints[0] == len(joints) - 1:
        names = f"joints {numbers[0]}–{numbers[-1]}"
    first, last = (" ".join(f"{x[j]:.3g}" for j in joints) for x in (before, after))
    return f"the error of {names} falls from {first} to {last} N·m"


@dataclass(frozen=True)
class PremiseCheck:
    """Whether robot and recording belong together.

    Attributes
    ----------
    findings : tuple of Finding
        Strongest first.
    checked : tuple of str
        Premises that were tested.
    not_checkable : tuple of (str, str)
        Premises that this recording cannot test, and why.
    """

    findings: tuple[Finding, ...]
    checked: tuple[str, ...]
    not_checkable: tuple[tuple[str, str], ...] = ()

    @property
    def verdict(self) -> Verdict:
        """``wrong`` if a finding is certain, ``doubtful`` with any other, else ``sound``."""
        if any(finding.certain for finding in self.findings):
            return "wrong"
        return "doubtful" if self.findings else "sound"

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        if not self.findings and len(self.not_checkable) > len(self.checked):
            return "No premise was found to be wrong; most could not be checked."
        return {
            "wrong": "Robot and recording do not belong together as they are given.",
            "doubtful": "Robot and recording are consistent, with doubts.",
            "sound": "Robot and recording belong together: no premise was found to be wrong.",
        }[self.verdict]

    @property
    def refusal(self) -> str:
        """What is certainly wrong, as one sentence; empty if nothing is."""
        certain = [finding for finding in self.findings if finding.certain]
        names = ", ".join(finding.premise for finding in certain)
        text = f"robot and recording do not belong together ({names})"
        return f"{text}: {certain[0].sentence}" if certain else ""

    @property
    def table(self) -> Table:
        """Errors without and with each correction."""
        rows = []
        for finding in self.findings:
            before, after = finding.error_before, finding.error_after
            if before is not None:
                rows.append((finding.premise, "as recorded", *map(figures, before)))
            if after is not None:
                rows.append(("", "corrected", *map(figures, after)))
        n = max((len(row) for row in rows), default=2) - 2
        return make_table(
            "Error of a plain fit, N·m",
            ("premise", "", *(f"joint {j + 1}" for j in range(n))),
            rows,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the result for JSON."""
        return {
            "verdict": self.verdict,
            "findings": [finding.to_dict() for finding in self.findings],
            "checked": list(self.checked),
            "not_checkable": [{"premise": p, "why": why} for p, why in self.not_checkable],
        }

    def _repr_html_(self) -> str:
        return html(self.sentence, *(f.sentence for f in self.findings), self.table)


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
