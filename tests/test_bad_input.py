"""Every wrong input ends in a line that names it and says what to do, status 2, and no harm.

Each case spoils a good capture whose results stand already, and those must stay as they are.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
import small_capture
from conftest import QUICK, digests


def results(out: Path) -> dict[str, str]:
    """What a user has of a run; below work/ lie the runner's own intermediate files."""
    return {k: v for k, v in digests(out).items() if not k.startswith("work")}


@pytest.fixture
def refused(sixlight, small, finished_once, tmp_path):
    """Runs envmap on the spoilt capture over finished results; returns the lines it said."""
    out = tmp_path / "out"
    shutil.copytree(finished_once, out)
    # The results claim to be this copy's, as they would be had they been made from it.
    (out / "work" / "capture.json").write_text('{\n  "capture": "../small"\n}\n')
    before = results(out)

    def run(*naming: str, lines: int = 1, folder: Path = small) -> str:
        outcome = sixlight("envmap", folder, "-o", out, *QUICK)
        assert outcome.status == 2, outcome.err
        assert "Traceback" not in outcome.err
        said = outcome.err.strip().splitlines()
        assert len(said) == lines, outcome.err
        for words in naming:
            assert words in outcome.err
        assert results(out) == before
        return outcome.err

    return run


def raws(folder: Path, name: str = "cyan") -> list[Path]:
    return sorted((folder / name).iterdir())


def rewrite(folder: Path, raw, **tags) -> None:
    """Replaces every photograph of a capture by raw samples of its own making."""
    for name in small_capture.SHIFTS:
        for i, path in enumerate(raws(folder, name)):
            samples = raw(i) if callable(raw) else raw
            small_capture.write_shot(path, samples, small_capture.TAGS[i], **tags)


def test_no_such_folder(refused, tmp_path):
    refused("nowhere", "no such folder", folder=tmp_path / "nowhere")


def test_a_file_in_place_of_the_folder(refused, small):
    refused("is not a folder", folder=small / "capture.toml")


def test_no_raw_files(refused, small):
    for name in small_capture.SHIFTS:
        shutil.rmtree(small / name)
    refused("no raw files found", "cyan/")


def test_a_filter_missing(refused, small):
    shutil.rmtree(small / "yellow")
    refused("only one filter, 'cyan'", "add the other filter")


def test_filters_of_unequal_number(refused, small):
    raws(small)[0].unlink()
    refused("3 cyan, 4 yellow", "add the missing photographs")


def test_not_a_raw_file(refused, small):
    raws(small)[1].write_bytes(b"\x89PNG\r\n and then some" * 50)
    refused("cyan_1.dng", "not a raw file")


def test_truncated_raw_files_are_all_named_at_once(refused, small):
    for path in (raws(small)[1], raws(small, "yellow")[2]):
        path.write_bytes(path.read_bytes()[:-20000])
    refused("cyan_1.dng", "yellow_2.dng", "cannot be decoded", lines=2)


def test_data_damaged_within_are_refused_when_they_are_decoded(refused, small):
    """Such a file is as long as it says. Only compressed data can show that they are wrong."""
    pytest.importorskip("imagecodecs")
    import rawpy

    from pipeline.simulate.camera import Camera
    from pipeline.simulate.dng import Shot, write_dng

    levels = {"black_level": small_capture.BLACK, "saturation_level": small_capture.SATURATION}
    for name in small_capture.SHIFTS:
        for path, tag in zip(raws(small, name), small_capture.TAGS, strict=True):
            with rawpy.imread(str(path)) as raw:
                samples = raw.raw_image_visible.copy()
            shot = Shot(tag, datetime(2020, 1, 1), (1.0, 1.0, 1.0))
            write_dng(path, samples, replace(Camera(), **levels), shot, np.eye(3))
    path = raws(small, "yellow")[1]
    content = path.read_bytes()
    middle = len(content) // 2
    path.write_bytes(content[:middle] + bytes(9000) + content[middle + 9000 :])
    refused("yellow_1.dng", "cannot be decoded")


def test_no_colour_filter_array(refused, small):
    path = raws(small)[0]
    import tifffile

    with tifffile.TiffWriter(path) as tif:  # a linear DNG: three samples a pixel
        tif.write(
            np.full((*small_capture.SIZE, 3), 1000, np.uint16),
            photometric=34892,
            planarconfig=1,
            extratags=[
                (50706, 1, 4, bytes([1, 4, 0, 0]), True),
                (50707, 1, 4, bytes([1, 1, 0, 0]), True),
                (50708, 2, 0, "Test Linear", True),
                (33434, 5, 1, (1, 30), True),
            ],
        )
    refused("cyan_0.dng", "Bayer")


def test_photographs_of_different_cameras(refused, small):
    raw = np.full(small_capture.SIZE, 900, np.uint16)
    small_capture.write_shot(raws(small)[0], raw, model="Another")
    said = refused("camera", "keep photographs of one camera", lines=7)
    assert "cyan_1.dng" in said


def test_photographs_of_different_sizes(refused, small):
    height, width = small_capture.SIZE
    path = raws(small, "yellow")[3]
    small_capture.write_shot(path, np.full((height - 2, width), 900, np.uint16))
    refused("yellow_3.dng", f"{width} x {height - 2}", f"{width} x {height}")


def test_no_exposure_time(refused, small):
    path = raws(small)[2]
    raw = np.full(small_capture.SIZE, 900, np.uint16)
    small_capture.write_shot(path, raw, tag=None)
    refused("cyan_2.dng", "no exposure time", "times_s")


def test_all_saturated(refused, small):
    rewrite(small, np.full(small_capture.SIZE, small_capture.SATURATION, np.uint16))
    refused("saturate in every exposure", "add shorter exposures")


def test_all_black(refused, small):
    rng = np.random.default_rng(0)
    noise = rng.normal(small_capture.BLACK, 2, small_capture.SIZE).round().astype(np.uint16)
    rewrite(small, noise)
    refused("black", "expose longer")


def test_no_sphere(refused, small):
    rng = np.random.default_rng(0)
    height, width = small_capture.SIZE
    ramp = np.linspace(0.2, 1.0, width) * np.linspace(0.5, 1.0, height)[:, None]

    def photograph(i):
        colours = np.repeat(ramp[..., None], 3, axis=2) / small_capture.TIMES_S[2] * 0.5
        return small_capture.samples(colours, small_capture.TIMES_S[i], rng)

    rewrite(small, photograph)
    refused("sphere", "outline")


def test_a_sphere_cut_by_the_frame(refused, small):
    """The left part of every photograph is missing, and with it a piece of the sphere."""
    import rawpy

    for name in small_capture.SHIFTS:
        for i, path in enumerate(raws(small, name)):
            with rawpy.imread(str(path)) as raw:
                samples = raw.raw_image_visible[:, 90:].copy()
            small_capture.write_shot(path, samples, small_capture.TAGS[i])
    refused("sphere", "cut")


def with_toml(folder: Path, old: str, new: str) -> None:
    path = folder / "capture.toml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_a_transform_for_other_channels(refused, sixlight, small, tmp_path):
    names = ["--camera", small / "C.csv", "--filters", small / "other.csv"]
    (small / "other.csv").write_text((small / "F.csv").read_text().replace("yellow", "magenta"))
    assert sixlight("fit", *names, "-o", small / "M_S.toml").status == 0
    with_toml(small, 'camera = "C.csv"\nfilters = "F.csv"', 'transform = "M_S.toml"')
    refused("M_S.toml", "magenta", "yellow")


def test_a_transform_for_other_primaries(refused, sixlight, small):
    sensitivities = ["--camera", small / "C.csv", "--filters", small / "F.csv"]
    assert sixlight("fit", *sensitivities, "-o", small / "M_S.toml").status == 0
    assert sixlight("primaries", "signed6", "-o", small / "mine").status == 0
    matrix = small / "mine" / "xyz_from_primaries.csv"
    lines = matrix.read_text().splitlines()
    x = lines[1].split(",")
    x[1] = str(float(x[1]) + 0.01)
    matrix.write_text("\n".join([lines[0], ",".join(x), *lines[2:]]) + "\n")
    with_toml(
        small,
        'camera = "C.csv"\nfilters = "F.csv"',
        'transform = "M_S.toml"\nprimaries = "mine"',
    )
    refused("M_S.toml", "primaries")


@pytest.mark.parametrize(
    ("spoil", "naming"),
    [
        (lambda rows: [rows[0]] + [_scaled(r, 100) for r in rows[1:]], "percent"),
        (lambda rows: [rows[0]] + [_micrometres(r) for r in rows[1:]], "micrometres"),
        (lambda rows: [*rows[:3], rows[3].rsplit(",", 1)[0] + ",", *rows[4:]], "line 4"),
        (lambda rows: [*rows[:3], rows[3].rsplit(",", 1)[0] + ",nan", *rows[4:]], "line 4"),
        (lambda rows: [*rows[:3], rows[3].rsplit(",", 1)[0] + ",high", *rows[4:]], "high"),
    ],
    ids=["percent", "micrometres", "gap", "NaN", "text"],
)
def test_spectra_that_cannot_be_used(refused, small, spoil, naming):
    path = small / "F.csv"
    path.write_text("\n".join(spoil(path.read_text().splitlines())) + "\n")
    refused("F.csv", naming, lines=2 if naming == "percent" else 1)  # both columns are


def _scaled(row: str, factor: float) -> str:
    first, *rest = row.split(",")
    return ",".join([first, *(str(float(v) * factor) for v in rest)])


def _micrometres(row: str) -> str:
    first, *rest = row.split(",")
    return ",".join([str(float(first) / 1000), *rest])


def test_several_problems_are_listed_at_once(refused, small):
    with_toml(small, "radius_mm = 50.0", 'radius_mm = -50\ncolour = "red"')
    raws(small)[1].write_bytes(b"no photograph")
    refused("sphere.radius_mm", "sphere.colour", "cyan_1.dng", lines=3)


def test_toml_that_is_none(refused, small):
    (small / "capture.toml").write_text("name = \n")
    refused("capture.toml", "not TOML")


def test_files_outside_the_folder(refused, small):
    text = (small / "capture.toml").read_text()
    (small / "capture.toml").write_text(
        text + '[[filter]]\nname = "cyan"\nfiles = "../*"\n[[filter]]\nname = "yellow"\n'
    )
    refused("inside the capture's folder")


_CYAN, _YELLOW = '[[filter]]\nname = "cyan"\n', '[[filter]]\nname = "yellow"\n'


@pytest.mark.parametrize(
    ("added", "line"),
    [
        (
            f"{_CYAN}times_s = [0.1, 0.2]\n{_YELLOW}",
            "{folder}/cyan: 4 photographs but 2 times_s (expected one time per photograph, in order"
            " of the file names); correct times_s",
        ),
        (
            f"{_CYAN}{_CYAN}{_YELLOW}",
            "{folder}/capture.toml: filter[2].name is 'cyan' again (expected each filter once); "
            "merge or rename them",
        ),
        (
            f'{_CYAN}{_YELLOW}[[filter]]\nname = "deep red"\nfiles = "cyan/*"\n',
            "{folder}/capture.toml: filter[3].name is 'deep red' (expected a name without dots, "
            "slashes or spaces); rename it",
        ),
        (
            f'{_CYAN}{_YELLOW}[[filter]]\nname = "red"\n',
            "{folder}/capture.toml: filter[3].files is 'red/*', which matches no file (expected "
            "raw files); correct it",
        ),
        (
            "[camera]\niso = 0\n",
            "{folder}/capture.toml: camera.iso is 0 (expected a number in ISO, 1 to 1e+07); "
            "correct it",
        ),
    ],
    ids=["too few times", "a filter twice", "a name with a space", "no such files", "no ISO"],
)
def test_filters_and_camera_in_capture_toml(refused, small, added, line):
    path = small / "capture.toml"
    path.write_text(path.read_text() + added)
    assert refused().splitlines() == [line.format(folder=small)]


@pytest.mark.parametrize(
    ("given", "says"),
    [("0.05", "of 0.05, with which stainless steel would"), ("true", "sphere.reflectance is True")],
)
def test_a_reflectance_that_the_sphere_cannot_have(refused, small, given, says):
    path = small / "capture.toml"
    path.write_text(path.read_text().replace("[sphere]", f"[sphere]\nreflectance = {given}"))
    refused(f"{path}: ", says)


@pytest.mark.parametrize(
    ("room", "said"),
    [
        (
            "size_m = [4, 3, 5]",
            "room.sphere_m is missing (expected [x, y, z] in m, or distant = true)",
        ),
        ("size_m = [4, 3]\nsphere_m = [2, 1, 2]", "room.size_m is [4, 3]"),
        (
            "size_m = [4, 3, 5]\nsphere_m = [2, 3.5, 2]",
            "room.sphere_m is [2.0, 3.5, 2.0] (expected the whole sphere inside size_m",
        ),
        (
            "size_m = [4, 3, 5]\nsphere_m = [2, 1, 2]\ncamera_m = [2, 1, 5.5]",
            "room.camera_m is [2.0, 1.0, 5.5] (expected a place inside size_m [4.0, 3.0, 5.0])",
        ),
        (
            "size_m = [4, 3, 5]\nsphere_m = [2, 1, 2]\ncamera_m = [2, 1, 1]",
            "room.camera_m is [2.0, 1.0, 1.0] (expected its third number above 2.1",
        ),
        ("size_m = [4, 3, 5]\ndistant = true", "room.size_m is given beside distant = true"),
        (
            "size_m = [4, 3, 5]\nsphere_m = [2, 1, 2]\ndistant = 1",
            "room.distant is 1 (expected true or false)",
        ),
    ],
    ids=[
        "no sphere",
        "two numbers",
        "sphere outside",
        "camera outside",
        "camera behind",
        "near and far",
        "no flag",
    ],
)
def test_a_room_that_cannot_be(refused, small, room, said):
    path = small / "capture.toml"
    path.write_text(path.read_text() + f"[room]\n{room}\n")
    refused("capture.toml", said)


def test_a_folder_that_holds_something_else_is_left_alone(sixlight, small, tmp_path):
    out = tmp_path / "mine"
    out.mkdir()
    (out / "thesis.txt").write_text("three years of work")
    outcome = sixlight("envmap", small, "-o", out)
    assert outcome.status == 2
    assert "did not write" in outcome.err
    assert [p.name for p in out.iterdir()] == ["thesis.txt"]


def test_an_output_folder_that_cannot_be_written(sixlight, small, tmp_path):
    (tmp_path / "file").write_text("")
    outcome = sixlight("envmap", small, "-o", tmp_path / "file" / "out", *QUICK)
    assert outcome.status == 2
    assert len(outcome.err.splitlines()) == 1
    assert "-o" in outcome.err


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0, reason="mounting a small disk takes root")
@pytest.mark.parametrize("size", ["200k", "3m", "8m"])
def test_a_disk_that_fills_up(sixlight, small, tmp_path, size):
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", disk], capture_output=True
    )
    if mounted.returncode:
        pytest.skip("this machine does not let root mount a tmpfs")
    try:
        outcome = sixlight("envmap", small, "-o", disk / "out", *QUICK)
        assert outcome.status == 2
        assert len(outcome.err.splitlines()) == 1
        assert "no space" in outcome.err
        assert not list(disk.rglob("unfinished-*"))
    finally:
        subprocess.run(["umount", disk], check=True)


def test_no_opengl(sixlight, small, tmp_path, monkeypatch):
    """Everything but the picture is made; the line says what to install."""
    monkeypatch.setenv("GLCONTEXT_LINUX_LIBEGL", "libEGL_missing.so.1")
    outcome = sixlight("envmap", small, "-o", tmp_path / "out", *QUICK)
    assert outcome.status == 2
    assert "OpenGL" in outcome.err
    assert "apt-get install" in outcome.err
    assert len(outcome.err.splitlines()) == 1
    made = {p.name for p in (tmp_path / "out").iterdir()}
    assert {"cubemap.exr", "cubemap_123.exr", "latlong.exr"} <= made
    assert not any(name.startswith("preview") for name in made)


def test_unknown_options_take_one_line(sixlight):
    outcome = sixlight("envmap", "somewhere", "--nonsense")
    assert outcome.status == 2
    assert len(outcome.err.splitlines()) == 1
