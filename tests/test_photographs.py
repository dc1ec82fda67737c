import json
import math
import struct

import numpy as np
import plain_dng
import pytest
import small_capture

from pipeline import capture
from pipeline.files import raw

QUICK = {"black_level": small_capture.BLACK, "saturation_level": small_capture.SATURATION}


def write(path, samples=None, *, size=small_capture.SIZE, time_s=(1, 8), **tags):
    """A raw file of the small capture's camera; grey where no samples are given."""
    path.parent.mkdir(parents=True, exist_ok=True)
    samples = np.full(size, 3000) if samples is None else samples
    plain_dng.write(path, samples, time_s=time_s, **QUICK, **tags)


def retag(path, **tags):
    """The same photograph again, with other tags."""
    import rawpy

    with rawpy.imread(str(path)) as opened:
        samples = opened.raw_image_visible.copy()
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


def refocus(folder, name, distances_m):
    for path, focus_m in zip(sorted((folder / name).iterdir()), distances_m, strict=True):
        retag(path, focus_m=focus_m)


def test_a_focus_that_changes_is_told(small):
    count = len(list((small / "cyan").iterdir()))
    metre, far, unknown = (1, 1), (2**32 - 1, 1), (0, 1)
    refocus(small, "cyan", [metre] * count)
    refocus(small, "yellow", [unknown] + [metre] * (count - 1))
    assert "focus" not in notes(small)
    refocus(small, "yellow", [(12, 10)] * count)
    assert "focus changes between the filters (cyan 1 m, yellow 1.2 m)" in notes(small)
    refocus(small, "cyan", [metre] * (count - 1) + [far])
    assert "cyan: focus changes within the bracket (1 m, infinity)" in notes(small)


def directory(entries, at):
    """A TIFF directory, little endian, of tag -> (type, count, bytes), to lie at `at`."""
    table, data = struct.pack("<H", len(entries)), b""
    data_at = at + 2 + 12 * len(entries) + 4
    for tag, (kind, count, value) in sorted(entries.items()):
        here = value if len(value) <= 4 else struct.pack("<I", data_at + len(data))
        table += struct.pack("<HHI", tag, kind, count) + here.ljust(4, b"\0")
        data += value if len(value) > 4 else b""
    return table + bytes(4) + data


@pytest.mark.parametrize(
    ("make", "note", "focus_m"),
    [
        ("Canon", {4: (3, 34, struct.pack("<34H", *[0] * 19, 187, *[0] * 14))}, 1.87),
        ("Canon", {4: (3, 34, struct.pack("<34H", *[0] * 19, 65535, *[0] * 14))}, math.inf),
        ("Canon", {4: (3, 34, bytes(68))}, None),
        ("NIKON", {0x85: (5, 1, struct.pack("<2I", 15, 10))}, 1.5),
        ("Other", {4: (3, 34, bytes(68))}, None),
        ("Canon", {4: (3, 60000, struct.pack("<I", 2**31))}, None),  # leads out of the file
    ],
)
def test_the_focus_is_read_from_makers_notes(tmp_path, make, note, focus_m):
    head = struct.pack("<2sHI", b"II", 42, 8)
    name = make.encode() + b"\0"

    def built(exif_at, note_at, size):
        main = {271: (2, len(name), name), 34665: (4, 1, struct.pack("<I", exif_at))}
        made = directory(note, note_at)
        return directory(main, 8), directory({0x927C: (7, size, made.ljust(size))}, exif_at), made

    main, exif, made = built(0, 0, 5)  # for their lengths
    exif_at = 8 + len(main)
    main, exif, _ = built(exif_at, exif_at + 2 + 12 + 4, len(made))
    file = tmp_path / "photograph.tif"
    file.write_bytes(head + main + exif)
    assert raw._focus_m(raw._tags(file)) == (None if focus_m is None else pytest.approx(focus_m))


def test_dark_and_flat_frames_are_found(small):
    write(small / "dark" / "1.dng", time_s=(1, 8))
    for i in (1, 2):
        write(small / "flat" / "cyan" / f"{i}.dng")
    found = capture.load(small)
    assert [f.name for f in found.filters] == ["cyan", "yellow"]
    assert [shot.path.name for shot in found.of_sensor.dark] == ["1.dng"]
    assert {name: len(shots) for name, shots in found.of_sensor.flat.items()} == {"cyan": 2}
    assert "dark" not in "\n".join(found.notes)


def test_what_exif_lacks_is_checked_once_for_all_photographs(sixlight, small):
    write(small / "dark" / "1.dng")
    with (small / "capture.toml").open("a") as toml:
        toml.write('\n[camera]\niso = "high"\nf_number = 0.1\n')
    outcome = sixlight("inspect", small)
    assert outcome.status == 2
    assert outcome.err.count("iso is 'high'") == 1, outcome.err
    assert outcome.err.count("f_number is 0.1") == 1


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


@pytest.mark.slow
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
