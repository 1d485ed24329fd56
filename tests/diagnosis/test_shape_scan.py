"""Scan of a shape parameter over its range: where it finds peaks, and what it evaluates again."""

import numpy as np
import pytest

import lieid_casadi as lieid
from lieid_casadi.diagnosis.options import DiagnosisOptions
from lieid_casadi.diagnosis.screening import shape_scan
from lieid_casadi.diagnosis.screening.candidate_evaluation import ColumnStore
from lieid_casadi.diagnosis.screening.effect_columns import EffectFunction, SegmentSignals
from lieid_casadi.effects.registry import make
from lieid_casadi.identification.uncertainty.noise_model import Runs
from lieid_casadi.recording import Processing, process

OPTIONS = DiagnosisOptions()
WAVES = 41.0


@pytest.fixture(scope="module")
def signals():
    robot, t = lieid.robots.two_link(), np.arange(0.0, 10.0, 0.01)
    q = np.column_stack([np.sin(t), 0.5 * np.cos(2.0 * t)])
    recording = lieid.Recording.from_arrays(t, q, tau=np.cos(q) + 0.1 * q)
    segments = process(recording, Processing(cutoff=20.0))
    fit = lieid.identify(lieid.Model(robot, "viscous"), recording)
    return [SegmentSignals.of(fit, segment) for segment in segments]


def runs_along(signals):
    count = sum(len(s.segment.filtered_time) for s in signals)
    return [Runs((np.arange(count),), np.zeros(count))] * 2


@pytest.mark.parametrize("kept", [0, 1 << 30])
def test_the_scan_finds_the_wave_number_of_a_residual(monkeypatch, signals, kept):
    monkeypatch.setattr(shape_scan, "KEPT_BYTES", kept)
    runs = runs_along(signals)
    scan = ColumnStore().scan(make("torque_ripple"), 0, signals, runs, OPTIONS)
    q = np.concatenate([s.values["q"][s.segment.kept, 0] for s in signals])
    for waves in (WAVES, 2.0 * WAVES):
        peaks = scan.peaks(np.sin(waves * q + 0.3), OPTIONS)[:, 0]
        assert np.abs(peaks - waves).min() <= 0.5 * np.diff(scan.grid[:2])[0] + 1e-9


def test_columns_of_a_scan_are_evaluated_once_for_the_residuals_of_all_fits(monkeypatch, signals):
    evaluated, at = [], EffectFunction.at
    monkeypatch.setattr(EffectFunction, "at", lambda *a: evaluated.append(1) or at(*a))
    store, runs = ColumnStore(), runs_along(signals)
    residual = np.sin(WAVES * np.linspace(0.0, 1.0, runs[0].count))
    effect = make("torque_ripple")
    first = store.scan(effect, 0, signals, runs, OPTIONS).peaks(residual, OPTIONS)
    count = len(evaluated)
    again = store.for_another_fit().scan(effect, 0, signals, runs, OPTIONS)
    np.testing.assert_array_equal(again.peaks(residual, OPTIONS), first)
    assert len(evaluated) == count > 0
