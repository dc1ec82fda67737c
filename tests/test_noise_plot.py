import json

import pytest
import small_capture

FULL_WELL = 40000.0  # electrons, of small_capture.samples


def test_the_noise_of_a_capture_is_told_in_electrons_and_drawn(
    sixlight, small_capture_once, tmp_path
):
    picture = tmp_path / "noise.png"
    asked = ("inspect", small_capture_once, "--noise", picture)
    told = json.loads(sixlight(*asked, "--json").out)["noise"]
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert [one["filter"] for one in told] == list(small_capture.SHIFTS)
    levels = small_capture.SATURATION - small_capture.BLACK
    for one in told:
        off = one["full_scale_electrons"] / FULL_WELL - 1
        assert abs(off) < max(4 * one["gain_sigma"], 0.02)
        assert one["electrons_per_step"] * levels == pytest.approx(one["full_scale_electrons"])
    text = sixlight(*asked).out
    assert "noise of cyan, ISO 100: " in text
    assert " e-/DN +-" in text
