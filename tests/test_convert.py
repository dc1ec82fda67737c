"""`sixlight convert`: files in, files out, what engines see in them, and what is refused."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import test_dds
import test_ktx2
from seen_from_inside import VIEWS, colours, directions
from sphere_tracer import Camera, chromium, photograph, smooth_world

from pipeline import io
from pipeline.convert import LAYOUTS, PRESETS, rotation
from stages import cube
from stages.layouts import LATLONG
from stages.types import Measured

N = 16
CUBES = ("cube", "hcross", "vcross", "faces")
NAMES = tuple(f"P{i}" for i in range(1, 7))


@pytest.fixture
def rgb(tmp_path):
    """A cube of `colours`, as one may come from anywhere: RGB, no header."""
    path = tmp_path / "rgb.exr"
    io.write_exr(path, colours(cube.directions(N)).reshape(6 * N, N, 3), "RGB", {})
    return path


@pytest.fixture
def six(tmp_path):
    """A measured cube of six channels with sigma, and a hole in the middle of -Z."""
    d = cube.directions(N)
    values = np.concatenate([colours(d), 2 * colours(d)], axis=-1).astype(np.float32)
    variance = np.full_like(values, 0.01)
    valid = np.where(d[..., 2] < -0.9, 0.0, 1.0).astype(np.float32)
    values[valid == 0] = variance[valid == 0] = np.nan
    path = tmp_path / "cubemap.exr"
    io.write_measured(path, Measured(values, variance, valid), NAMES, {"unit": "relative"})
    return path


def read(path):
    return io.read_exr(path)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_comes_back_to_the_cube_it_was(sixlight, tmp_path, rgb, layout):
    name = "there_{face}.exr" if layout == "faces" else "there.exr"
    there, back = tmp_path / name, tmp_path / "back.exr"
    size = N if layout in CUBES else 4 * N
    made = sixlight("convert", rgb, there, "--layout", layout, "--size", size)
    assert made.status == 0, made.err
    assert len(made.out.splitlines()) == (6 if layout == "faces" else 1)
    again = ["--from", "faces"] if layout == "faces" else []  # the others' headers say what it is
    assert sixlight("convert", there, back, "--layout", "cube", "--size", N, *again).status == 0
    pixels, names, header = read(back)
    start = read(rgb)[0]
    rgb_there = pixels[..., [names.index(c) for c in "RGB"]]
    # Packings are exact; a pixel of a mirror ball's rim spans tens of degrees.
    atol = {"mirrorball": 0.2, "latlong": 0.03, "angular": 0.03, "octahedral": 0.03}
    np.testing.assert_allclose(rgb_there, start, atol=atol.get(layout, 0))
    assert header["layout"] == "cube"
    assert header["orientation"].startswith("faces px nx py ny pz nz")


def test_what_was_measured_is_carried_along_with_its_meaning(sixlight, tmp_path, six):
    out = tmp_path / "latlong.exr"
    assert sixlight("convert", six, out, "--layout", "latlong").status == 0
    measured, names = io.read_measured(out)
    assert names == NAMES
    assert measured.values.shape == (2 * N, 4 * N, 6)
    middle = measured.valid[N - 1 : N + 1, 2 * N - 1 : 2 * N + 1]
    assert (middle == 0).all()
    assert (np.isnan(measured.values[..., 0]) == (measured.valid == 0)).all()
    known = measured.valid == 1
    assert 0.02 < np.sqrt(measured.variance[known]).mean() < 0.1
    _, _, header = read(out)
    assert header["layout"] == "latlong"
    assert header["unit"] == "relative"
    assert "centre column at -Z" in header["orientation"]


def test_filled_copies_have_no_holes_and_no_stray_channels(sixlight, tmp_path, six):
    out = tmp_path / "latlong.exr"
    assert sixlight("convert", six, out, "--layout", "latlong", "--fill").status == 0
    pixels, names, header = read(out)
    assert names == list(NAMES)
    assert np.isfinite(pixels).all()
    share = float(header["filled"].split("smoothly, ")[1].split("%")[0]) / 100
    np.testing.assert_allclose(share, (1 - 0.9) / 2, atol=0.02)  # the cap's, in texels
    at = LATLONG.direction(0, (np.arange(64) + 0.5)[None] / 64, (np.arange(32) + 0.5)[:, None] / 32)
    hidden = at[..., 2] < -0.9
    assert np.abs(pixels[hidden][:, :3] - colours(at[hidden])).max() < 0.6  # a smooth guess
    assert np.abs(pixels[~hidden][:, :3] - colours(at[~hidden])).max() < 0.2


def test_what_was_filled_stays_marked_and_what_had_no_holes_is_not(sixlight, tmp_path, six, rgb):
    filled, again, whole = (tmp_path / f"{name}.exr" for name in ("filled", "again", "whole"))
    assert sixlight("convert", six, filled, "--layout", "latlong", "--fill").status == 0
    assert sixlight("convert", filled, again, "--layout", "angular").status == 0
    assert sixlight("convert", rgb, whole, "--layout", "latlong", "--fill").status == 0
    assert read(again)[2]["filled"] == read(filled)[2]["filled"]
    assert "filled" not in read(whole)[2]
    texture = tmp_path / "out.ktx2"
    assert sixlight("convert", six, texture, "--channels", "P1,P2,P3").status == 0
    assert "filled smoothly" in test_ktx2.parse(texture.read_bytes()).header["sixlight:filled"]


def test_channels_are_chosen_by_name_and_engines_get_them_as_rgb(sixlight, tmp_path, six):
    two, three = tmp_path / "two.exr", tmp_path / "three.exr"
    assert sixlight("convert", six, two, "--layout", "cube", "--channels", "P4,P1").status == 0
    measured, names = io.read_measured(two, cube=True)
    assert names == ("P1", "P4")
    known = measured.valid == 1
    np.testing.assert_allclose(measured.values[known, 1], 2 * measured.values[known, 0], rtol=1e-5)
    made = sixlight("convert", six, three, "--preset", "unity", "--channels", "P6,P2,P3", "--json")
    assert json.loads(made.out)["channels"] == ["P6", "P2", "P3"]
    pixels, names, header = read(three)
    assert names == ["R", "G", "B"]
    assert header["channels"] == "P6 P2 P3"
    np.testing.assert_allclose(pixels[..., 0].mean(), 2 * pixels[..., 2].mean(), rtol=0.02)


def test_turns_are_what_the_interface_says():
    """yaw_deg 90: what was in +Z, towards the camera, is in +X."""
    x, y, z = np.eye(3)
    np.testing.assert_allclose(rotation("90") @ z, x, atol=1e-15)
    np.testing.assert_allclose(rotation("0,90") @ z, -y, atol=1e-15)
    np.testing.assert_allclose(rotation("0,0,90") @ x, y, atol=1e-15)
    np.testing.assert_allclose(rotation("90,0,90") @ x, y, atol=1e-15)  # roll comes first
    np.testing.assert_allclose(rotation("0,0,1,1,0,0,0,1,0") @ z, x, atol=1e-15)


def test_a_turned_map_shows_it_there_and_says_so(sixlight, tmp_path, rgb):
    out = tmp_path / "turned.exr"
    assert sixlight("convert", rgb, out, "--layout", "cube", "--turn", "90").status == 0
    pixels, _, header = read(out)
    wanted = colours(cube.directions(N) @ rotation("90"))
    # a world of slope 1.5 blurred by a part of a texel
    np.testing.assert_allclose(pixels.reshape(6, N, N, 3), wanted, atol=0.005)
    np.testing.assert_allclose(
        np.array(header["turned"].split(), float).reshape(3, 3), rotation("90"), atol=1e-8
    )


@pytest.mark.parametrize("suffix", ["ktx2", "dds"])
def test_textures_hold_the_cube_and_its_mips(sixlight, tmp_path, six, suffix):
    out = tmp_path / f"out.{suffix}"
    made = sixlight("convert", six, out, "--channels", "P1,P2,P3")
    assert made.status == 0, made.err
    content = out.read_bytes()
    levels = test_ktx2.parse(content).levels if suffix == "ktx2" else test_dds.parse(content)
    assert [level.shape[1] for level in levels] == [16, 8, 4, 2, 1]
    d = cube.directions(N)
    apart = np.abs(levels[0][..., :3] - colours(d))
    assert apart[d[..., 2] > -0.9].max() < 0.02  # half a step of half floats, and the hole's rim
    mean = colours(d).mean(axis=(0, 1, 2))
    np.testing.assert_allclose(levels[-1][..., :3].mean(axis=(0, 1, 2)), mean, atol=0.1)


def test_light_beyond_half_floats_is_scaled_and_the_file_says_by_what(sixlight, tmp_path):
    bright, out = tmp_path / "bright.exr", tmp_path / "out.ktx2"
    io.write_exr(bright, 1e6 * np.ones((24, 4, 3), np.float32), "RGB", {"scale": "4"})
    assert sixlight("convert", bright, out).status == 0
    texture = test_ktx2.parse(out.read_bytes())
    scale = float(texture.header["sixlight:scale"])
    np.testing.assert_allclose(texture.levels[0][..., 0].astype(float) * scale, 4e6, rtol=1e-3)


# -------------------------------------------------------------------- what programs see in them


@pytest.mark.parametrize("suffix", ["exr", "hdr"])
def test_mitsuba_shows_the_world_as_it_is(sixlight, tmp_path, rgb, suffix):
    mitsuba = pytest.importorskip("mitsuba")
    out = tmp_path / f"mitsuba.{suffix}"
    assert sixlight("convert", rgb, out, "--preset", "mitsuba", "--size", 64).status == 0
    mitsuba.set_variant("scalar_rgb")
    for towards, up in VIEWS:
        look = mitsuba.ScalarTransform4f().look_at([0, 0, 0], list(towards), list(up))
        film = {"type": "hdrfilm", "width": 12, "height": 12, "rfilter": {"type": "box"}}
        scene = mitsuba.load_dict(
            {
                "type": "scene",
                "world": {"type": "envmap", "filename": str(out)},
                "integrator": {"type": "direct"},
                "sensor": {"type": "perspective", "fov": 90, "to_world": look, "film": film},
            }
        )
        picture = np.array(mitsuba.render(scene, spp=32, seed=1))[..., :3]
        # RGBE steps of 1/128, the noise of 32 places in a pixel, and a map of 64 rows
        np.testing.assert_allclose(picture, colours(directions(towards, up, 12)), atol=0.06)


def test_blender_shows_the_world_as_it_is(sixlight, tmp_path, rgb):
    """In a glTF model's place: our +Y is Blender's +Z, our +Z its -Y."""
    python = os.environ.get("BLENDER_PYTHON")
    if python is None and importlib.util.find_spec("bpy") is None:
        pytest.skip("neither bpy is installed nor BLENDER_PYTHON names a Python that has it")
    out, views = tmp_path / "blender.hdr", tmp_path / "views.npy"
    assert sixlight("convert", rgb, out, "--preset", "blender", "--size", 64).status == 0
    script = Path(__file__).with_name("blender_views.py")
    subprocess.run(
        [python or sys.executable, str(script), str(out), str(views)],
        check=True,
        capture_output=True,
    )
    pictures = np.load(views)
    looks = [
        ((1, 0, 0), (0, 0, 1)),
        ((-1, 0, 0), (0, 0, 1)),
        ((0, 1, 0), (0, 0, 1)),
        ((0, -1, 0), (0, 0, 1)),
        ((0, 0, 1), (0, 1, 0)),
        ((0, 0, -1), (0, 1, 0)),
    ]
    for picture, (towards, up) in zip(pictures, looks, strict=True):
        d = directions(towards, up, picture.shape[0])
        ours = np.stack([d[..., 0], d[..., 2], -d[..., 1]], axis=-1)
        np.testing.assert_allclose(picture, colours(ours), atol=0.06)


# What each program's own source says of the place u, v of a direction in its world, and how a
# glTF model's directions come into that world. docs/layouts.md names the sources.
ON_PAPER = {
    "blender": (
        lambda d: np.stack([d[..., 0], -d[..., 2], d[..., 1]], -1),
        lambda d: (
            -np.arctan2(d[..., 1], d[..., 0]) / (2 * np.pi) + 0.5,
            0.5 - np.arctan2(d[..., 2], np.hypot(d[..., 0], d[..., 1])) / np.pi,
        ),
    ),
    "mitsuba": (
        lambda d: d,
        lambda d: (np.arctan2(d[..., 0], -d[..., 2]) / (2 * np.pi), np.arccos(d[..., 1]) / np.pi),
    ),
    "threejs": (
        lambda d: d,
        lambda d: (
            np.arctan2(d[..., 2], d[..., 0]) / (2 * np.pi) + 0.5,
            0.5 - np.arcsin(d[..., 1]) / np.pi,  # its v goes up
        ),
    ),
    "unreal": (  # the importer swaps Y and Z, and the texture's code swaps them back
        lambda d: np.stack([d[..., 0], d[..., 2], d[..., 1]], -1),
        lambda d: (
            (1 + np.arctan2(d[..., 0], -d[..., 1]) / np.pi) / 2,
            np.arccos(d[..., 2]) / np.pi,
        ),
    ),
    "unity": (
        lambda d: np.stack([-d[..., 0], d[..., 1], d[..., 2]], -1),
        lambda d: (
            -0.25 - np.arctan2(d[..., 2], d[..., 0]) / (2 * np.pi),
            np.arccos(d[..., 1]) / np.pi,
        ),
    ),
    "filament": (  # cmgen mirrors x
        lambda d: np.stack([-d[..., 0], d[..., 1], d[..., 2]], -1),
        lambda d: (
            (np.arctan2(d[..., 0], d[..., 2]) / np.pi + 1) / 2,
            (1 - np.arcsin(d[..., 1]) * 2 / np.pi) / 2,
        ),
    ),
}


@pytest.mark.parametrize("preset", PRESETS)
def test_a_lit_direction_lands_where_the_engines_source_looks_for_it(
    sixlight, tmp_path, rgb, preset
):
    into_world, place = ON_PAPER[preset]
    out = tmp_path / "out.hdr"
    assert sixlight("convert", rgb, out, "--preset", preset, "--size", 64).status == 0
    pixels = io.read_exr(out)[0]
    assert pixels.shape == (64, 128, 3)
    d = np.random.default_rng(6).normal(size=(200, 3))
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    u, v = place(into_world(d))
    looked_up = pixels[
        np.clip((v * 64).astype(int), 0, 63), np.floor((u % 1) * 128).astype(int) % 128
    ]
    # the nearest pixel: half of 1/20 rad in a world of slope 1.5, and RGBE's steps
    np.testing.assert_allclose(looked_up, colours(d), atol=0.09)


# ------------------------------------------------------------------------ photographs of a ball


@pytest.fixture
def ball(tmp_path):
    """A chromium ball photographed from 12 radii, traced ray by ray; and its world."""
    camera = Camera.seeing(150, 118, 80, 240, 300, distance=600.0, radius=50.0)
    world = smooth_world(1, channels=3)
    values = photograph(camera, world, chromium, samples=1, rim_samples=4)
    values *= 1 + 0.003 * np.random.default_rng(5).normal(size=values.shape)
    io.write_exr(tmp_path / "ball.exr", values, "RGB", {})
    io.write_rgb(tmp_path / "ball.hdr", values, "")
    return tmp_path, world


@pytest.mark.parametrize(("how", "suffix"), [("found", "exr"), ("told", "hdr")])
def test_a_photographed_ball_becomes_a_cube(sixlight, tmp_path, ball, how, suffix):
    folder, world = ball
    path = folder / f"ball.{suffix}"
    out = tmp_path / "cube.exr"
    given = ["--outline", "150,118,80"] if how == "told" else []
    made = sixlight(
        "convert", path, out, "--from", "mirrorball", "--layout", "cube", "--size", 32,
        "--distance", 12, "--json", *given,
    )  # fmt: skip
    assert made.status == 0, made.err
    x, y, radius = json.loads(made.out)["ball_px"]
    assert abs(x - 150) < 0.5
    assert abs(y - 118) < 0.5
    assert abs(radius - 80) < 0.5
    pixels, names, _ = read(out)
    assert "valid" in names
    values = pixels[..., [names.index(c) for c in "RGB"]].reshape(6, 32, 32, 3)
    d = cube.directions(32)
    front = d[..., 2] > -0.5
    reflected = 0.66 * world(d.reshape(-1, 3)).reshape(values.shape)  # its reflectance stays in
    error = np.abs(values / reflected - 1)[front]
    assert np.median(error) < 0.02
    behind = d[..., 2] < -0.998  # asin(1 / 12) of blind cone
    assert np.isnan(values[behind]).all()


def test_without_a_ball_it_says_so_in_one_line(sixlight, tmp_path):
    path = tmp_path / "noise.exr"
    io.write_exr(path, np.random.default_rng(0).random((90, 120, 3)), "RGB", {})
    said = sixlight("convert", path, tmp_path / "o.exr", "--from", "mirrorball", "--layout", "cube")
    assert said.status == 2
    assert "--outline" in said.err
    assert len(said.err.splitlines()) == 1


# --------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("{rgb}", "o.exr"), "no --layout"),
        (("{rgb}", "o.exr", "--layout", "cubist"), "'cubist'"),
        (("{rgb}", "o.exr", "--layout", "latlong", "--from", "cubist"), "'cubist'"),
        (("{rgb}", "o.exr", "--layout", "cube", "--from", "latlong"), "16 x 96 px"),
        (("{rgb}", "o.exr", "--layout", "cube", "--from", "hcross"), "4 by 3 square faces"),
        (("{rgb}", "o.exr", "--layout", "faces"), "{face}"),
        (("{rgb}", "o.exr", "--layout", "cube", "--channels", "R,P9"), "R,P9"),
        (("{rgb}", "o.exr", "--layout", "cube", "--turn", "left"), "'left'"),
        (("{rgb}", "o.exr", "--layout", "cube", "--turn", "1,0,0,0,1,0,0,0,2"), "no rotation"),
        (("{rgb}", "o.exr", "--layout", "cube", "--turn", "-1,0,0,0,1,0,0,0,1"), "no rotation"),
        (("{rgb}", "o.exr", "--layout", "cube", "--size", "0"), "--size 0"),
        (("{rgb}", "o.exr", "--layout", "cube", "--outline", "1,2,3"), "--outline"),
        (("{rgb}", "o.jpg", "--layout", "cube"), ".jpg"),
        (("{rgb}", "o.exr", "--preset", "unreal"), ".hdr"),
        (("{rgb}", "o.hdr", "--preset", "unrealistic"), "'unrealistic'"),
        (("{rgb}", "o.hdr", "--preset", "unity", "--layout", "cube"), "latlong"),
        (("{rgb}", "o.ktx2", "--layout", "latlong"), "cube"),
        (("{rgb}", "o.ktx2", "--size", "12"), "power of two"),
        (("{six}", "o.hdr", "--preset", "unity"), "--channels P1,P2,P3"),
        (("nowhere.exr", "o.exr", "--layout", "cube"), "no such file"),
        (("{square}", "o.exr", "--layout", "cube"), "--from"),
        (("{nan}", "o.exr", "--layout", "latlong"), "not one pixel"),
        (("{rgb}", "{rgb}", "--layout", "cube"), "--force"),
        (("{rgb}", "o.exr", "--layout", "cube", "--from", "faces"), "NAME_{face}.exr"),
        (("{text}", "o.exr", "--layout", "cube"), "not a readable image"),
    ],
)
def test_bad_input_ends_in_one_line_and_writes_nothing(
    sixlight, tmp_path, rgb, six, arguments, says
):
    square, nan, text = tmp_path / "square.exr", tmp_path / "nan.exr", tmp_path / "text.exr"
    io.write_exr(square, np.ones((8, 8, 3)), "RGB", {})
    io.write_exr(nan, np.full((12, 2, 3), np.nan), "RGB", {})
    text.write_text("no image")
    names = {"rgb": rgb, "six": six, "square": square, "nan": nan, "text": text}
    given = [str(names.get(a.strip("{}"), a)) if a.startswith("{") else a for a in arguments]
    given[1] = str(tmp_path / given[1])
    before = sorted(tmp_path.iterdir())
    outcome = sixlight("convert", *given)
    assert outcome.status == 2, outcome.out
    assert says in outcome.err
    assert len(outcome.err.strip().splitlines()) == 1
    assert "Traceback" not in outcome.err
    assert sorted(tmp_path.iterdir()) == before


def test_integers_are_decoded_and_it_says_so(sixlight, tmp_path):
    import OpenImageIO as oiio

    path, out = tmp_path / "grey.png", tmp_path / "out.exr"
    spec = oiio.ImageSpec(8, 4, 3, "uint8")
    io.write_image(path, spec, np.full((4, 8, 3), 188, np.uint8))
    made = sixlight("convert", path, out, "--layout", "cube", "--size", 4)
    assert "sRGB" in made.err
    # IEC 61966-2-1: ((188 / 255 + .055) / 1.055) ^ 2.4
    np.testing.assert_allclose(read(out)[0], ((188 / 255 + 0.055) / 1.055) ** 2.4, rtol=1e-4)
