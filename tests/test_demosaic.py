import numpy as np
import pytest

from stages.demosaic import demosaic
from stages.types import Radiance

BAYER = {
    "RGGB": np.array([[0, 1], [1, 2]]),
    "BGGR": np.array([[2, 1], [1, 0]]),
    "GRBG": np.array([[1, 0], [2, 1]]),
    "GBRG": np.array([[1, 2], [0, 1]]),
}
RGGB = BAYER["RGGB"]
every_bayer_order = pytest.mark.parametrize("cfa", BAYER.values(), ids=BAYER.keys())


def mosaic_of(picture, cfa):
    """What a sensor with this CFA keeps of a picture (H, W, 3)."""
    height, width, _ = picture.shape
    colour = np.tile(cfa, (height // 2 + 1, width // 2 + 1))[:height, :width]
    return np.take_along_axis(picture, colour[..., None], axis=-1)[..., 0]


def radiance(mosaic, cfa=RGGB, variance=1e-10, lost=None, defective=None):
    none = np.zeros(mosaic.shape, bool)
    lost = none if lost is None else lost
    defective = none if defective is None else defective
    valid = ~(lost | defective)
    return Radiance(
        mosaic=np.where(valid, mosaic, np.nan).astype(np.float32),
        variance=np.where(valid, variance, np.nan).astype(np.float32),
        valid=valid,
        lost=lost,
        defective=defective,
        moved=none,
        at_least=np.full((2, 2), np.inf),
        cfa=cfa,
        tagged=(1.0,),
        solved=(1.0,),
        noise=np.array([[1e-4, 1e-3]]),
        prnu=0.0,
        transfer=np.empty((0, 4)),
        clipped=(0.0,),
        alike=(0,),
    )


def disc(height, width, radius, centre=None):
    y, x = np.mgrid[:height, :width]
    cy, cx = centre or (height / 2, width / 2)
    return (y - cy) ** 2 + (x - cx) ** 2 < radius**2


@every_bayer_order
@pytest.mark.parametrize("size", [(40, 60), (37, 51)])
def test_a_constant_world_stays_constant_to_the_bit(cfa, size):
    colour = np.float32([0.313, 1.7, 0.0421])
    result = demosaic(radiance(mosaic_of(np.broadcast_to(colour, (*size, 3)), cfa), cfa))
    assert np.array_equal(result.values, np.broadcast_to(colour, (*size, 3)))
    assert result.valid.min() == 1
    assert result.values.dtype == result.variance.dtype == np.float32


@every_bayer_order
def test_measured_samples_are_kept_as_they_are(cfa):
    rng = np.random.default_rng(1)
    mosaic = rng.uniform(0, 1, (300, 50)).astype(np.float32)  # more rows than a tile has
    result = demosaic(radiance(mosaic, cfa))
    assert np.array_equal(mosaic_of(result.values, cfa), mosaic)


@every_bayer_order
def test_a_plane_comes_back_as_that_plane(cfa):
    # Linear interpolation of a linear picture is exact; float32 leaves 1e-6.
    y, x = np.mgrid[:44, :64]
    grey = 1 + 0.01 * x - 0.02 * y
    picture = grey[..., None] * [0.5, 1.0, 0.25]
    result = demosaic(radiance(mosaic_of(picture, cfa), cfa))
    inside = (slice(3, -3), slice(3, -3))
    np.testing.assert_allclose(result.values[inside], picture[inside], rtol=2e-6)


def test_the_world_and_its_mirror_image_come_out_alike():
    # The CFA of an even-sized RGGB mosaic, flipped left to right, is GRBG.
    rng = np.random.default_rng(2)
    mosaic = rng.uniform(0.5, 1, (40, 60)).astype(np.float32)
    straight = demosaic(radiance(mosaic, RGGB)).values
    mirrored = demosaic(radiance(mosaic[:, ::-1], BAYER["GRBG"])).values[:, ::-1]
    np.testing.assert_allclose(straight, mirrored, rtol=1e-5)


@every_bayer_order
def test_nothing_rings_or_fringes_about_a_lamp_ten_thousand_times_brighter(cfa):
    lamp = disc(80, 90, 15.3, (41.3, 38.8))
    room, filament = np.array([0.5, 1.0, 0.8]), np.array([1e4, 6e3, 2e3])
    picture = np.where(lamp[..., None], filament, room)
    result = demosaic(radiance(mosaic_of(picture, cfa), cfa)).values
    assert np.all(result >= room.astype(np.float32))
    assert np.all(result <= filament.astype(np.float32))
    # Beyond the next sample of each colour, two pixels away, no trace of the other side.
    import cv2

    reach = np.ones((5, 5), np.uint8)
    dark = cv2.dilate(lamp.astype(np.uint8), reach) == 0
    bright = cv2.erode(lamp.astype(np.uint8), reach) == 1
    np.testing.assert_array_equal(result[dark], np.broadcast_to(room, (dark.sum(), 3)).astype("f4"))
    np.testing.assert_array_equal(
        result[bright], np.broadcast_to(filament, (bright.sum(), 3)).astype("f4")
    )


@pytest.mark.parametrize("centre", [(40.0, 40.0), (40.3, 39.6), (41.0, 40.0), (39.5, 40.5)])
def test_a_small_lamp_keeps_its_light_and_its_colour(centre):
    # A lamp of 16 px as a lens draws it, of another tint than the room: what it sends is the sum.
    import cv2

    fine = disc(640, 640, 64, (8 * centre[0], 8 * centre[1])).astype(float)
    lamp = cv2.GaussianBlur(fine.reshape(80, 8, 80, 8).mean(axis=(1, 3)), (0, 0), 0.5)[..., None]
    picture = (1 - lamp) * [0.5, 1.0, 0.8] + lamp * [5e3, 8e3, 2e3]
    result = demosaic(radiance(mosaic_of(picture, RGGB))).values
    total = result.sum(axis=(0, 1), dtype=float) / picture.sum(axis=(0, 1))
    np.testing.assert_allclose(total, 1, atol=0.02)


@pytest.mark.parametrize("vertical", [True, False])
def test_a_straight_edge_of_the_same_tint_stays_sharp_and_of_that_tint(vertical):
    picture = np.ones((40, 40, 1)) * [0.5, 1.0, 0.25]
    picture[:, 20:] *= 1e4
    if not vertical:
        picture = picture.transpose(1, 0, 2)
    result = demosaic(radiance(mosaic_of(picture, RGGB))).values
    along = result[20] if vertical else result[:, 20]
    # All but the two pixels at the edge, where red or blue lie on one side only.
    expected = picture[20] if vertical else picture[:, 20]
    np.testing.assert_allclose(np.delete(along, (19, 20), 0), np.delete(expected, (19, 20), 0))


def each_colour_alone(mosaic):
    """A picture from each colour's own RGGB samples, bilinear at their exact places."""
    import cv2

    colour = np.tile(RGGB, (mosaic.shape[0] // 2, mosaic.shape[1] // 2))
    kernel = np.outer([1, 2, 1], [1, 2, 1]) / 4.0
    return np.stack(
        [
            cv2.filter2D(mosaic * (colour == c), -1, kernel)
            / cv2.filter2D(1.0 * (colour == c), -1, kernel)
            for c in range(3)
        ],
        axis=-1,
    )


def panels(rng, size=160, fine=4):
    """A picture (size, size, 3) of overlapping straight-edged things, each of one colour."""
    import cv2

    picture = np.full((size * fine, size * fine, 3), (0.5, 1.0, 0.6))
    for _ in range(40):
        centre, half = rng.uniform(0, size * fine, 2), rng.uniform(8, 100, 2)
        corners = cv2.boxPoints((centre.tolist(), half.tolist(), rng.uniform(0, 90)))
        shade = 10.0 ** rng.uniform(-1, 0.7)
        colour = shade * np.array([0.5, 1.0, 0.6]) * rng.uniform(0.7, 1.3, 3)
        cv2.fillConvexPoly(picture, corners.astype(np.int32), colour.tolist())
    pixels = picture.reshape(size, fine, size, fine, 3).mean(axis=(1, 3))
    return cv2.GaussianBlur(pixels, (0, 0), 0.5)  # the lens


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_edges_and_tints_come_out_truer_than_from_each_colour_alone(noise):
    """What decides against a plain 2 x 2 `bin`: light averaged over the texels of a map."""
    rng = np.random.default_rng(6)
    truth = panels(rng)
    clean = mosaic_of(truth, RGGB)
    variance = noise**2 * clean + 1e-12
    mosaic = clean + np.sqrt(variance) * rng.normal(size=clean.shape)

    def texels(picture):  # of 2 x 2 px
        return picture[4:-4, 4:-4].reshape(76, 2, 76, 2, 3).mean(axis=(1, 3))

    def errors(picture):
        got, true = texels(picture), texels(truth)
        tint = np.log(got / got[..., 1:2]) - np.log(true / true[..., 1:2])
        return np.percentile(np.abs(got / true - 1), [50, 95]), np.percentile(np.abs(tint), 95)

    (middle, far), tint = errors(demosaic(radiance(mosaic, variance=variance)).values)
    (plain_middle, plain_far), plain_tint = errors(each_colour_alone(mosaic))
    assert middle <= 1.02 * plain_middle
    assert far < 0.8 * plain_far
    assert tint < 0.8 * plain_tint


def test_it_beats_bilinear_interpolation_where_the_picture_has_detail():
    import cv2

    y, x = np.mgrid[:120, :120]
    rings = 1 + 0.5 * np.sin(((x - 60) ** 2 + (y - 60) ** 2) / 60.0)  # down to 3 px a period
    picture = cv2.GaussianBlur(rings, (0, 0), 0.7)[..., None] * [0.6, 1.0, 0.5]
    mosaic = mosaic_of(picture, RGGB)
    bilinear = each_colour_alone(mosaic)
    ours = demosaic(radiance(mosaic)).values
    inside = (slice(4, -4), slice(4, -4))
    error = [np.sqrt(np.mean((image - picture)[inside] ** 2)) for image in (ours, bilinear)]
    assert error[0] < 0.6 * error[1]


@pytest.mark.parametrize("level", [0.0, 0.5, 2.0])  # in standard deviations of a sample
def test_noise_around_black_keeps_its_mean(level):
    rng = np.random.default_rng(3)
    sigma = 0.01
    mosaic = level * sigma + rng.normal(0, sigma, (600, 600))
    result = demosaic(radiance(mosaic, variance=sigma**2)).values
    # Samples, not pixels, are independent: a quarter or half of them per colour. Four standard
    # errors of 90 000 samples are 1.3 % of sigma.
    error = (result.mean(axis=(0, 1)) - level * sigma) / sigma
    assert np.all(np.abs(error) < 4 / np.sqrt(600 * 600 / 4))


def test_photon_noise_leaves_no_bias_and_sigma_is_what_is_seen():
    rng = np.random.default_rng(4)
    truth, electrons = np.array([0.2, 1.0, 0.1]), 1000
    clean = mosaic_of(np.broadcast_to(truth, (500, 500, 3)), RGGB)
    mosaic = rng.poisson(clean * electrons) / electrons
    result = demosaic(radiance(mosaic, variance=clean / electrons))
    np.testing.assert_allclose(result.values.mean(axis=(0, 1)), truth, rtol=2e-3)
    for y, x in np.ndindex(2, 2):
        seen = result.values[y::2, x::2].std(axis=(0, 1))
        said = np.sqrt(result.variance[y::2, x::2].mean(axis=(0, 1)))
        assert np.all(said > 0.85 * seen)
        assert np.all(said < 1.15 * seen)


def test_sigma_is_believable_on_slopes_too():
    rng = np.random.default_rng(5)
    y, x = np.mgrid[:300, :300]
    slope = 1 + 0.5 * np.sin(x / 7) * np.cos(y / 9)
    picture = slope[..., None] * [0.7, 1.0, 0.6]
    sigma = 0.01
    clean = demosaic(radiance(mosaic_of(picture, RGGB), variance=sigma**2)).values
    noisy = mosaic_of(picture, RGGB) + rng.normal(0, sigma, (300, 300))
    result = demosaic(radiance(noisy, variance=sigma**2))
    spread = np.std((result.values - clean) / np.sqrt(result.variance), axis=(0, 1))
    assert np.all(spread > 0.7)
    assert np.all(spread < 1.3)


@every_bayer_order
def test_a_clipped_lamp_is_not_known_rather_than_magenta(cfa):
    """Green alone is lost: a pixel there would be magenta, whatever red and blue know."""
    import cv2

    white = np.array([0.5, 1.0, 0.6])
    lamp = cv2.GaussianBlur(disc(80, 80, 12).astype(float), (0, 0), 2.0)[..., None] * 1e3 + 1
    picture = lamp * white
    mosaic = mosaic_of(picture, cfa)
    lost = mosaic > 700  # of the lamp's 500, 1000, 600: green
    result = demosaic(radiance(mosaic, cfa, lost=lost))
    known = result.valid == 1
    assert not known[picture[..., 1] > 700].any()
    clear = cv2.dilate(lost.astype(np.uint8), np.ones((3, 3), np.uint8)) == 0
    assert np.array_equal(known, clear)
    assert np.all(np.isnan(result.values[~known]))
    assert np.all(np.isnan(result.variance[~known]))
    # What is known is what it would be had nothing clipped. At the steepest rim the guess
    # for a clipped sample two pixels away may move it, within its neighbours' range.
    unclipped = demosaic(radiance(mosaic, cfa)).values
    np.testing.assert_allclose(result.values[known], unclipped[known], rtol=0.1)


@every_bayer_order
def test_a_defective_pixel_is_filled_from_its_neighbours(cfa):
    defective = np.zeros((30, 30), bool)
    defective[10, 10] = defective[15, 18] = defective[0, 0] = defective[29, 1] = True
    y, x = np.mgrid[:30, :30]
    picture = (1 + 0.01 * x + 0.01 * y)[..., None] * [0.5, 1.0, 0.25]
    result = demosaic(radiance(mosaic_of(picture, cfa), cfa, variance=1e-8, defective=defective))
    assert result.valid.min() == 1
    inside = (slice(3, -3), slice(3, -3))
    np.testing.assert_allclose(result.values[inside], picture[inside], rtol=5e-3)
    # It is less sure than its neighbours, and says so.
    own = cfa[10 % 2, 10 % 2]
    assert result.variance[10, 10, own] > 10 * result.variance[12, 12, own]


def test_a_patch_of_defects_too_large_to_fill_is_not_known():
    defective = np.zeros((30, 30), bool)
    defective[8:20, 8:20] = True
    result = demosaic(radiance(np.ones((30, 30)), defective=defective))
    assert result.valid[14, 14] == 0
    assert np.isnan(result.values[14, 14]).all()


def test_what_is_given_is_not_changed():
    lost = disc(30, 30, 5)
    given = radiance(np.ones((30, 30)), lost=lost)
    before = given.mosaic.copy(), given.variance.copy(), given.valid.copy()
    demosaic(given)
    np.testing.assert_array_equal(given.mosaic, before[0])
    np.testing.assert_array_equal(given.variance, before[1])
    np.testing.assert_array_equal(given.valid, before[2])
