"""Colours of the page differ for readers with each kind of colour blindness."""

from itertools import combinations

import numpy as np
import pytest

from lieid_casadi.plot_style import BACKWARD, ERROR, FORWARD, MEASURED, PREDICTED
from lieid_casadi.workbench.elements import COMPARED, FIRST, SCALE, ratio_colour

# Machado, Oliveira and Fernandes, IEEE TVCG 15(6), 2009: severity 1, on linear RGB
BLINDNESS = {
    "none": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritanopia": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def lab(colour, kind):
    """Return CIELAB of a colour as a reader with a kind of colour blindness sees it."""
    rgb = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    xyz = XYZ @ np.clip(np.asarray(BLINDNESS[kind]) @ linear, 0.0, 1.0) / [0.9505, 1.0, 1.089]
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16.0 / 116.0)
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


@pytest.mark.parametrize("kind", BLINDNESS)
@pytest.mark.parametrize(
    "colours",
    [
        [colour for _, colour in SCALE],
        [MEASURED, PREDICTED, ERROR, COMPARED],
        [FORWARD, BACKWARD],
        [FIRST, PREDICTED, COMPARED],
    ],
    ids=["scale", "lines", "directions", "models"],
)
def test_colours_differ(colours, kind):
    for a, b in combinations(colours, 2):
        assert np.linalg.norm(lab(a, kind) - lab(b, kind)) > 12.0, (a, b)


def test_the_scale_grows_with_the_error():
    assert [ratio_colour(r) for r in (1.0, 1.5, 4.0, 30.0)] == [colour for _, colour in SCALE]
