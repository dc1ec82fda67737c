"""Parts left out of the photographs, drawn or painted, and what capture.toml says of them."""

import cv2
import numpy as np
import pytest
import small_capture

from calibration.errors import InputError
from pipeline import capture
from stages.mask import Mask, leave_out
from stages.region import Region
from stages.types import Measured

FRAME = (60, 80)
WHOLE = Region.whole(FRAME)


def test_a_square_leaves_out_the_pixels_whose_middles_it_holds():
    out = Mask([[(10.0, 5.0), (20.4, 5.0), (20.4, 9.6), (10.0, 9.6)]]).of(WHOLE)
    expected = np.zeros(FRAME, bool)
    expected[5:10, 10:20] = True  # middles up to 19.5 and 9.5
    np.testing.assert_array_equal(out, expected)


def test_a_slanting_polygon_is_filled_as_opencv_fills_it_but_for_its_edge():
    corners = np.array([(12, 50), (40, 3), (70, 44), (41, 30)])  # not convex
    theirs = cv2.fillPoly(np.zeros(FRAME, np.uint8), [corners], 1) > 0
    ours = Mask([(corners + 0.5).tolist()]).of(WHOLE)
    edge = cv2.polylines(np.zeros(FRAME, np.uint8), [corners], True, 1, thickness=2) > 0
    assert ours.sum() > 500
    np.testing.assert_array_equal(ours[~edge], theirs[~edge])


def test_a_painted_mask_comes_back_from_its_runs_and_a_part_is_a_part_of_it():
    painted = np.random.default_rng(2).random(FRAME) < 0.3
    painted[-1, -1] = True
    mask = Mask.painted(painted)
    np.testing.assert_array_equal(mask.of(WHOLE), painted)
    drawn = Mask([[(3.0, 2.0), (70.0, 20.0), (30.0, 55.0)]], mask.runs)
    part = Region(14, 50, 6, 66, FRAME)
    np.testing.assert_array_equal(drawn.of(part), drawn.of(WHOLE)[14:50, 6:66])
    assert drawn.of(WHOLE).sum() > painted.sum()


def test_what_is_left_out_is_not_known_and_all_else_stays():
    image = Measured(
        np.ones((*FRAME, 3), np.float32), np.ones((*FRAME, 3), np.float32), np.ones(FRAME)
    )
    out = leave_out(image, Mask([[(10, 10), (30, 10), (30, 40), (10, 40)]]), WHOLE)
    there = np.zeros(FRAME, bool)
    there[10:40, 10:30] = True
    assert np.isnan(out.values[there]).all()
    assert np.isnan(out.variance[there]).all()
    assert (out.values[~there] == 1).all()
    np.testing.assert_array_equal(out.valid, ~there)
    assert leave_out(image, Mask(), WHOLE) is image


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return small_capture.make(tmp_path_factory.mktemp("masked"))


def loaded(folder, text):
    toml = folder / "capture.toml"
    before = toml.read_text()
    toml.write_text(before + text)
    try:
        return capture.load(folder)
    finally:
        toml.write_text(before)


def test_capture_toml_gives_polygons_and_a_painted_file(folder):
    height, width = small_capture.SIZE
    painted = np.zeros((height, width), np.uint8)
    painted[:20, :30] = 255
    cv2.imwrite(str(folder / "mask.png"), painted)
    mask = loaded(
        folder, '[mask]\nfile = "mask.png"\npolygons = [[[0, 200], [300, 200], [300, 240]]]\n'
    ).mask
    whole = Region.whole((height, width))
    np.testing.assert_array_equal(Mask(runs=mask.runs).of(whole), painted > 0)
    assert mask.of(whole)[239, 299]
    assert not mask.of(whole)[239, 1]
    assert loaded(folder, "").mask == Mask()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("polygons = [[[0, 0], [10, 0]]]", "three corners"),
        ("polygons = [[[0, 0], [10, 0], [nan, 4]]]", "three corners"),
        ("polygons = [[[0, 0], [10, 0], [301, 4]]]", "300 x 240 photograph"),
        ("polygons = 3", "a list of polygons"),
        ('file = "small.png"', "300 x 240 px"),
        ('file = "capture.toml"', "an image"),
        ("polygon = []", "not known here"),
    ],
)
def test_a_mask_that_cannot_be_is_refused(folder, text, said):
    cv2.imwrite(str(folder / "small.png"), np.zeros((24, 30), np.uint8))
    with pytest.raises(InputError, match=said):
        loaded(folder, f"[mask]\n{text}\n")


def test_a_distortion_that_folds_the_picture_back_is_refused(folder):
    lens = "[camera]\nfocal_length_mm = 3\npixel_pitch_um = 10\ndistortion = "
    assert loaded(folder, lens + "[-0.1, 0.01, 0]\n").distortion == (-0.1, 0.01, 0.0)
    with pytest.raises(InputError, match="folds back"):
        loaded(folder, lens + "[-2.0, 0, 0]\n")
    with pytest.raises(InputError, match="k1, k2, k3"):
        loaded(folder, lens + "[-0.1]\n")
