from pathlib import Path

import numpy as np
import pytest

from calibration import chart, sets
from calibration.errors import InputError
from calibration.spectra import WAVELENGTHS

RAW = Path(__file__).parents[2] / "shared" / "data" / "raw" / "colorchart.dng"


def boxes_file(tmp_path, change=lambda rows: rows):
    rows = ["patch,x0,y0,x1,y1"]
    for i in range(24):
        x, y = 20 * (i % 6), 20 * (i // 6)
        rows.append(f"{i + 1},{x + 4},{y + 4},{x + 16},{y + 16}")
    path = tmp_path / "patch_boxes.csv"
    path.write_text("\n".join(change(rows)) + "\n")
    return path


@pytest.fixture
def grid(tmp_path):
    return chart.read_boxes(boxes_file(tmp_path))


def photograph(light="D50", cut_nm=0.0, to_image=None, size=(480, 640), seed=0):
    """A ColorChecker on a grey table through a camera and a filter that cuts the short end.

    to_image  homography from places (column 0..5, row 0..3) to px
    """
    import cv2

    lamp = sets.lights("darling2011")[light]
    glass = 1.0 / (1.0 + np.exp(-(WAVELENGTHS - cut_nm) / 8.0))
    bands = sets.camera("nikon5100").values * (lamp * glass)[:, None]
    colours = sets.surfaces("colorchecker24").values.T @ bands
    table, frame = 0.35 * bands.sum(axis=0), 0.03 * bands.sum(axis=0)
    image = np.broadcast_to(table, (*size, 3)).copy()

    def fill(corners, colour):
        points = np.concatenate([corners, np.ones((4, 1))], axis=1) @ to_image.T
        outline = (points[:, :2] / points[:, 2:] - 0.5).round().astype(np.int32)
        cv2.fillConvexPoly(image, outline, colour.tolist())

    square = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    fill(np.array([(-0.8, -0.8), (5.8, -0.8), (5.8, 3.8), (-0.8, 3.8)]), frame)
    for i, colour in enumerate(colours):
        fill(0.4 * square + (i % 6, i // 6), colour)
    image = cv2.GaussianBlur(image, (0, 0), 1.5)
    rng = np.random.default_rng(seed)
    bright = image.max()
    return image + 0.01 * np.sqrt(image * bright) * rng.normal(size=image.shape), colours


def homography(angle_deg, scale=60.0, centre=(320.0, 240.0), tilt=0.0):
    angle = np.radians(angle_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) * scale
    shift = np.array(centre) - turn @ (2.5, 1.5)
    return np.array([[*turn[0], shift[0]], [*turn[1], shift[1]], [tilt, -tilt, 1.0]])


@pytest.mark.parametrize("angle_deg", [0, 7, 90, 180, 262])
def test_a_chart_is_found_whichever_way_it_lies(angle_deg):
    to_image = homography(angle_deg, tilt=0.01)
    image, _ = photograph(to_image=to_image)
    found = chart.find([image])
    places = np.array([(i % 6, i // 6, 1.0) for i in range(24)]) @ to_image.T
    expected = places[:, :2] / places[:, 2:]
    off = np.hypot(*(found.corners.mean(axis=1) - expected).T)
    assert found.names == chart.PATCHES
    assert off.max() < 0.1 * 60.0  # a tenth of a step: well inside the patch


@pytest.mark.parametrize("light", ["A", "D75", "F11"])
def test_a_chart_is_found_through_filters_under_coloured_light(light):
    cyan, _ = photograph(light, to_image=homography(3))
    cyan = cyan * [0.05, 0.8, 1.0]
    yellow, colours = photograph(light, cut_nm=500.0, to_image=homography(3))
    found = chart.find([cyan, yellow])
    got = chart.patch_signals(yellow, np.ones(yellow.shape[:2]), found)
    np.testing.assert_allclose(got.mean, colours, rtol=0.05, atol=0.01 * colours.max())


def test_a_chart_with_clipped_pixels_is_found():
    image, colours = photograph(to_image=homography(0))
    image[image > 0.8 * colours[18]] = np.nan  # the white patch, in all bands
    found = chart.find([image.astype(np.float32)])
    got = chart.patch_signals(image, np.ones(image.shape[:2]), found)
    assert got.clipped[18].all()
    assert not got.clipped[19:].any()


def test_what_is_no_chart_is_refused_and_boxes_asked_for():
    noise = np.random.default_rng(1).random((300, 400, 3))
    image, _ = photograph(to_image=homography(0))
    for wrong in (noise, image[:, ::-1]):  # a mirrored chart is none
        with pytest.raises(InputError, match=r"patch_boxes\.csv"):
            chart.find([wrong])


@pytest.mark.skipif(not RAW.is_file(), reason="the real photograph is not beside the checkout")
def test_the_chart_in_a_real_photograph_is_found():
    rawpy = pytest.importorskip("rawpy")
    with rawpy.imread(str(RAW)) as raw:
        mosaic = raw.raw_image_visible.astype(np.float32) - 2056.0
    rgb = np.stack([mosaic[::2, ::2], mosaic[::2, 1::2], mosaic[1::2, 1::2]], axis=-1)
    middle = chart.find([rgb]).corners.mean(axis=1)
    # The corner patches as read off the picture by eye.
    by_eye = np.array([(357, 313), (626, 307), (350, 465), (629, 461)])
    np.testing.assert_allclose(middle[[0, 5, 18, 23]], by_eye, atol=5)


def test_a_flat_patch_has_its_value_and_its_noise(grid):
    rng = np.random.default_rng(2)
    truth = rng.uniform(1.0, 5.0, (24, 2))
    image = np.zeros((80, 120, 2))
    for i in range(24):
        image[20 * (i // 6) :, 20 * (i % 6) :] = truth[i]
        image[20 * (i // 6) : 20 * (i // 6) + 20, 20 * (i % 6) : 20 * (i % 6) + 20] = truth[i]
    noisy = image * (1 + 0.01 * rng.normal(size=image.shape))
    got = chart.patch_signals(noisy, np.ones((80, 120)), grid)
    np.testing.assert_array_equal(got.pixels, 144)
    assert not got.clipped.any()
    np.testing.assert_allclose(got.mean, truth, rtol=5 * 0.01 / 12)
    np.testing.assert_allclose(np.sqrt(got.variance) / truth, 0.01, rtol=0.3)


def test_only_pixels_whose_centre_is_inside_count(grid):
    image = np.full((80, 120, 1), np.inf)
    image[4:16, 4:16] = 3.0
    got = chart.patch_signals(image, np.ones((80, 120)), chart.Patches(("1",), grid.corners[:1]))
    assert got.mean[0, 0] == 3.0


def test_a_clipped_patch_is_told_per_band_and_a_stray_pixel_forgiven(grid):
    image = np.ones((80, 120, 2))
    image[4:16, 4:10, 1] = np.nan  # half of patch 1, one band
    image[8, 28, 0] = np.nan  # a pixel of patch 2
    valid = np.ones((80, 120))
    valid[4:16, 44:56] = 0.0  # all of patch 3
    got = chart.patch_signals(image, valid, grid)
    assert got.clipped[:3].tolist() == [[False, True], [False, False], [True, True]]
    assert np.isnan(got.mean[0, 1])
    assert np.isnan(got.variance[2]).all()
    assert got.mean[1].tolist() == [1.0, 1.0]


def test_boxes_outside_the_photograph_are_all_named(grid):
    with pytest.raises(InputError) as caught:
        chart.patch_signals(np.ones((80, 100, 1)), np.ones((80, 100)), grid)
    lines = str(caught.value).splitlines()
    assert [line.split()[1] for line in lines] == ["6", "12", "18", "24"]
    assert "100 x 80 px" in lines[0]


def test_a_tiny_box_is_refused():
    quad = np.array([[(4, 4), (6, 4), (6, 6), (4, 6)]], float)
    with pytest.raises(InputError, match="covers 4 pixels"):
        chart.patch_signals(np.ones((9, 9, 1)), np.ones((9, 9)), chart.Patches(("1",), quad))


def test_boxes_are_read_in_the_charts_order(tmp_path, grid):
    path = boxes_file(tmp_path, lambda rows: [rows[0], *rows[:0:-1]])
    np.testing.assert_array_equal(chart.read_boxes(path).corners, grid.corners)
    assert grid.corners[1].tolist() == [[24, 4], [36, 4], [36, 16], [24, 16]]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda rows: [], "line 1 is ''"),
        (lambda rows: ["a,b", *rows[1:]], "line 1 is 'a,b'"),
        (lambda rows: rows[:-2], "no box for patch 23, 24"),
        (lambda rows: [*rows, "25,0,0,9,9"], "patch '25'"),
        (lambda rows: [*rows, rows[3]], "line 26: patch 3 again"),
        (lambda rows: [*rows[:-1], "24,9,9,3,12"], "line 25: an empty box"),
        (lambda rows: [*rows[:-1], "24,9,9,x,12"], "line 25: '24,9,9,x,12'"),
        (lambda rows: [*rows[:-1], "24,9,9"], "line 25: '24,9,9'"),
    ],
)
def test_faulty_boxes_are_refused(tmp_path, change, says):
    path = boxes_file(tmp_path, change)
    with pytest.raises(InputError) as caught:
        chart.read_boxes(path)
    assert says in str(caught.value)
    assert str(caught.value).startswith(f"{path}: ")


def test_missing_boxes_are_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        chart.read_boxes(tmp_path / "patch_boxes.csv")


def test_a_patch_that_varies_beyond_its_noise_is_uneven(grid):
    rng = np.random.default_rng(6)
    image = 1.0 + 0.05 * rng.normal(size=(80, 120, 2))
    stated = np.full_like(image, 0.05**2)
    image[4:16, 4:8, 0] *= 0.5  # a shadow over a third of patch 1, in one band
    image[24:36, 4:16] *= np.linspace(0.98, 1.02, 12)[None, :, None]  # the light's own fall
    got = chart.patch_signals(image, np.ones((80, 120)), grid, stated)
    assert np.argwhere(got.uneven).tolist() == [[0, 0]]
    assert np.isnan(got.mean[0, 0])
    np.testing.assert_allclose(got.noise, 0.05**2)
    # 144 pixels, of which demosaicing would have made 36 independent.
    np.testing.assert_allclose(got.mean_variance[1], 0.05**2 / 36, rtol=0.3)


def test_a_white_in_the_charts_place_shows_how_the_light_falls(grid):
    across = np.linspace(1.2, 0.8, 120)[None, :, None]
    white = 0.5 * across * np.ones((80, 1, 3))
    got = chart.shading(white, np.ones((80, 120)), grid)
    middle = np.interp(grid.corners.mean(axis=1)[:, 0], np.arange(120) + 0.5, across[0, :, 0])
    np.testing.assert_allclose(got, middle / middle.mean(), rtol=1e-6)
    white[4:16, 4:16] = np.nan
    with pytest.raises(InputError, match="the white clips at patch 1"):
        chart.shading(white, np.ones((80, 120)), grid)


@pytest.mark.parametrize("light", ["A", "D65", "F11"])
def test_a_chart_upside_down_is_told_by_its_readings(light):
    spectra = sets.surfaces("colorchecker24").values.T * sets.lights("darling2011")[light]
    signals = spectra @ sets.camera("nikon5100").values
    assert not chart.turned(signals, spectra)
    assert chart.turned(signals[::-1], spectra)


def test_an_sg_chart_has_its_own_boxes(tmp_path):
    names = chart.CHARTS["colorchecker-sg"]
    assert (len(names), names[0], names[13], names[-1]) == (140, "A1", "N1", "N10")
    rows = [f"{name},{i},0,{i + 0.9},1" for i, name in enumerate(names)]
    path = tmp_path / "boxes.csv"
    path.write_text("\n".join(["patch,x0,y0,x1,y1", *rows]))
    assert chart.read_boxes(path, names).names == names
    path.write_text("\n".join(["patch,x0,y0,x1,y1", *rows[:-1]]))
    with pytest.raises(InputError, match=r"no box for patch N10.*patches A1\.\.N10"):
        chart.read_boxes(path, names)
