"""`sixlight inspect`: what a capture holds, and what is missing from it."""

import json

import numpy as np
import plain_dng
import pytest
import small_capture

SHARES = {"clipped": 0.125, "lit": 0.5}  # of the photographs below


def photograph(path, *, dark: float, tag, **tags):
    """Grey, an eighth of it clipped and a share of it black."""
    samples = np.full(small_capture.SIZE, small_capture.BLACK + 3000)
    samples[: small_capture.SIZE[0] // 8] = small_capture.SATURATION
    samples[round((1 - dark) * len(samples)) :] = small_capture.BLACK
    levels = {"black_level": small_capture.BLACK, "saturation_level": small_capture.SATURATION}
    plain_dng.write(path, samples, time_s=tag, **levels, **tags)


@pytest.fixture
def wanting(small):
    """The small capture whose cyan bracket wants an exposure everywhere."""
    for path in sorted((small / "cyan").iterdir()):
        path.unlink()
    for name, tag in (("a", (2, 1)), ("b", (1, 10)), ("c", (1, 640)), ("d", (1, 40))):
        photograph(small / "cyan" / f"{name}.dng", dark=0.5, tag=tag)
    return small


def test_exposures_are_listed_shortest_first_with_what_they_hold(sixlight, wanting):
    told = json.loads(sixlight("inspect", wanting, "--json").out)
    cyan = told["filters"][0]
    assert [one["file"] for one in cyan["exposures"]] == ["c.dng", "d.dng", "b.dng", "a.dng"]
    assert [one["time_s"] for one in cyan["exposures"]] == pytest.approx([1 / 640, 1 / 40, 0.1, 2])
    for one in cyan["exposures"]:
        assert {key: one[key] for key in SHARES} == pytest.approx(SHARES)


def test_what_a_bracket_wants_is_advised(sixlight, wanting):
    told = json.loads(sixlight("inspect", wanting, "--json").out)["advice"]
    shorter, longer, between = (one for one in told if one.startswith("cyan"))
    assert "1/640 s, still clips 12.50% of the picture: add 1/2560 s" in shorter
    assert "50% of the longest exposure, 2 s, lies under 1 % of full scale: add 8 s" in longer
    assert "b.dng and a.dng lie 4.3 EV apart" in between
    text = sixlight("inspect", wanting).out
    assert "advice: cyan: the shortest exposure, 1/640 s" in text
    assert "12.50%" in text


def test_a_bracket_that_wants_nothing_is_not_advised(sixlight, small):
    for name in small_capture.SHIFTS:
        for path in sorted((small / name).iterdir())[1:]:
            path.unlink()
        (path,) = (small / name).iterdir()
        grey = np.full(small_capture.SIZE, small_capture.BLACK + 3000)
        small_capture.write_shot(path, grey, (1, 30))
    told = json.loads(sixlight("inspect", small, "--json").out)
    assert told["advice"] == []
