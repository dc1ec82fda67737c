"""A sphere is found in one raw photograph, or not at all, but never elsewhere."""

import numpy as np
import pytest
from sphere_tracer import Camera, chromium, photograph, smooth_world

from stages.find import MARGIN, MARGIN_PX, find
from stages.region import Region
from stages.types import Frame

LENS = {"radius_mm": 50.0, "distance_mm": 1500.0}
BLACK, FULL = 500, 15000
SIZE = (301, 422)  # odd, as some are
AT, RADIUS = (170.3, 160.8), 70.0


def exposed(light, brightness: float, seed=1) -> Frame:
    """A raw photograph of light (H, W, 3) whose 99th percentile comes to so much of full scale."""
    rng = np.random.default_rng(seed)
    cfa = np.array([[1, 0], [2, 1]])
    rows, columns = np.indices(light.shape[:2])
    mosaic = np.take_along_axis(light, cfa[rows % 2, columns % 2][..., None], axis=2)[..., 0]
    mosaic = mosaic * (brightness / np.percentile(mosaic, 99))
    electrons = rng.poisson(mosaic * 30000) + rng.normal(0, 6, mosaic.shape)
    raw = np.clip(np.rint(BLACK + electrons / 30000 * (FULL - BLACK)), 0, FULL)
    levels = np.full((2, 2), float(BLACK)), np.full((2, 2), float(FULL))
    return Frame(raw.astype(np.uint16), cfa, *levels, 1.0, 100.0, 1.0)


@pytest.fixture(scope="module")
def light():
    camera = Camera.seeing(*AT, RADIUS, *SIZE)
    grey = photograph(camera, smooth_world(3), chromium, samples=1, rim_samples=3)
    return grey.reshape(*SIZE, -1)[..., :1] * (0.4, 1.0, 0.7)


@pytest.mark.parametrize("brightness", [0.1, 0.8, 1.5])
def test_a_sphere_is_found_with_the_margin_that_is_wanted(light, brightness):
    found = find([exposed(light, brightness)], frame_size=SIZE, **LENS)
    assert found.tried == 1
    np.testing.assert_allclose(found.rim, (*AT, RADIUS), atol=0.03 * RADIUS)
    region, margin = found.region, (MARGIN - 0.03) * RADIUS + MARGIN_PX
    assert region.frame == SIZE
    assert region.left <= AT[0] - RADIUS - margin
    assert region.right >= AT[0] + RADIUS + margin
    assert region.top <= AT[1] - RADIUS - margin
    assert region.bottom >= AT[1] + RADIUS + margin
    assert region.share < 0.65


def test_a_photograph_that_shows_nothing_is_passed_over(light):
    taken = []

    def frames():
        for brightness in (1e-5, 0.8, 0.8):
            taken.append(brightness)
            yield exposed(light, brightness)

    found = find(frames(), frame_size=SIZE, **LENS)
    assert found.tried == 2
    assert taken == [1e-5, 0.8]  # the third was never asked for
    assert found.region.share < 0.65


def test_where_no_sphere_is_clear_the_region_is_the_whole_photograph():
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    rng = np.random.default_rng(8)
    boxes = rng.uniform(0.1, 3.0, (11, 11))[y // 30, x // 40]
    for picture in (boxes, np.ones(SIZE), rng.uniform(0.0, 1.0, SIZE)):
        found = find([exposed(picture[..., None] * np.ones(3), 0.8)], frame_size=SIZE, **LENS)
        assert found.rim is None
        assert found.region == Region.whole(SIZE)
        assert found.tried == 1


def test_a_given_outline_is_not_looked_for():
    def frames():
        raise AssertionError("a photograph was asked for")
        yield

    found = find(frames(), frame_size=SIZE, outline=(*AT, RADIUS), **LENS)
    assert found.tried == 0
    np.testing.assert_allclose(found.rim, (*AT, RADIUS), atol=0.2)
    assert (
        found.region
        == find((), frame_size=SIZE, outline=(*AT, RADIUS), radius_mm=50.0, focal_px=2098.0).region
    )
