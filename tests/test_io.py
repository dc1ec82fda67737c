"""What a raw file says of itself, and what LibRaw makes of its margins."""

from types import SimpleNamespace

import numpy as np
import plain_dng
import pytest

from calibration.errors import InputError
from pipeline import io
from pipeline.files import decoding, raw

ORDERS = ("RGGB", "BGGR", "GRBG", "GBRG")
BLACKS = (100, 200, 300, 400)
LIGHT = {"R": 1000, "G": 2000, "B": 3000}
AS_SHOT = {"time_s": 1.0, "iso": 100.0, "f_number": 1.0}


def write_masked(path, cfa: str, top: int, left: int, size=(60, 80)):
    """A DNG with a masked border whose samples show each pixel's own black level and colour."""
    raw = np.full(size, 77)
    inside = raw[top:-2, left:-4]
    for y in (0, 1):
        for x in (0, 1):
            inside[y::2, x::2] = BLACKS[2 * y + x] + LIGHT[cfa[2 * y + x]]
    area = (top, left, size[0] - 2, size[1] - 4)
    plain_dng.write(
        path,
        raw,
        black_level=BLACKS,
        saturation_level=15000,
        time_s=(1, 30),
        cfa=cfa,
        active_area=area,
    )


@pytest.mark.parametrize("cfa", ORDERS)
@pytest.mark.parametrize("margin", [(0, 0), (6, 4), (7, 4), (6, 5), (1, 1)])
def test_colours_and_black_levels_fit_the_samples_whatever_the_margins(tmp_path, cfa, margin):
    path = tmp_path / "masked.dng"
    write_masked(path, cfa, *margin)
    frame = io.read_frame(path, **AS_SHOT)
    height, width = frame.samples.shape
    assert height in (58 - margin[0], 58 - margin[0] - 1)  # odd ones may be left out
    assert width in (76 - margin[1], 76 - margin[1] - 1)
    for y in (0, 1):
        for x in (0, 1):
            signal = frame.samples[y::2, x::2] - frame.black_level[y, x]
            assert (signal == LIGHT["RGB"[frame.cfa[y, x]]]).all()


@pytest.mark.parametrize(("top", "left"), [(51, 142), (52, 161), (51, 161), (52, 142)])
def test_the_pattern_begins_at_the_first_visible_pixel(top, left):
    """rawpy's begins at the first of all; some cameras mask an odd number of rows."""
    visible = np.array([[0, 1], [3, 2]])
    of_all = visible[np.ix_([-top % 2, (1 - top) % 2], [-left % 2, (1 - left) % 2])]
    opened = SimpleNamespace(
        raw_pattern=of_all, sizes=SimpleNamespace(top_margin=top, left_margin=left)
    )
    np.testing.assert_array_equal(raw._visible_pattern(opened), visible)


def test_x_trans_is_refused_with_a_sentence(tmp_path):
    opened = SimpleNamespace(
        raw_pattern=np.ones((6, 6), int),
        raw_type=SimpleNamespace(name="Flat"),
        sizes=SimpleNamespace(top_margin=0, left_margin=0),
    )
    with pytest.raises(InputError, match=r"6 x 6 colour filter array \(X-Trans\?\)"):
        raw._cfa(opened, tmp_path / "x.raf")


def write(path, **tags):
    tags = {"time_s": (1, 30), **tags}
    samples = np.full((60, 80), 900)
    plain_dng.write(path, samples, black_level=100, saturation_level=15000, **tags)
    return path


@pytest.fixture
def decoded(monkeypatch):
    """The files whose samples were decoded; in this process, where that can be seen."""
    files = []
    unpack = raw._unpack
    monkeypatch.setattr(
        raw, "_unpack", lambda opened, path: (files.append(path.name), unpack(opened, path))
    )
    monkeypatch.setattr(decoding, "run", decoding._here)
    return files


def test_of_photographs_of_a_kind_one_is_decoded(tmp_path, decoded):
    paths = [write(tmp_path / f"{i}.dng", time_s=(1, 10 + i), iso=200) for i in range(4)]
    shots, problems = io.read_shots(paths)
    assert not problems
    assert decoded == ["0.dng"]
    assert [shot.time_s for shot in shots] == pytest.approx([1 / 10, 1 / 11, 1 / 12, 1 / 13])
    assert {(s.iso, s.f_number, s.size, s.cfa) for s in shots} == {(200.0, 8.0, (60, 80), "RGGB")}


def test_what_tells_too_little_or_is_another_is_decoded_too(tmp_path, decoded):
    write(tmp_path / "0.dng")
    write(tmp_path / "1.dng", time_s=None)
    write(tmp_path / "2.dng", model="Other")
    write(tmp_path / "3.dng", iso=65535)
    write(tmp_path / "4.dng")
    shots, problems = io.read_shots(sorted(tmp_path.iterdir()))
    assert sorted(decoded) == ["0.dng", "1.dng", "2.dng", "3.dng"]
    assert [problem.file.name for problem in problems] == ["1.dng"]
    assert [shot.path.name for shot in shots] == ["0.dng", "2.dng", "3.dng", "4.dng"]


def test_a_file_that_is_too_short_is_found_by_its_directory(tmp_path, decoded):
    paths = [write(tmp_path / f"{i}.dng") for i in range(3)]
    paths[1].write_bytes(paths[1].read_bytes()[:-100])
    shots, problems = io.read_shots(paths)
    assert [shot.path.name for shot in shots] == ["0.dng", "2.dng"]
    assert len(problems) == 1
    assert "1.dng: the raw data cannot be decoded" in str(problems[0])
    assert sorted(decoded) == ["0.dng", "1.dng"]


def test_where_the_first_is_damaged_the_next_is_what_others_are_like(tmp_path, decoded):
    paths = [write(tmp_path / f"{i}.dng") for i in range(4)]
    paths[0].write_bytes(b"no photograph")
    shots, problems = io.read_shots(paths)
    assert [shot.path.name for shot in shots] == ["1.dng", "2.dng", "3.dng"]
    assert len(problems) == 1
    assert decoded == ["1.dng"]
