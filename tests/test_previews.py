"""Pictures in worlds known on paper, and what `sixlight preview` writes and refuses."""

import json
from pathlib import Path

import numpy as np
import pytest

from calibration import primaries, sets
from calibration.adaptation import D65, cat02
from calibration.difference import delta_e_2000, lab
from calibration.errors import InputError
from calibration.look import Look
from pipeline import io, previews
from pipeline.compositions import NAMES, compose
from pipeline.files import header as headers
from pipeline.previews import Rendering, draw
from stages import cube
from stages.fill import fill
from stages.prefilter import irradiance
from stages.types import Measured

SET = primaries.load("darling2011")
QUICK = ("--width", "96", "--samples", "4", "--quiet")


def lamp(name):
    return sets.lights("darling2011")[name]


def uniform(spectrum, size=8):
    return np.broadcast_to(SET.project(spectrum), (6, size, size, 6)).astype(np.float32)


def two_lights(size=16):
    """Tungsten over the half of the world about +X, daylight three times as bright about -X."""
    side = cube.directions(size)[..., :1]
    tungsten, sky = (SET.project(lamp(name)) for name in ("A", "D65"))
    return np.where(side > 0, tungsten, 3.0 * sky).astype(np.float32)


def save(path, values, **changed):
    valid = np.isfinite(values).all(axis=-1).astype(np.float32)
    about = headers.of_primaries(SET, unit="relative", quantity="light") | changed
    io.write_measured(path, Measured(values, np.zeros_like(values), valid), SET.channels, about)
    return path


def test_a_grey_ball_in_a_uniform_world_is_grey():
    composition = compose("probe", uniform(lamp("D65")), SET)
    xyz = draw(uniform(lamp("D65")), SET, composition, Rendering(width=120, samples=8)).xyz
    white = SET.xyz_from_primaries @ SET.project(lamp("D65"))
    height, width = xyz.shape[:2]
    middle = xyz[height // 2, width // 2]  # of the ball in the middle
    np.testing.assert_allclose(middle, 0.18 * white, rtol=2e-3)
    np.testing.assert_allclose(xyz[1, 1], white, rtol=1e-3)  # the world itself


def test_the_first_of_24_spheres_is_dark_skin():
    composition = compose("colorchecker", uniform(lamp("D65")), SET)
    assert len(composition.scene.things) == 24
    mesh, material = composition.scene.things[0]
    np.testing.assert_allclose(material.diffuse, SET.project(sets.surfaces("colorchecker24")["1"]))
    assert (mesh.positions[:, 0] < 0).all()  # upper left, seen from +Z
    assert (mesh.positions[:, 1] > 0).all()


def test_facing_and_turn_are_two_words_for_one_thing():
    world = two_lights()
    composition = compose("probe", world, SET)
    small = {"width": 96, "samples": 4, "channels": "six"}
    faced = draw(world, SET, composition, Rendering(facing_deg=90.0, **small)).xyz
    turned = draw(world, SET, composition, Rendering(turn_deg=-90.0, **small)).xyz
    np.testing.assert_array_equal(faced, turned)
    # the viewer stands at +X, where the lamp is: the white ball is lit by it
    height, width = faced.shape[:2]
    white = faced[height // 2, round(width * 0.8)]
    assert white[0] / white[2] > 2.0  # tungsten has X : Z of 3
    opposite = draw(world, SET, composition, Rendering(facing_deg=-90.0, **small)).xyz
    white = opposite[height // 2, round(width * 0.8)]
    assert white[0] / white[2] < 1.1


def test_three_channels_agree_with_six_where_all_is_daylight():
    world = uniform(lamp("D65"))
    composition = compose("colorchecker", world, SET)
    xyz = [
        draw(world, SET, composition, Rendering(width=96, samples=4, channels=way)).xyz
        for way in ("six", "sharp", "xyz")
    ]
    np.testing.assert_allclose(xyz[1], xyz[0], rtol=0.02, atol=2e-3)
    np.testing.assert_allclose(xyz[2], xyz[0], rtol=0.02, atol=2e-3)


# ---------------------------------------------------------------------------------- metamers


@pytest.fixture(scope="module")
def metamers():
    return compose("metamers", two_lights(), SET)


def full_spectra_apart(world, azimuth_deg, paints):
    """CIEDE2000 of two matt paints that face a viewer at that azimuth, a little up."""
    a, tilt = np.radians(azimuth_deg), np.radians(20.0)
    d = np.array([np.cos(tilt) * np.sin(a), np.sin(tilt), np.cos(tilt) * np.cos(a)])
    falling = cube.sample(irradiance(world), d)
    white = sets.xyz(falling)
    to_d65 = cat02(white, D65) / white[1]
    return float(delta_e_2000(*(lab(to_d65 @ sets.xyz(falling * paint)) for paint in paints)))


def test_metamers_match_in_six_channels_where_they_should(metamers):
    apart = metamers.figures["delta_e"]
    assert apart["six"]["match"] <= 1.2
    assert apart["six"]["part"] >= 10.0
    assert apart["sharp"]["match"] >= 5.0
    # the viewer of the first picture stands where the lamp is, at +X; of the second at -X
    assert 45 <= metamers.facing[0] <= 135
    assert 225 <= metamers.facing[1] <= 315


def test_full_spectra_agree_about_metamers(metamers):
    """The same world in 36 wavelengths, integrated anew, not estimated from six channels."""
    side = cube.directions(16)[..., :1]
    world = np.where(side > 0, lamp("A"), 3.0 * lamp("D65"))
    paints = metamers.spectra["paints"].values.T
    found = [full_spectra_apart(world, azimuth, paints) for azimuth in metamers.facing]
    assert found[0] <= 1.2
    assert found[1] >= 10.0


@pytest.mark.slow
def test_the_true_light_of_the_bundled_room_agrees_about_metamers():
    """Paints made for six channels of the room, judged by its 36 wavelengths."""
    room = Path(__file__).parent.parent / "sample_captures" / "room" / "truth"
    light = fill(io.read_measured(room / "cubemap.exr", cube=True)[0])
    made = compose("metamers", light, SET)
    pixels, channels, _ = io.read_exr(room / "spectral.exr")
    order = np.argsort([float(name.removesuffix("nm")) for name in channels])
    world = pixels[..., order].reshape(6, pixels.shape[1], pixels.shape[1], -1)
    found = [
        full_spectra_apart(world, azimuth, made.spectra["paints"].values.T)
        for azimuth in made.facing
    ]
    assert found[0] <= 1.2
    assert found[1] >= 10.0
    apart = made.figures["delta_e"]
    assert apart["six"]["match"] <= 1.2
    assert apart["six"]["part"] >= 10.0
    assert apart["sharp"]["match"] >= 5.0


def test_one_light_everywhere_has_no_two_sides():
    with pytest.raises(InputError, match="two lights on two sides"):
        compose("metamers", uniform(lamp("A")), SET)


# ------------------------------------------------------------------------------ command line


def test_every_named_scene_is_written(sixlight, tmp_path):
    file = save(tmp_path / "cubemap.exr", two_lights())
    for scene in ("probe", "metamers"):
        options = ("--scene", scene, "--channels", "six", "-o", tmp_path / "out", *QUICK)
        done = sixlight("preview", file, *options)
        assert done.status == 0, done.err
        assert (tmp_path / "out" / f"preview_{scene}.png").is_file()
    assert (tmp_path / "out" / "preview_metamers_paints.csv").is_file()
    assert set(NAMES) == {"teapot", "colorchecker", "roughness", "metamers", "probe"}


def test_json_says_what_was_rendered(sixlight, tmp_path):
    file = save(tmp_path / "cubemap.exr", two_lights())
    options = ("--scene", "probe", "--channels", "xyz", "--exposure", "1.5", "--json")
    done = sixlight("preview", file, "-o", tmp_path / "out", *options, *QUICK)
    told = json.loads(done.out)
    assert told["channels"] == ["xyz"]
    assert told["exposure_ev"] == [1.5]
    assert told["files"] == [str(tmp_path / "out" / f"preview_probe.{s}") for s in ("png", "exr")]


def test_a_mesh_is_shown_in_the_teapots_place(sixlight, tmp_path):
    file = save(tmp_path / "cubemap.exr", two_lights())
    (tmp_path / "wall.obj").write_text("v 0 0 0\nv 90 0 0\nv 90 90 0\nv 0 90 0\nf 1 2 3 4\n")
    done = sixlight("preview", file, "--scene", tmp_path / "wall.obj", "--channels", "six",
                    "-o", tmp_path / "out", "--width", "96", "--samples", "4")  # fmt: skip
    assert done.status == 0, done.err
    assert "times its size" in done.err
    assert "no normals" in done.err
    assert (tmp_path / "out" / "preview_wall.exr").is_file()


@pytest.mark.slow
def test_a_turntable_comes_as_frames_or_as_video(sixlight, tmp_path):
    file = save(tmp_path / "cubemap.exr", two_lights())
    scene = tmp_path / "ball.toml"
    scene.write_text('[[thing]]\nmesh = "sphere"\nmaterial = { diffuse = 0.5 }\n')
    options = ("--scene", scene, "--turntable", "3", "--channels", "six", *QUICK)
    done = sixlight("preview", file, *options, "-o", tmp_path / "frames")
    assert done.status == 0, done.err
    names = sorted(path.name for path in (tmp_path / "frames").iterdir())
    assert names == ["frame_000.png", "frame_001.png", "frame_002.png"]
    video = tmp_path / "turn.mp4"
    assert sixlight("preview", file, *options, "-o", video).status == 0

    import cv2

    read = cv2.VideoCapture(str(video))
    count = 0
    while read.read()[0]:
        count += 1
    assert count == 3


def test_holes_in_the_map_are_filled_and_told(sixlight, tmp_path):
    values = two_lights()
    values[0, 4:8, 4:8] = np.nan
    file = save(tmp_path / "cubemap.exr", values)
    done = sixlight("preview", file, "--scene", "probe", "-o", tmp_path / "out",
                    "--width", "96", "--samples", "4")  # fmt: skip
    assert done.status == 0
    assert "not known in the map" in done.err
    assert np.isfinite(io.read_exr(tmp_path / "out" / "preview_probe.exr")[0]).all()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--scene", "cow"), "no scene is called 'cow'"),
        (("--scene", "cow.obj"), "no such file"),
        (("--quality", "superb"), "draft, good, best"),
        (("--channels", "four"), "compare, six, sharp, xyz"),
        (("--brdf", "phong"), "ward, ward1992, ggx"),
        (("--display", "crt"), "no display is called"),
        (("--scene", "metamers", "--lights", "A"), "name two"),
        (("--scene", "metamers", "--lights", "A,A"), "name two"),
        (("--scene", "metamers", "--turntable", "4"), "seen from one side"),
    ],
)
def test_wrong_options_say_so_in_a_line(sixlight, tmp_path, options, says):
    file = save(tmp_path / "cubemap.exr", two_lights())
    done = sixlight("preview", file, *options, "-o", tmp_path / "out", *QUICK)
    assert done.status == 2
    assert says in done.err
    assert done.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda p: io.write_exr(p, np.ones((48, 8, 3)), "RGB", {}), "P1..P6"),
        (lambda p: save(p, np.ones((6, 6, 6, 6), np.float32)), "a power of two"),
        (lambda p: save(p, np.full((6, 4, 4, 6), np.nan, np.float32)), "nothing in it is known"),
        (lambda p: save(p, np.zeros((6, 4, 4, 6), np.float32)), "no light in it"),
        (lambda p: save(p, np.ones((6, 4, 4, 6), np.float32), quantity="reflectance"), "of light"),
        (lambda p: save(p, np.ones((6, 4, 4, 6), np.float32), primaries="mine"), "'mine'"),
        (lambda p: p.write_text("no image"), "not a readable image"),
    ],
)
def test_a_map_that_is_none_says_so_in_a_line(sixlight, tmp_path, spoil, says):
    file = tmp_path / "cubemap.exr"
    spoil(file)
    done = sixlight("preview", file, "-o", tmp_path / "out", *QUICK)
    assert done.status == 2
    assert says in done.err
    assert done.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_the_look_is_obeyed():
    world = uniform(lamp("A"))
    composition = compose("probe", world, SET)
    plain = Rendering(width=96, samples=4, channels="six", look=Look(adaptation=None))
    adapted = Rendering(width=96, samples=4, channels="six")
    corner = [draw(world, SET, composition, r).signal[1, 1] for r in (plain, adapted)]
    assert corner[0][0] > corner[0][2] + 0.2  # tungsten stays yellow
    assert np.ptp(corner[1]) < 0.02  # or is white


def test_a_stopped_run_leaves_nothing(tmp_path, monkeypatch):
    file = save(tmp_path / "cubemap.exr", uniform(lamp("A")))

    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(previews.io, "write_exr", stop)
    with pytest.raises(KeyboardInterrupt):
        previews.preview(file, "probe", tmp_path / "out", Rendering(width=96, samples=4))
    assert list((tmp_path / "out").iterdir()) == []
