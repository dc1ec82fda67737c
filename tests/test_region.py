import numpy as np
import pytest
from sphere_tracer import Camera, chromium, photograph, smooth_world

from calibration.errors import InputError
from stages.locate import locate
from stages.overlay import overlay
from stages.region import Region
from stages.types import Frame, Measured

LENS = {"radius_mm": 50.0, "distance_mm": 1500.0}
AT, RADIUS = (250.4, 150.7), 60.0


@pytest.mark.parametrize("frame", [(301, 423), (300, 422)])
@pytest.mark.parametrize(
    ("low", "high"),
    [((31.2, 17.9), (200.3, 155.5)), ((-9, -50), (500, 600)), ((400, 290), (422, 299))],
)
def test_a_region_holds_what_is_asked_and_begins_on_a_whole_cell(frame, low, high):
    region = Region.around(low, high, frame)
    assert region.top % 2 == region.left % 2 == 0
    assert 0 <= region.top < region.bottom <= frame[0]
    assert 0 <= region.left < region.right <= frame[1]
    assert region.left <= max(low[0], 0)
    assert region.right >= min(high[0], frame[1])
    assert region.top <= max(low[1], 0)
    assert region.bottom >= min(high[1], frame[0])
    assert region.share == pytest.approx(np.prod(region.shape) / np.prod(frame))


def test_a_small_move_makes_no_other_region():
    one, other = (Region.around((33 + d, 35), (90, 90 - d), (200, 300)) for d in (0.0, 0.4))
    assert one == other


def test_the_whole_is_a_region_too():
    whole = Region.whole((301, 423))
    assert whole.shape == whole.frame == (301, 423)
    assert whole.share == 1.0


def test_the_cfa_of_a_part_is_that_of_the_whole():
    rows, columns = np.mgrid[:40, :50]
    samples = (rows % 2 * 2 + columns % 2).astype(np.uint16)
    levels = np.arange(4.0).reshape(2, 2)
    frame = Frame(samples, levels.astype(int), levels, levels + 9, 1.0, 100.0, 1.0)
    part = Region.around((7, 9), (31, 28), (40, 50)).part_of(frame)
    for y in (0, 1):
        for x in (0, 1):
            assert (part.samples[y::2, x::2] == part.cfa[y, x]).all()


@pytest.fixture(scope="module")
def picture():
    """A sphere far off the optical axis, where a wrong principal point would show."""
    camera = Camera.seeing(*AT, RADIUS, 260, 340)
    light = photograph(camera, smooth_world(4), chromium, samples=1, rim_samples=4)
    light = light.reshape(*light.shape[:2], -1).astype(np.float32)
    noise = np.random.default_rng(1).normal(0, 0.003, light.shape).astype(np.float32)
    values = light * (1 + noise)
    return Measured(values, (0.003 * light) ** 2 + 1e-6, np.ones(light.shape[:2], np.float32))


def part_of(image: Measured, region: Region) -> Measured:
    rows, columns = region.of_frame
    return Measured(*(a[rows, columns] for a in (image.values, image.variance, image.valid)))


def test_a_sphere_in_a_region_is_where_it_is_in_the_photograph(picture):
    region = Region.around((165, 70), (330, 235), (260, 340))
    assert region.share < 0.5
    whole = locate([picture], **LENS)
    part = locate([part_of(picture, region)], region=region, **LENS)
    np.testing.assert_allclose(part.principal_px, (170.0, 130.0))
    # The rim is measured on the same pixels; the search before it ends a hair elsewhere.
    np.testing.assert_allclose(
        [*part.centre_px, part.rim_px], [*whole.centre_px, whole.rim_px], atol=0.02
    )
    np.testing.assert_allclose(part.centre_mm, whole.centre_mm, rtol=1e-3)
    inside = region.inside(part)
    np.testing.assert_allclose(
        inside.direction_of(np.subtract(AT, region.origin_px)), part.direction_of(AT), atol=1e-12
    )


def test_outlines_and_messages_are_in_px_of_the_photograph(picture):
    region = Region.around((165, 70), (330, 235), (260, 340))
    sphere = locate([part_of(picture, region)], region=region, outline=(*AT, RADIUS), **LENS)
    rim = sphere.outline()
    np.testing.assert_allclose((rim.min(0) + rim.max(0)) / 2, AT, atol=1e-3)
    with pytest.raises(InputError, match=r"the sphere at 250, 151 px.*right.*within 340 x 260 px"):
        locate([part_of(picture, region)], region=region, outline=(*AT, 95.0), **LENS)


def test_the_rim_is_drawn_where_it_is_in_the_region(picture):
    region = Region.around((165, 70), (330, 235), (260, 340))
    sphere = locate([picture], outline=(*AT, RADIUS), **LENS)
    drawn = overlay(part_of(picture, region), sphere, region)
    assert drawn.shape[:2] == region.shape
    green = (drawn[..., 1] > drawn[..., 0] + 0.2) & (drawn[..., 1] > drawn[..., 2] + 0.2)
    y, x = np.nonzero(green[40:])  # below the words
    away = np.hypot(x + 0.5 + region.left - AT[0], y + 40.5 + region.top - AT[1])
    on_rim = away[away > 15]  # the cross in the middle apart
    assert len(on_rim) > 200
    assert np.abs(on_rim - RADIUS).max() < 1.6
