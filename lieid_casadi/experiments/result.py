"""Result of an experiment: its rounds, the last diagnosis, and why it ended."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from lieid_casadi.diagnosis import Diagnosis
from lieid_casadi.experiments.purpose import Group, Purpose
from lieid_casadi.plot_style import Axes, Figure, drawing
from lieid_casadi.tables import Table, html, make_table

Stopped = Literal["all_named", "most", "not_separable", "record_failed"]


@dataclass(frozen=True)
class Round:
    """One recording, and what the diagnosis of all recordings up to it showed."""

    number: int  # from 1; 0 for the recordings that were given, without purpose and files
    purpose: Purpose | None
    promise: str  # what the design predicted
    seconds: float  # length of the motion, s
    trajectory: str | None  # file, relative to the folder
    recording: str | None
    verdict: str = ""
    open: tuple[Group, ...] = ()  # effects of each step not named, with those as good
    named: tuple[str, ...] = ()
    sentences: tuple[str, ...] = ()
    error: tuple[float, ...] = ()  # held-out RMS error in motion of the final model, N·m
    first_error: tuple[float, ...] = ()  # the same of the first model
    noise_floor: tuple[float, ...] = ()
    starts: float = 0.0  # when the motion starts in the recording, s
    unseen: tuple[float, ...] = ()  # RMS error in motion of the previous fit here, N·m
    warnings: tuple[str, ...] = ()  # premises, deviations from the trajectory, repeatability
    checked: tuple[str, ...] = ()  # limits that the motion was verified to keep
    unchecked: tuple[str, ...] = ()  # limits that it was not


@dataclass(frozen=True, eq=False)
class Experiment:
    """Result of :func:`lieid_casadi.experiment`."""

    robot: str  #: its name
    rounds: tuple[Round, ...]
    diagnosis: Diagnosis | None = None  #: of all recordings; None if there is none
    #: ``all_named``, ``most`` (recordings), ``not_separable`` or ``record_failed``; None while the
    #: experiment goes on
    stopped: Stopped | None = None
    reason: str = ""  #: one sentence
    folder: Path = Path()
    longest: float = 20.0  #: length of a motion at most, s: that of a standard excitation

    @property
    def recordings(self) -> int:
        """Number of recordings that were made."""
        return sum(each.purpose is not None for each in self.rounds)

    @property
    def seconds(self) -> float:
        """Time of all motions that were recorded, s."""
        return sum(each.seconds for each in self.rounds if each.purpose is not None)

    @property
    def fixed_plan_seconds(self) -> float:
        """Time of as many standard excitations, each of the greatest length, s."""
        return self.recordings * self.longest

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``experiment.json``."""
        return {
            "robot": self.robot,
            "stopped": self.stopped,
            "reason": self.reason,
            "seconds": self.seconds,
            "fixed_plan_seconds": self.fixed_plan_seconds,
            "rounds": [asdict(each) for each in self.rounds],
            "steps": [] if self.diagnosis is None else self.diagnosis.to_dict()["steps"],
            "sentences": [] if self.diagnosis is None else self.diagnosis.sentences,
        }

    @property
    def sentences(self) -> list[str]:
        """Why it ended, and what the last diagnosis found."""
        found = [] if self.diagnosis is None else self.diagnosis.sentences
        count, made = self.recordings, ""
        if count:
            plural = "s" * (count != 1)
            made = (
                f" {count} recording{plural}, {self.seconds:.3g} s of motion; a fixed plan of "
                f"{count} standard excitation{plural} of {self.longest:g} s takes "
                f"{self.fixed_plan_seconds:.3g} s."
            )
        return [self.reason + made, *found]

    def table(self) -> Table:
        """Return one row per round: purpose, open effects and errors."""
        rows = [
            (
                f"{each.number or 'given'}",
                each.purpose.kind if each.purpose else None,
                each.seconds,
                ", ".join(each.named) or None,
                "; ".join(" or ".join(group) for group in each.open) or None,
                _worst(each.first_error, each.noise_floor),
                _worst(each.error, each.noise_floor),
            )
            for each in self.rounds
        ]
        headings = ("round", "for", "s", "named", "open", "first model", "with effects found")
        note = (
            "Errors: held-out error in motion relative to the noise floor, of the joint where it "
            "is largest, on all recordings up to the round."
        )
        return make_table("Rounds; errors relative to the noise", headings, rows, note=note)

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw each joint's held-out error relative to its noise over the rounds; not shown."""
        figure, ax = drawing(ax, 7.0, 4.0)
        names = [str(each.number or "given") for each in self.rounds]
        for j in range(len(self.rounds[0].error) if self.rounds else 0):
            for style, what in (("--", "first_error"), ("-", "error")):
                values = [_ratios(getattr(each, what), each.noise_floor)[j] for each in self.rounds]
                label = f"joint {j + 1}" if what == "error" else None
                ax.plot(names, values, style, marker="o", color=f"C{j % 10}", label=label)
        ax.axhline(1.0, color="black", linewidth=0.8)
        ax.set_xlabel("round")
        ax.set_ylabel("held-out error in motion / noise floor")
        ax.set_title("dashed: first model; solid: with the effects found")
        ax.legend(fontsize="small")
        return figure

    def _repr_html_(self) -> str:
        return html(*self.sentences, self.table())

    def __repr__(self) -> str:
        return f"<Experiment of {self.robot}: {len(self.rounds)} rounds, {self.stopped}>"


def _worst(error: tuple[float, ...], noise: tuple[float, ...]) -> str | None:
    """Return the largest error relative to the noise, and its joint."""
    ratios = _ratios(error, noise)
    if not ratios:
        return None
    worst = max(range(len(ratios)), key=ratios.__getitem__)
    return f"{ratios[worst]:.3g} (joint {worst + 1})"


def _ratios(error: tuple[float, ...], noise: tuple[float, ...]) -> list[float]:
    """Return errors relative to the noise, 0 of a joint at rest."""
    return [e / n if n else 0.0 for e, n in zip(error, noise, strict=True)]
