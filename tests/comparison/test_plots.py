"""Plots show the numbers of the comparison and do not change Matplotlib's settings."""

import io
from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from comparison import two_link_data as arm
from matplotlib.figure import Figure

import lieid_casadi as lieid
from lieid_casadi.comparison import plot_style


@pytest.fixture(scope="module")
def comparison():
    test = arm.recording(14.0, seed=2, noise=0.2, still_after=10.0, name="run_$1$.csv")
    return lieid.compare(arm.fit(), test)


def png(figure):
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=50)
    return buffer.getvalue()


def test_plots_are_figures_and_change_no_setting(comparison):
    from matplotlib import pyplot

    before, windows = dict(matplotlib.rcParams), pyplot.get_fignums()
    figures = [comparison.plot(), comparison.plot(joint=1), comparison.plot_errors()]
    assert all(type(figure) is Figure for figure in figures)
    assert png(figures[1]).startswith(b"\x89PNG")
    figure = Figure()
    assert comparison.plot(figure.subplots(), joint=1) is figure
    assert dict(matplotlib.rcParams) == before
    assert pyplot.get_fignums() == windows


def test_errors_are_drawn_against_each_signal(comparison):
    axes = np.reshape(comparison.plot_errors().axes, (2, 4))
    (series,) = comparison.series
    for joint in range(2):
        for column, signal in ((0, series.q), (1, series.dq), (2, series.load)):
            clouds = [line for line in axes[joint, column].get_lines() if line.get_marker() == "."]
            points = np.vstack([np.transpose(line.get_data()) for line in clouds])
            expected = np.column_stack([signal[:, joint], series.error[:, joint]])
            assert sorted(map(tuple, points)) == sorted(map(tuple, expected))


@pytest.mark.parametrize("names", [("$x^2", "\\frac {}"), ("ü" * 200, "")])
def test_any_name_can_be_drawn(comparison, names):
    floor = np.full(2, np.nan)  # is not drawn
    named = replace(comparison, joint_names=names, noise_floor=floor, noise_source="none")
    for figure in (named.plot(), named.plot_errors()):
        figure.set_layout_engine("none")  # texts are parsed without it too
        figure.draw_without_rendering()
        assert "noise" not in " ".join(t.get_text() for t in figure.legends[0].get_texts())


def test_decimated_lines_keep_their_peaks():
    x = np.arange(200_000.0)
    y = np.sin(x / 900.0)
    y[123_456], y[77_777] = 9.0, -7.0
    thin_x, thin_y = plot_style.envelope(x, y)
    assert len(thin_x) <= 2 * plot_style.MOST_COLUMNS
    assert thin_y.max() == 9.0
    assert thin_y.min() == -7.0
    assert np.all(np.diff(thin_x) > 0.0)
    np.testing.assert_array_equal(y[thin_x.astype(int)], thin_y)
