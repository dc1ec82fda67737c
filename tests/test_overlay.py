"""The picture of the sphere that was found."""

from dataclasses import replace

import numpy as np
import pytest

from stages.mirror import Sphere
from stages.overlay import overlay
from stages.types import Measured

SPHERE = Sphere.from_rim(
    160.0, 120.0, 80.0, radius_mm=50.0, principal_px=(160.0, 120.0), distance_mm=1500.0
)


def grey(height=240, width=320):
    values = np.full((height, width, 3), 0.5, np.float32)
    return Measured(values, values, np.ones((height, width), np.float32))


def test_the_rim_is_drawn_where_it_is_and_nowhere_else():
    picture = overlay(grey(), replace(SPHERE, rim_found=0.9, rim_residual_px=0.05))
    coloured = np.ptp(picture, axis=-1) > 0.15
    y, x = np.mgrid[:240, :320] + 0.5
    away = np.abs(np.hypot(x - 160.0, y - 120.0) - 80.0)
    assert coloured[away < 0.4].mean() > 0.9
    elsewhere = (away > 2.0) & (np.hypot(x - 160.0, y - 120.0) > 12.0) & (y > 56.0)
    assert not coloured[elsewhere].any()


def test_a_rim_in_doubt_is_red_and_one_that_agrees_green():
    def at_the_right(found):
        r, g, _ = overlay(grey(), replace(SPHERE, rim_found=found, rim_residual_px=0.1))[120, 239]
        return r - g

    assert at_the_right(0.9) < 0 < at_the_right(0.3)


def test_unknown_pixels_are_white_and_a_large_photograph_is_made_smaller():
    image = grey(2000, 3000)
    image.values[1500:1600, 2000:2200] = np.nan
    picture = overlay(image, SPHERE)
    assert max(picture.shape) == 1600
    assert picture[int(1550 * 1600 / 3000), int(2100 * 1600 / 3000)].min() == 1.0


def test_a_sector_that_disagrees_is_marked_and_no_other():
    agrees = [True] * 36
    agrees[9] = False  # clockwise from the right: 90 to 100 degrees, the lowest place of the rim
    doubtful = replace(SPHERE, rim_found=0.97, rim_agrees=tuple(agrees))
    picture = overlay(grey(), doubtful)
    magenta = (picture[..., 0] > 0.7) & (picture[..., 1] < 0.3) & (picture[..., 2] > 0.7)
    row, column = np.nonzero(magenta)
    angle = np.degrees(np.arctan2(row + 0.5 - 120.0, column + 0.5 - 160.0))
    assert len(row) > 5
    assert (angle > 88.0).all()
    assert (angle < 102.0).all()


@pytest.mark.parametrize("width", [120, 200, 320, 500])
def test_a_narrow_picture_holds_the_whole_caption(width):
    told = {"rim_found": 0.97, "rim_residual_px": 0.05, "rim_sigma_px": (0.03, 0.03, 0.04)}

    def letters(picture_width):
        # Of a sphere so far below that nothing but the caption is drawn.
        picture = overlay(grey(300, picture_width), replace(SPHERE.with_shift((0, 600)), **told))
        return np.ptp(picture, axis=-1)

    narrow, wide = letters(width), letters(1000)
    assert narrow.max() > 0.5
    assert narrow[:, -2:].max() < 0.02  # cut off, letters would reach the edge
    if width >= 320:  # letters as large as ever, in more lines: the same ink
        np.testing.assert_allclose(narrow.sum(), wide.sum(), rtol=0.05)
