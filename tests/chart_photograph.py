"""Photographs of a ColorChecker for tests: on a black board on a grey table, in perspective, lit
unevenly, seen by a camera through a filter, with noise.
"""

from __future__ import annotations

import numpy as np

from calibration import chart, sets
from calibration.channels import SHARP_FROM_XYZ
from calibration.spectra import WAVELENGTHS

SIZE = (480, 640)  # height, width


def reflectances(kind: str = chart.COLORCHECKER24):
    """Reflectances (n, 36) of a chart's patches.

    The SG's are not public: three smooth bumps by its published colours, with ripples, so that
    they are more than three spectra mixed.
    """
    if kind == chart.COLORCHECKER24:
        return sets.surfaces("colorchecker24").values.T
    table = sets._colour().CCS_COLOURCHECKERS["ColorCheckerSG - After November 2014"]
    x, y, luminance = np.array([table.data[name] for name in chart.CHARTS[kind]]).T
    xyz = np.stack([x, y, 1 - x - y], axis=1) * (luminance / y)[:, None]
    white_x, white_y = table.illuminant
    white = np.array([white_x, white_y, 1 - white_x - white_y]) / white_y
    rgb = np.clip(xyz @ SHARP_FROM_XYZ.T / (SHARP_FROM_XYZ @ white), 0.01, 0.95)
    edges = [1 / (1 + np.exp((edge - WAVELENGTHS) / 12)) for edge in (495, 585)]
    bumps = np.stack([edges[1], edges[0] - edges[1], 1 - edges[0]])
    rng = np.random.default_rng(140)
    ripples = np.sin(WAVELENGTHS / 40 + rng.uniform(0, 6, (len(rgb), 1)))
    return rgb @ bumps * (1 + 0.15 * ripples)


def camera_bands(light: str, glass=1.0):
    """Curves (36, 3) of a camera behind a glass, times a light of the paper's 19."""
    return sets.camera("nikon5100").values * (sets.lights("darling2011")[light] * glass)[:, None]


def homography(angle_deg, scale=60.0, centre=None, tilt=0.0, kind=chart.COLORCHECKER24, size=SIZE):
    """From the chart's places to px: turned, so many px a place, its middle at `centre`."""
    angle = np.radians(angle_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) * scale
    middle = chart.outline(kind).mean(axis=0)
    centre = np.array(centre or (size[1] / 2, size[0] / 2)) * (1.0 + np.dot((tilt, -tilt), middle))
    shift = centre - turn @ middle
    return np.array([[*turn[0], shift[0]], [*turn[1], shift[1]], [tilt, -tilt, 1.0]])


def photograph(
    bands, to_image, kind=chart.COLORCHECKER24, *, size=SIZE, fall=0.0, noise=0.01, seed=0
):
    """The image (H, W, 3) through camera bands (36, 3), and the patches' own colours (n, 3).

    to_image  homography from places (column, row) to px
    fall      how much less light falls on the right edge than on the left
    noise     at the brightest, relative
    """
    import cv2

    columns, rows = chart.GRIDS[kind]
    colours = reflectances(kind) @ bands
    white = bands.sum(axis=0)
    image = np.broadcast_to(0.35 * white, (*size, 3)).copy()

    def fill(corners, colour):
        outline = (16 * (chart.mapped(to_image, corners) - 0.5)).round().astype(np.int32)
        cv2.fillConvexPoly(image, outline, colour.tolist(), cv2.LINE_AA, 4)

    right, bottom = columns - 0.2, rows - 0.2
    fill(np.array([(-0.8, -0.8), (right, -0.8), (right, bottom), (-0.8, bottom)]), 0.03 * white)
    half = 0.5 * chart.PATCH_SHARE[kind]
    square = half * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    for i, colour in enumerate(colours):
        fill(square + np.array((i % columns, i // columns)), colour)
    image = cv2.GaussianBlur(image, (0, 0), 1.2)
    image *= (1.0 - fall * np.arange(size[1]) / size[1])[None, :, None]
    rng = np.random.default_rng(seed)
    return image + noise * np.sqrt(image * image.max()) * rng.normal(size=image.shape), colours


def centres(to_image, kind=chart.COLORCHECKER24):
    """Where the patches' middles are (n, 2), px."""
    columns, rows = chart.GRIDS[kind]
    places = [(c, r) for r in range(rows) for c in range(columns)]
    return chart.mapped(to_image, np.array(places, float))
