"""Review of accepted effects: what the noise of the last model explains is not named."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from lieid_casadi.diagnosis.review import review


class Ripple:
    delays_torque = False


@dataclass(frozen=True)
class Placed:
    label: str
    effect = Ripple


@dataclass
class Chosen:
    placement: Placed


@dataclass
class Accepted:
    """An accepted effect: the error falls from 1 to ``after`` on its joint."""

    name: str
    after: float
    significance: float
    joint: int = 0
    fits: bool = True

    @property
    def candidate(self):
        return Chosen(Placed(self.name))

    @property
    def errors(self):
        return np.array([[1.0], [self.after]])


@dataclass
class Problem:
    accepted: list
    removed: dict = field(default_factory=dict)

    def in_last_model(self, effect):
        return effect, "" if effect.fits else "the held-out error rises"

    def insignificant(self, p):
        return f"not significant: p = {p:g}" if p > 1e-3 else ""

    def exchange_rival(self):
        return False

    def remove(self, placements, reason):
        labels = [placement.label for placement in placements]
        self.accepted = [a for a in self.accepted if a.name not in labels]
        self.removed |= dict.fromkeys(labels, reason)


@pytest.fixture(autouse=True)
def evidence_is_given(monkeypatch):
    monkeypatch.setattr(review, "_with_significance", lambda problem, effects: list(effects))
    monkeypatch.setattr(review, "_with_alternatives", lambda effect, problem: effect)


def test_effects_that_the_last_noise_explains_are_removed_with_the_reason():
    problem = Problem([Accepted("ripple", 0.93, 0.07), Accepted("load", 0.1, 1e-9)])
    review.review(problem)
    assert [a.name for a in problem.accepted] == ["load"]
    assert problem.removed == {"ripple": "in the final model not significant: p = 0.07"}


def test_of_several_the_one_that_explains_least_is_removed_first():
    problem = Problem([Accepted("a", 0.5, 0.5), Accepted("b", 0.9, 0.02), Accepted("c", 0.1, 0.0)])
    review.review(problem)
    assert list(problem.removed) == ["b", "a"]
    assert [a.name for a in problem.accepted] == ["c"]


def test_failed_tests_are_removed_before_evidence_is_judged():
    problem = Problem([Accepted("a", 0.9, 0.02), Accepted("b", 0.5, 0.0, fits=False)])
    review.review(problem)
    assert list(problem.removed) == ["b", "a"]
    assert not problem.accepted
