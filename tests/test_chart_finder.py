from pathlib import Path

import numpy as np
import pytest
from chart_photograph import SIZE, camera_bands, centres, homography, photograph

from calibration import chart, chart_finder
from calibration.errors import InputError
from calibration.spectra import WAVELENGTHS, read_spectra

DATA = Path(__file__).parents[2] / "shared" / "data"
RAW = DATA / "raw" / "colorchart.dng"
SG_CSV = DATA / "reflectances" / "CCSG.csv"
SG = chart.COLORCHECKER_SG

CYAN = 0.9 / (1 + np.exp((WAVELENGTHS - 585) / 12))
YELLOW = 0.9 / (1 + np.exp((485 - WAVELENGTHS) / 6))


def off_by(found, to_image):
    """The furthest that a patch's middle is off, in steps from one patch to the next."""
    true = centres(to_image, SG if len(found.names) == 140 else chart.COLORCHECKER24)
    off = np.linalg.norm(found.corners.mean(axis=1) - true, axis=-1)
    return off.max() / np.linalg.norm(true[1] - true[0])


# The middle half of a patch is read, which is .4 steps wide of its .8: off by .1, it is all patch.
WELL_INSIDE = 0.1


@pytest.mark.parametrize("angle_deg", [0, 7, 90, 180, 262])
def test_a_chart_is_found_whichever_way_it_lies(angle_deg):
    to_image = homography(angle_deg, tilt=0.01)
    image, _ = photograph(camera_bands("D50"), to_image)
    found = chart_finder.find([image])
    assert found.names == chart.PATCHES
    assert off_by(found, to_image) < WELL_INSIDE


@pytest.mark.parametrize("light", ["A", "D75", "F11"])
def test_a_chart_is_found_through_filters_under_coloured_light(light):
    to_image = homography(3)
    cyan, _ = photograph(camera_bands(light, CYAN), to_image, seed=1)
    yellow, colours = photograph(camera_bands(light, YELLOW), to_image, seed=2)
    found = chart_finder.find([cyan, yellow])
    got = chart.patch_signals(yellow, np.ones(SIZE), found)
    np.testing.assert_allclose(got.mean, colours, rtol=0.05, atol=0.01 * colours.max())


@pytest.mark.parametrize(
    ("light", "angle_deg", "scale"), [("A", 0, 38.0), ("F11", 183, 30.0), ("D65", 88, 25.0)]
)
def test_an_sg_chart_is_found_through_filters_whichever_way_it_lies(light, angle_deg, scale):
    to_image = homography(angle_deg, scale, tilt=0.004, kind=SG)
    images = [
        photograph(camera_bands(light, glass), to_image, SG, fall=0.3, seed=3)[0]
        for glass in (CYAN, YELLOW)
    ]
    found = chart_finder.find(images, SG)
    assert found.names == chart.CHARTS[SG]
    assert off_by(found, to_image) < WELL_INSIDE


@pytest.mark.skipif(not SG_CSV.is_file(), reason="the measured SG is not beside the checkout")
@pytest.mark.parametrize("light", ["A", "F11"])
def test_an_sg_chart_of_measured_reflectances_is_found(light, monkeypatch):
    measured = read_spectra(SG_CSV)  # names as A:1
    names = [f"{name[0]}:{name[1:]}" for name in chart.CHARTS[SG]]
    reflectances = measured.only(names).values.T
    monkeypatch.setattr("chart_photograph.reflectances", lambda kind: reflectances)
    to_image = homography(176, 36.0, tilt=-0.003, kind=SG)
    images = [
        photograph(camera_bands(light, glass), to_image, SG, fall=0.3, seed=4)[0]
        for glass in (CYAN, YELLOW)
    ]
    assert off_by(chart_finder.find(images, SG), to_image) < WELL_INSIDE


@pytest.mark.parametrize("kind", chart.CHARTS)
def test_where_no_grid_of_squares_is_followed_opencv_finds_the_chart(kind, monkeypatch):
    monkeypatch.setattr(chart_finder, "_by_squares", lambda *_: iter(()))
    size = (600, 800)
    to_image = homography(2, 90.0 if kind != SG else 48.0, kind=kind, size=size)
    image, _ = photograph(camera_bands("D65"), to_image, kind, size=size)
    assert off_by(chart_finder.find([image], kind), to_image) < WELL_INSIDE


def test_a_chart_with_clipped_pixels_is_found():
    image, colours = photograph(camera_bands("D50"), homography(0))
    image[image > 0.8 * colours[18]] = np.nan  # the white patch, in all bands
    found = chart_finder.find([image.astype(np.float32)])
    got = chart.patch_signals(image, np.ones(SIZE), found)
    assert got.clipped[18].all()
    assert not got.clipped[19:].any()


def test_what_is_no_chart_is_refused_and_places_asked_for():
    noise = np.random.default_rng(1).random((300, 400, 3))
    image, _ = photograph(camera_bands("D50"), homography(0))
    for wrong in (noise, image[:, ::-1]):  # a mirrored chart is none
        with pytest.raises(InputError, match=r"patches 1, 6, 24 and 19: corners.*patch_boxes\.csv"):
            chart_finder.find([wrong])


def test_a_chart_of_24_patches_is_no_sg():
    image, _ = photograph(camera_bands("D50"), homography(0))
    with pytest.raises(InputError, match="no colorchecker-sg found"):
        chart_finder.find([image], SG)


def test_the_24_patches_within_an_sg_are_found_where_they_are():
    to_image = homography(0, 36.0, kind=SG)
    image, _ = photograph(camera_bands("D50"), to_image, SG)
    found = chart_finder.find([image])
    within = dict(zip(chart.CHARTS[SG], centres(to_image, SG), strict=True))
    middles = found.corners.mean(axis=1)
    for patch, name in (("1", "E2"), ("6", "J2"), ("19", "E5"), ("24", "J5")):
        np.testing.assert_allclose(middles[int(patch) - 1], within[name], atol=0.1 * 36.0)


@pytest.mark.skipif(not RAW.is_file(), reason="the real photograph is not beside the checkout")
def test_the_chart_in_a_real_photograph_is_found():
    rawpy = pytest.importorskip("rawpy")
    with rawpy.imread(str(RAW)) as raw:
        mosaic = raw.raw_image_visible.astype(np.float32) - 2056.0
    rgb = np.stack([mosaic[::2, ::2], mosaic[::2, 1::2], mosaic[1::2, 1::2]], axis=-1)
    middle = chart_finder.find([rgb]).corners.mean(axis=1)
    # The corner patches as read off the picture by eye.
    by_eye = np.array([(357, 313), (626, 307), (350, 465), (629, 461)])
    np.testing.assert_allclose(middle[[0, 5, 18, 23]], by_eye, atol=5)
