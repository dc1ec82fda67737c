import chart_photograph
import numpy as np
import pytest

from calibration import chart, sets
from calibration.errors import InputError


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


@pytest.mark.parametrize("kind", chart.CHARTS)
@pytest.mark.parametrize("light", ["A", "D65", "F11"])
@pytest.mark.parametrize("bands", [[0, 1, 2], [0], [2]], ids=["all", "red", "blue"])
def test_a_chart_upside_down_is_told_by_its_readings(kind, light, bands):
    spectra = chart_photograph.reflectances(kind) * sets.lights("darling2011")[light]
    signals = (spectra @ sets.camera("nikon5100").values)[:, bands]
    assert not chart.turned(signals, spectra)
    assert not chart.unlike(signals, spectra)
    assert chart.turned(signals[::-1], spectra)
    assert chart.unlike(signals[::-1], spectra)


@pytest.mark.parametrize("kind", chart.CHARTS)
def test_readings_in_another_order_are_unlike_the_patches(kind):
    columns, rows = chart.GRIDS[kind]
    spectra = chart_photograph.reflectances(kind) * sets.lights("darling2011")["D50"]
    signals = spectra @ sets.camera("nikon5100").values
    down_the_columns = np.arange(rows * columns).reshape(rows, columns).T.ravel()
    mirrored = np.arange(rows * columns).reshape(rows, columns)[:, ::-1].ravel()
    for order in (down_the_columns, mirrored, np.roll(np.arange(rows * columns), 1)):
        assert chart.unlike(signals, spectra[order])
        assert not chart.turned(signals, spectra[order])
    signals[11:] = np.nan  # a handful cannot tell
    assert not chart.unlike(signals, spectra[down_the_columns])


@pytest.mark.parametrize("kind", chart.CHARTS)
def test_patches_lie_between_the_corners_given(kind):
    to_image = chart_photograph.homography(8, scale=30.0, tilt=0.01, kind=kind)
    corners = chart.mapped(to_image, chart.outline(kind))
    found = chart.from_corners(corners, kind)
    assert found.names == chart.CHARTS[kind]
    np.testing.assert_allclose(
        found.corners.mean(axis=1), chart_photograph.centres(to_image, kind), atol=0.1
    )
    # What is read is the middle half of each patch: a quarter of its area.
    sides = np.linalg.norm(np.roll(found.corners, -1, axis=1) - found.corners, axis=-1)
    places = np.linalg.norm(np.diff(chart_photograph.centres(to_image, kind)[:2], axis=0))
    assert sides[0, 0] == pytest.approx(0.5 * chart.PATCH_SHARE[kind] * places, rel=0.05)


@pytest.mark.parametrize(
    "corners",
    [
        [(0, 0), (0, 40), (60, 40), (60, 0)],  # anticlockwise: mirrored
        [(0, 0), (60, 40), (60, 0), (0, 40)],  # crossed
        [(0, 0), (30, 0), (60, 0), (0, 40)],  # no quadrilateral
    ],
)
def test_corners_that_no_chart_has_are_refused(corners):
    with pytest.raises(InputError, match="patches A1, N1, N10, A10 in that order"):
        chart.from_corners(corners, chart.COLORCHECKER_SG)


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
