"""The whole: photographs of a known world come back as that world, and only once."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import small_capture
import test_ktx2
from conftest import QUICK

from calibration import primaries
from calibration.errors import InputError
from pipeline import capture as captures
from pipeline import io, runner
from stages import cube


@pytest.fixture(scope="session")
def light(finished_once):
    measured, names = io.read_measured(finished_once / "cubemap.exr", cube=True)
    assert names == ("P1", "P2", "P3", "P4", "P5", "P6")
    return measured


@pytest.fixture(scope="session")
def truth(light):
    d = cube.directions(light.values.shape[1])
    spectra = small_capture.world(d.reshape(-1, 3))
    return primaries.load().project(spectra).reshape(*d.shape[:-1], 6)


def test_a_known_world_comes_back_as_that_world(light, truth):
    d = cube.directions(light.values.shape[1])
    near = d[..., 2] > np.cos(np.deg2rad(135))
    assert light.valid[near].min() > 0.999
    ratio = light.values[near] / truth[near]
    scale = np.median(ratio)  # known sensitivities leave the unit open
    error = np.abs(ratio / scale - 1)
    # Chiefly M_S: six bands cannot tell apart all that six other curves see.
    assert np.median(error) < 0.02
    assert np.percentile(error, 95) < 0.08


def test_the_world_is_the_right_way_round(light, truth):
    """Of all 24 turns and their mirror images only the identity fits."""
    n = 16
    d = cube.directions(n)
    seen = cube.sample(np.nan_to_num(light.values), d)[..., 2]
    known = d[..., 2] > -0.7
    best = {}
    for signs in np.ndindex(2, 2, 2):
        for order in ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)):
            turned = d[..., list(order)] * (1 - 2 * np.array(signs))
            there = cube.sample(truth, turned)[..., 2]
            best[order, signs] = np.corrcoef(seen[known], there[known])[0, 1]
    assert max(best, key=best.__getitem__) == ((0, 1, 2), (0, 0, 0))


def test_the_blind_cone_is_not_known(light):
    d = cube.directions(light.values.shape[1])
    blind = d[..., 2] < -np.cos(np.deg2rad(1.0))
    assert (light.valid[blind] == 0).all()
    assert np.isnan(light.values[blind]).all()


def test_the_maps_for_renderers_have_no_holes(finished_once, light):
    for name, channels in (("cubemap_123.exr", slice(0, 3)), ("cubemap_456.exr", slice(3, 6))):
        pixels, names, header = io.read_exr(finished_once / name)
        assert names == ["R", "G", "B"]
        assert np.isfinite(pixels).all()
        values = pixels.reshape((*light.values.shape[:3], 3)) * float(header["scale"])
        known = light.valid == 1
        np.testing.assert_allclose(values[known], light.values[known][:, channels], rtol=1e-3)


@pytest.fixture
def in_other_primaries(small):
    """The small capture, in a set of primaries to be named."""
    toml = small / "capture.toml"
    text = toml.read_text()

    def choose(name):
        toml.write_text(text.replace("[calibration]", f'[calibration]\nprimaries = "{name}"'))
        return small

    return choose


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "held"),
    [
        ("signed5", ["P1 P2 P3", "P4 P5"]),
        ("signed7", ["P1 P2 P3", "P4 P5 P6", "P7"]),
        ("signed8", ["P1 P2 P3", "P4 P5 P6", "P7 P8"]),
    ],
)
def test_any_count_of_channels_is_dealt_into_rgb_maps(
    sixlight, in_other_primaries, finished, name, held
):
    capture = in_other_primaries(name)
    assert "export" in again(sixlight, capture, finished)
    light, channels = io.read_measured(finished / "cubemap.exr", cube=True)
    assert channels == primaries.load(name).channels
    files = {f"cubemap_{h.replace('P', '').replace(' ', '')}.exr": h for h in held}
    textures = {Path(file).with_suffix(".ktx2").name for file in files}
    there = {p.name for p in finished.glob("cubemap_[0-9]*")}
    assert there == {*files, *textures}  # and none of before
    known = light.valid == 1
    for file, held_there in files.items():
        pixels, names, header = io.read_exr(finished / file)
        assert names == ["R", "G", "B"]
        assert header["channels"] == held_there
        texture = test_ktx2.parse((finished / file).with_suffix(".ktx2").read_bytes())
        assert texture.header["sixlight:scale"] == header["scale"]
        largest = texture.levels[0][..., :3]
        np.testing.assert_array_equal(largest.reshape(pixels.shape), pixels.astype(np.float16))
        values = pixels.reshape((*light.values.shape[:3], 3)) * float(header["scale"])
        columns = [channels.index(channel) for channel in held_there.split()]
        count = len(columns)
        np.testing.assert_allclose(
            values[known][:, :count], light.values[known][:, columns], rtol=1e-3, atol=1e-6
        )
        assert (values[..., count:] == 0).all()
        unused = header.get("unused", "").split(",")[0].split()
        assert unused == list("RGB"[count:])
    assert io.read_measured(finished / "latlong.exr")[1] == channels
    assert np.isfinite(io.read_exr(finished / "preview_teapot.exr")[0]).all()
    made = json.loads((finished / "result.json").read_text())["steps"]["export"]["made"]
    assert set(made) == {*files, *textures, "latlong.exr"}


@pytest.mark.slow
def test_a_map_of_ours_that_someone_changed_is_not_cleared_away(
    sixlight, in_other_primaries, finished
):
    (finished / "cubemap_456.exr").write_bytes(b"mine now")
    again(sixlight, in_other_primaries("signed5"), finished)
    assert (finished / "cubemap_456.exr").read_bytes() == b"mine now"


def test_headers_say_what_the_numbers_are(finished_once):
    _, _, header = io.read_exr(finished_once / "cubemap.exr")
    wanted = primaries.load("signed6")
    matrix = np.array(header["xyz_from_primaries"].split(), float).reshape(3, 6)
    np.testing.assert_allclose(matrix, wanted.xyz_from_primaries, rtol=1e-6)
    assert header["primaries"] == "signed6"
    peaks = np.array(header["peaks_nm"].split(), float)
    np.testing.assert_allclose(peaks, wanted.peaks_nm, rtol=1e-6)
    assert {"unit", "orientation", "calibration", "version", "step", "widths_nm"} <= set(header)


def again(sixlight, capture, out, *options) -> list[str]:
    """Steps done by another run."""
    outcome = sixlight("envmap", capture, "-o", out, *QUICK[1:], *options)
    assert outcome.status == 0, outcome.err
    steps = [line.split("] ", 1)[1] for line in outcome.err.splitlines() if line.startswith("[")]
    return [s.split(":")[0] for s in steps if not s.endswith("current")]


def test_nothing_is_done_again(sixlight, small, finished):
    before = (finished / "result.json").read_bytes()
    assert again(sixlight, small, finished) == []
    assert (finished / "result.json").read_bytes() == before


def test_touching_a_file_changes_nothing(sixlight, small, finished):
    for path in small.rglob("*"):
        path.touch()
    assert again(sixlight, small, finished) == []


def test_a_setting_reruns_what_hangs_on_it(sixlight, small, finished):
    assert again(sixlight, small, finished, "--preview-samples", "16") == ["preview", "report"]


@pytest.mark.slow
def test_the_metal_reruns_what_hangs_on_it(sixlight, small, finished):
    toml = small / "capture.toml"
    toml.write_text(toml.read_text().replace("stainless steel", "chromium"))
    done = again(sixlight, small, finished)
    assert done[0] == "locate"  # the rim is told by what the metal mirrors beside it
    later = ["normalise", "illuminants", "export", "preview", "view", "report"]
    assert done[-len(later) :] == later


@pytest.mark.slow
def test_a_photograph_reruns_its_own_filter_only(sixlight, small, finished):
    path = small / "yellow" / "yellow_3.dng"
    content = path.read_bytes()
    path.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    done = again(sixlight, small, finished)
    assert "merge yellow" in done
    assert "merge cyan" not in done


def test_a_spoilt_result_is_made_again(sixlight, small, finished):
    before = (finished / "cubemap.exr").read_bytes()
    (finished / "cubemap.exr").write_bytes(before[:1000])
    # And the report, unless the step took as long as before to the tenth of a second that it tells.
    assert again(sixlight, small, finished)[:1] == ["normalise"]
    assert (finished / "cubemap.exr").read_bytes() == before


@pytest.mark.slow
def test_results_do_not_depend_on_the_run(sixlight, small, finished, tmp_path):
    assert again(sixlight, small, tmp_path / "fresh")
    for name in ("cubemap.exr", "cubemap_123.exr", "latlong.exr", "preview_teapot.png"):
        assert (tmp_path / "fresh" / name).read_bytes() == (finished / name).read_bytes()


def test_without_a_calibration_the_bands_are_written(sixlight, small, tmp_path):
    toml = small / "capture.toml"
    toml.write_text(toml.read_text().split("[calibration]")[0])
    outcome = sixlight("envmap", small, "-o", tmp_path / "out")
    assert outcome.status == 0, outcome.err
    assert "no calibration" in outcome.err
    assert not (tmp_path / "out" / "cubemap.exr").exists()
    _, names = io.read_measured(tmp_path / "out" / "cubemap_bands.exr", cube=True)
    assert names == ("cyan.R", "cyan.G", "cyan.B", "yellow.R", "yellow.G", "yellow.B")


def test_result_json_says_what_was_read_and_made(finished_once):
    result = json.loads((finished_once / "result.json").read_text())
    assert len(result["inputs"]) == 8
    solved = result["steps"]["merge cyan"]["learnt"]["light_solved"]
    ratios = np.array(solved) / np.array(solved)[0]
    true = np.array(small_capture.TIMES_S) / small_capture.TIMES_S[0]
    np.testing.assert_allclose(ratios, true, rtol=3e-3)
    shift = result["steps"]["align"]["learnt"]["shifts"][1]
    np.testing.assert_allclose(shift, small_capture.SHIFTS["yellow"], atol=0.06)


def test_two_runs_on_one_output_do_not_mix(sixlight, small, finished):
    import fcntl

    with (finished / "work" / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        outcome = sixlight("envmap", small, "-o", finished, *QUICK)
    assert outcome.status == 2
    assert "another run" in outcome.err


def test_what_a_killed_run_left_is_cleared_away(sixlight, small, finished):
    leftover = finished / "work" / "unfinished-abc"
    leftover.mkdir()
    (leftover / "half.exr").write_bytes(b"v/1\x01")
    assert again(sixlight, small, finished) == []
    assert not leftover.exists()


def test_a_run_killed_before_it_said_whose_results_these_are_is_no_obstacle(small, tmp_path):
    work = tmp_path / "out" / "work"
    work.mkdir(parents=True)
    (work / "unfinished-capture.json").write_text("{")
    capture = captures.load(small)
    runner.claim(capture, tmp_path / "out", force=False)
    (work / "unfinished-capture.json").write_text("{")
    (work / "capture.json").unlink()
    (work / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match="did not write"):
        runner.claim(capture, tmp_path / "out", force=False)


@pytest.mark.slow
def test_a_finished_map_is_rendered_again_by_itself(sixlight, finished_once, tmp_path):
    options = ("-o", tmp_path, "--width", "192")
    outcome = sixlight("preview", finished_once, *options)
    assert outcome.status == 0, outcome.err
    for name in ("preview_teapot.png", "preview_teapot.exr"):
        assert (tmp_path / name).read_bytes() == (finished_once / name).read_bytes()
    assert sixlight("preview", finished_once, *options).status == 2  # not ours to replace there
    assert sixlight("preview", finished_once, *options, "--force").status == 0


@pytest.mark.parametrize(
    ("arguments", "naming"),
    [
        (("cubemap_123.exr",), "sigma.P1"),
        (("latlong.exr",), "six square faces"),
        (("cubemap_bands.exr",), "primaries"),
        (("result.json",), "not a readable image"),
        (("nothing.exr",), "no such file"),
        (("cubemap.exr", "--scene", "bunny"), "teapot"),
    ],
)
def test_what_is_no_map_is_not_rendered(sixlight, finished_once, tmp_path, arguments, naming):
    file, *rest = arguments
    outcome = sixlight("preview", finished_once / file, "-o", tmp_path / "new", *rest)
    assert outcome.status == 2
    assert naming in outcome.err
    assert len(outcome.err.splitlines()) == 1
    assert not (tmp_path / "new").exists()
