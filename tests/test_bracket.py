import numpy as np
import plain_dng
import pytest

from calibration.errors import InputError
from pipeline.bracket import Bracket, frames
from stages.region import Region

SIZE = (60, 80)
GIVEN = {"time_s": 1.0, "iso": 100.0, "f_number": 1.0}


def bracket(folder, samples, region=None, **tags):
    files = []
    for i, values in enumerate(samples):
        files.append(folder / f"{i}.dng")
        plain_dng.write(
            files[-1], values, black_level=0, saturation_level=9000, time_s=(1, 9), **tags
        )
    return Bracket(files, [GIVEN] * len(files), folder, region)


def three():
    rng = np.random.default_rng(1)
    return rng.integers(0, 9000, (3, *SIZE)).astype(np.uint16)


@pytest.mark.parametrize("region", [None, Region(10, 41, 32, 76, SIZE)])
def test_rows_are_those_of_the_files_or_of_their_region(tmp_path, region):
    samples = three()
    part = samples if region is None else samples[:, 10:41, 32:76]
    with bracket(tmp_path, samples, region).decoded(lambda f: f.samples.copy()) as decoded:
        np.testing.assert_array_equal(decoded.seen, part)
        np.testing.assert_array_equal(decoded.rows(4, 29), part[:, 4:29])


def test_frames_come_one_by_one(tmp_path):
    samples = three()
    made = bracket(tmp_path, samples)
    for frame, expected in zip(frames(made.files, made.exposures), samples, strict=True):
        np.testing.assert_array_equal(frame.samples, expected)


def test_a_file_of_another_size_or_pattern_is_refused(tmp_path):
    for other in ({"samples": np.ones((60, 78), np.uint16)}, {"cfa": "BGGR"}):
        made = bracket(tmp_path, three())
        given = {"samples": three()[0], "cfa": "RGGB", **other}
        plain_dng.write(
            made.files[1],
            given["samples"],
            black_level=0,
            saturation_level=9000,
            time_s=(1, 9),
            cfa=given["cfa"],
        )
        with (
            pytest.raises(InputError, match=r"1\.dng: .* in the pattern .*as in 0\.dng"),
            made.decoded(lambda frame: None),
        ):
            pass


def test_a_damaged_file_is_named_in_one_line_and_libraw_says_nothing(tmp_path, capfd):
    made = bracket(tmp_path, three())
    made.files[2].write_bytes(made.files[2].read_bytes()[:-100])
    with pytest.raises(InputError) as error, made.decoded(lambda frame: None):
        pass
    assert "2.dng: the raw data cannot be decoded" in str(error.value)
    assert capfd.readouterr().err == ""
