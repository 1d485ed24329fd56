"""Filtering in windows gives what filtering the whole signal gives."""

import numpy as np
import pytest

from lieid_casadi.recording.filtering import filter_memory, lowpass, windows


def in_windows(x, rate, cutoff, order, kept, size):
    margin = filter_memory(rate, cutoff, order)
    found = []
    for window in windows(len(x), kept, margin, size):
        low = lowpass(x[window.instants], rate, cutoff, order)
        assert len(low) <= size + 2 * margin + kept.start + (len(x) - kept.stop) + kept.step
        found.append(low[window.inside])
        assert len(found[-1]) == window.rows.stop - window.rows.start
    return np.concatenate(found)


@pytest.mark.parametrize("order", [1, 2, 4, 8])
@pytest.mark.parametrize("ratio", [5.0, 20.0, 80.0])
@pytest.mark.parametrize("step", [1, 7])
def test_windows_equal_the_whole(order, ratio, step):
    rng = np.random.default_rng(0)
    x = np.cumsum(rng.normal(size=(20_000, 2)), axis=0) + 50.0
    whole = lowpass(x, ratio, 1.0, order)
    kept = slice(37, len(x) - 37, step)
    found = in_windows(x, ratio, 1.0, order, kept, 1500)
    assert np.abs(found - whole[kept]).max() < 1e-10 * np.abs(x).max()


def test_short_signals_are_one_window():
    assert len(list(windows(900, slice(10, 890, 4), 300))) == 1


def test_windows_cover_every_row_once():
    kept = slice(5, 1000, 3)
    rows = [
        np.arange(w.instants.start, w.instants.stop)[w.inside] for w in windows(1003, kept, 20, 100)
    ]
    assert len(rows) > 5
    np.testing.assert_array_equal(np.concatenate(rows), np.arange(1003)[kept])


def test_no_rows():
    (window,) = windows(10, slice(5, 5, 1), 3)
    assert window.rows == slice(0, 0)
