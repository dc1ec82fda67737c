import numpy as np
import pytest

from stages.merge import InMemory, merge
from stages.scale import scale, scaled, warnings
from stages.types import Lights
from tests.test_merge import expose, steps_of_light

ELECTRONIC = {"cyan": (1 / 60, 1 / 15), "yellow": (1 / 500, 1 / 60, 1 / 15)}


def lights(tags, times, series):
    """A bracket whose ratios are known exactly, on the scale of the series."""
    off = np.exp(np.mean(np.log(np.divide(series, times))))
    return Lights(tags, series, tuple(off * np.array(times)), tuple(range(len(tags))))


def test_a_bracket_that_cannot_tell_the_shutter_follows_one_that_can():
    rng = np.random.default_rng(1)
    world, _ = steps_of_light(brightest=50.0, n=12)
    merged = [
        merge(InMemory([expose(world, t, t, rng) for t in tags])) for tags in ELECTRONIC.values()
    ]
    found = scale([Lights.of(one) for one in merged])
    assert found.to_the_letter
    assert found.doubt == 0
    # The first takes 1/60 for 1/64 by itself; the second knows better.
    np.testing.assert_allclose(found.factors, [15 / 16, 1], rtol=2e-3)
    for one, factor, times in zip(merged, found.factors, ELECTRONIC.values(), strict=True):
        right = scaled(one, factor)
        np.testing.assert_allclose(right.solved, times, rtol=2e-3)
        # Saturation is of the raw samples: what of it is light follows the exposures.
        np.testing.assert_allclose(right.at_least, 0.985 / min(times), rtol=5e-3)
        bright = right.mosaic[:, 60:80] / world[:, 60:80]
        assert np.mean(bright) == pytest.approx(1, abs=4e-3)
        spread = np.var(bright) * world[0, 62] ** 2
        assert spread == pytest.approx(np.mean(right.variance[:, 60:80]), rel=0.5)


def test_a_shutter_of_powers_of_two_is_left_as_it_is():
    cyan = lights((1 / 60, 1 / 15), (1 / 64, 1 / 16), (1 / 64, 1 / 16))
    yellow = lights((1 / 60, 1 / 2), (1 / 64, 1 / 2), (1 / 64, 1 / 2))
    found = scale([cyan, yellow])
    assert not found.to_the_letter
    np.testing.assert_allclose(found.factors, 1, rtol=1e-12)
    assert warnings(found, ["cyan", "yellow"]) == []


def test_a_shutter_that_nothing_tells_is_doubted_where_it_matters():
    cyan = lights((1 / 60, 1 / 15), (1 / 60, 1 / 15), (1 / 64, 1 / 16))
    yellow = lights((1 / 500, 1 / 125), (1 / 500, 1 / 125), (1 / 512, 1 / 128))
    found = scale([cyan, yellow])
    assert found.doubt == pytest.approx((64 / 60) / (512 / 500) - 1, rel=1e-6)
    (said,) = warnings(found, ["cyan", "yellow"])
    assert "cyan and yellow may differ in scale by 4.2%" in said
    # The same times through each filter: whatever they are, they cancel.
    assert warnings(scale([cyan, cyan]), ["cyan", "yellow"]) == []


def test_a_file_given_twice_has_no_say():
    cyan = lights((1 / 60, 1 / 15), (1 / 64, 1 / 16), (1 / 64, 1 / 16))
    twice = Lights(*((*v, v[0]) for v in (cyan.tagged, cyan.series, cyan.solved)), (0, 1, 0))
    assert scale([twice]) == scale([cyan])
