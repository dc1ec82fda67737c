import json

import numpy as np
import plain_dng
import pytest
import small_capture

from pipeline import capture

QUICK = {"black_level": small_capture.BLACK, "saturation_level": small_capture.SATURATION}


def write(path, samples=None, *, size=small_capture.SIZE, time_s=(1, 8), **tags):
    """A raw file of the small capture's camera; grey where no samples are given."""
    path.parent.mkdir(parents=True, exist_ok=True)
    samples = np.full(size, 3000) if samples is None else samples
    plain_dng.write(path, samples, time_s=time_s, **QUICK, **tags)


def retag(path, **tags):
    """The same photograph again, with other tags."""
    import rawpy

    with rawpy.imread(str(path)) as raw:
        samples = raw.raw_image_visible.copy()
    write(path, samples, **tags)


def notes(folder):
    return "\n".join(capture.load(folder).notes)


def test_what_changes_within_a_bracket_is_told(small):
    assert "within the bracket" not in notes(small)
    retag(small / "cyan" / "cyan_3.dng", iso=200)
    retag(small / "yellow" / "yellow_3.dng", f_number=(11, 1))
    said = notes(small)
    assert "cyan: ISO changes within the bracket (100, 200)" in said
    assert "yellow: aperture changes within the bracket (f/8, f/11)" in said
    assert "cyan: aperture" not in said


def test_dark_and_flat_frames_are_found(small):
    write(small / "dark" / "1.dng", time_s=(1, 8))
    for i in (1, 2):
        write(small / "flat" / "cyan" / f"{i}.dng")
    found = capture.load(small)
    assert [f.name for f in found.filters] == ["cyan", "yellow"]
    assert [shot.path.name for shot in found.of_sensor.dark] == ["1.dng"]
    assert {name: len(shots) for name, shots in found.of_sensor.flat.items()} == {"cyan": 2}
    assert "dark" not in "\n".join(found.notes)


def test_dark_frames_that_tell_little_are_noted(small):
    write(small / "dark" / "1.dng", time_s=(1, 1000), iso=800)
    assert "no dark frames at ISO 100" in notes(small)
    assert "dark frames of 0.001 s tell little" in notes(small)


def other_size(folder):
    write(folder / "dark" / "1.dng", size=(120, 150))


def other_camera(folder):
    write(folder / "flat" / "1.dng", model="Other")
    write(folder / "flat" / "2.dng")


def one_flat(folder):
    write(folder / "flat" / "yellow" / "1.dng")


@pytest.mark.parametrize(
    ("spoil", "found"),
    [
        (other_size, "dark/1.dng: size 150 x 120 (expected 300 x 240"),
        (other_camera, "flat/1.dng: camera 'Tests Other' (expected 'Tests Plain'"),
        (one_flat, "flat/yellow: one flat frame (expected two or more"),
    ],
)
def test_frames_of_the_sensor_that_do_not_fit_are_refused(sixlight, small, spoil, found):
    spoil(small)
    outcome = sixlight("inspect", small)
    assert outcome.status == 2
    assert outcome.err.count("\n") == 1
    assert found in outcome.err


def test_dark_and_flat_frames_are_used(sixlight, small, finished_once, tmp_path):
    rng = np.random.default_rng(1)
    current = 40.0  # raw steps a second, at every pixel
    seconds = 4
    steps = small_capture.BLACK + current * seconds + rng.normal(0, 3, small_capture.SIZE)
    write(small / "dark" / "1.dng", np.rint(steps), time_s=(seconds, 1))
    for i in (1, 2):
        grey = rng.poisson(9000, small_capture.SIZE)
        write(small / "flat" / f"{i}.dng", small_capture.BLACK + grey)
    outcome = sixlight("envmap", small, "-o", tmp_path / "out", "--face-size", 32)
    assert outcome.status == 0, outcome.err
    before, after = (
        json.loads((out / "result.json").read_text())["steps"]["merge cyan"]["learnt"]
        for out in (finished_once, tmp_path / "out")
    )
    assert (before["dark_frames"], before["flat_frames"]) == (0, 0)
    assert (after["dark_frames"], after["flat_frames"]) == (1, 2)
    with (
        np.load(finished_once / "work/merged_cyan.npz") as plain,
        np.load(tmp_path / "out/work/merged_cyan.npz") as without,
    ):
        taken = np.nanmedian(plain["mosaic"] - without["mosaic"])
    full = small_capture.SATURATION - small_capture.BLACK
    assert taken == pytest.approx(current / full * 64, rel=0.05)  # f/8
