"""The simulated captures: what they are made of is checked against paper and other programs."""

from __future__ import annotations

import importlib
import tomllib
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
import rawpy
from scipy import constants

from calibration.errors import InputError
from calibration.spectra import WAVELENGTHS, read_spectra
from pipeline.simulate import Quality, _capture, camera, chart, materials, simulate
from pipeline.simulate.camera import Camera, Shutter
from stages import cube

NEUTRAL = (0.5, 1.0, 0.75)


# --- raw files ----------------------------------------------------------------------------------


@pytest.fixture
def written(tmp_path):
    pytest.importorskip("imagecodecs", reason="raw files are compressed by imagecodecs")
    from pipeline.simulate.dng import Shot, write_dng

    rng = np.random.default_rng(1)
    samples = rng.poisson(3000, (62, 94)).astype(np.uint16)
    samples[:2, :4] = [[600, 15520, 0, 16383], [1, 2, 3, 4]]
    shot = Shot((3, 10), datetime(2026, 3, 14, 16, 20, 5), NEUTRAL)
    path = tmp_path / "shot.dng"
    write_dng(path, samples, Camera(), shot, np.diag([0.7, 1.0, 0.9]))
    return path, samples


def test_libraw_reads_the_very_samples_and_levels_of_a_dng(written):
    path, samples = written
    with rawpy.imread(str(path)) as raw:
        np.testing.assert_array_equal(raw.raw_image_visible, samples)
        assert raw.color_desc == b"RGBG"
        assert raw.raw_pattern.tolist() == [[0, 1], [3, 2]]
        assert raw.black_level_per_channel == [600] * 4
        assert raw.white_level == 15520


def test_libraw_reads_how_a_dng_was_exposed(written):
    with rawpy.imread(str(written[0])) as raw:
        assert raw.other.shutter_speed == pytest.approx(0.3)
        assert raw.other.iso_speed == 100
        assert raw.other.aperture == 16
        assert raw.other.focal_length == 100
        assert raw.other.timestamp == datetime(2026, 3, 14, 16, 20, 5)


def test_a_tiff_reader_finds_the_tags_of_a_dng(written):
    tifffile = pytest.importorskip("tifffile", reason="tifffile reads the tags")
    with tifffile.TiffFile(written[0]) as tiff:
        tags = {tag.code: tag.value for tag in tiff.pages[0].tags}
        np.testing.assert_array_equal(tiff.pages[0].asarray(), written[1])
    assert tags[50706] == bytes([1, 4, 0, 0])
    assert tags[34665]["ExposureTime"] == (3, 10)
    assert tags[34665]["FocalPlaneXResolution"] == (1250, 1)  # 8 um: 1250 pixels a centimetre
    assert tags[34665]["FocalPlaneResolutionUnit"] == 3
    assert tags[50721][0:2] == (7, 10)
    assert tags[50728] == (1, 2, 1, 1, 3, 4)


# --- sensor -------------------------------------------------------------------------------------


def test_mean_and_variance_of_raw_samples_are_as_on_paper():
    plain = Camera(prnu=0.0)
    step = plain.electrons_per_step
    for electrons in (0.0, 50.0, 20000.0):
        raw = camera.expose(
            np.full((400, 400), electrons), 1.0, plain, np.random.default_rng(3)
        ).astype(float)
        variance = (electrons + plain.read_noise**2) / step**2 + 1 / 12  # and quantisation
        raw = raw[np.abs(raw - np.median(raw)) < 7 * variance**0.5]  # the few hot pixels aside
        # 160 000 samples: standard errors of .25 % of a standard deviation and .35 % of a variance
        assert raw.mean() == pytest.approx(600 + electrons / step, abs=4 * 0.0025 * variance**0.5)
        assert raw.var() == pytest.approx(variance, rel=4 * 0.0036)


def test_a_pixel_collects_what_the_camera_equation_says():
    # E = pi L / (4 N^2); the green channel is 1 at 530 nm, where half the photons count
    photons_per_joule = 530e-9 / (constants.h * constants.c)
    area, irradiance = (8e-6) ** 2, np.pi / (4 * 16.0**2)
    expected = 5.0 * irradiance * area * 0.5 * photons_per_joule  # a band 5 nm wide
    band = int(np.argmin(np.abs(materials.FINE - 530)))
    got = camera.responses(Camera(), "cyan")[band, 1] / camera.transmittance("cyan")[band]
    assert got == pytest.approx(expected, rel=1e-6)


def test_samples_end_at_the_saturation_level_and_hot_pixels_stay_where_they_are():
    rng = np.random.default_rng(5)
    full = camera.expose(np.full((64, 64), 1e6), 1.0, Camera(), rng)
    assert full.min() == full.max() == 15520
    dark = [camera.expose(np.zeros((500, 500)), 10.0, Camera(), rng) > 650 for _ in range(2)]
    np.testing.assert_array_equal(dark[0], dark[1])
    assert dark[0].sum() > 0


def test_tags_are_the_round_numbers_cameras_write():
    assert Shutter(-15).tag == (1, 30)
    assert Shutter(-15).time_s == pytest.approx(1 / 32)
    for thirds in range(-36, 16):
        numerator, denominator = Shutter(thirds).tag
        assert numerator / denominator == pytest.approx(Shutter(thirds).time_s, rel=0.08)
    assert len(camera.BRACKET) >= 7


@pytest.mark.parametrize("shift", [0.0, 0.75, -0.4])
def test_lens_and_shift_move_and_blur_a_point_as_on_paper(shift):
    subpixels, margin, blur = 4, 6, 0.5
    weights = camera.pixel_weights(20, subpixels, margin, shift, blur).toarray()
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-6)
    at = (np.arange(weights.shape[1]) + 0.5) / subpixels - margin
    centre = weights @ at
    np.testing.assert_allclose(centre, np.arange(20) + 0.5 - shift, atol=1e-4)
    spread = weights @ at**2 - centre**2
    # the pixel's box, the Gaussian, and the subpixel's own width seen at its centre
    np.testing.assert_allclose(spread, 1 / 12 + blur**2 + 1 / (12 * 16), atol=1e-3)


# --- chart --------------------------------------------------------------------------------------


def test_a_chart_session_agrees_with_its_own_spectroradiometer(tmp_path, monkeypatch):
    monkeypatch.setattr(chart, "LIGHTS", {"F2": chart.LIGHTS["F2"]})
    shots = {}

    def keep(path, raw, taken_by, shutter, number):
        shots[path.parent.name] = (raw, shutter.time_s, taken_by)

    chart.photograph_chart(tmp_path / "calibration", Camera(), keep, seed=2)
    measured = read_spectra(tmp_path / "calibration/F2/radiance.csv")
    assert measured.names == tuple(str(i) for i in range(1, 25))
    boxes = np.loadtxt(
        tmp_path / "calibration/patch_boxes.csv", delimiter=",", skiprows=1, dtype=int
    )
    for name in camera.FILTERS:
        raw, time_s, by = shots[name]
        assert 0.5 < (raw.max() - 600) / (by.saturation_level - 600) < 1.0
        expected = measured.values.T @ camera.responses(by, name) * time_s
        for patch, x0, y0, x1, y1 in boxes:
            signal = raw[y0 + y0 % 2 : y1, x0 + x0 % 2 : x1].astype(float) - 600
            red, blue = np.median(signal[::2, ::2]), np.median(signal[1::2, 1::2])
            got = np.array([red, np.median(signal[::2, 1::2]), blue]) * by.electrons_per_step
            # the radiometer's half percent (averaged over bands), shading within the box, and one
            # raw step
            np.testing.assert_allclose(got, expected[patch - 1], rtol=0.01, atol=4.0)


# --- spectra ------------------------------------------------------------------------------------


def test_lamps_are_scaled_to_one_candela_a_square_metre():
    # a 2856 K blackbody of 1 cd/m2: 683 lm/W * integral of V(lambda) L = 1, V of 555 nm being 1
    for spectrum in (materials.blackbody(2856.0), materials.daylight(6504.0)):
        assert materials.xyz(spectrum)[1] == pytest.approx(1.0)
    x, y, z = materials.xyz(materials.blackbody(2856.0))
    assert (x / (x + y + z), y / (x + y + z)) == pytest.approx((0.4476, 0.4074), abs=5e-4)  # A


def test_paints_are_the_measured_colours_nearest_to_what_is_asked():
    red, blue = materials.paint("#c8322e"), materials.paint("#2d4f7c")
    assert red[WAVELENGTHS == 650] > 3 * red[WAVELENGTHS == 500]
    assert blue[WAVELENGTHS == 460] > 2 * blue[WAVELENGTHS == 620]
    for reflectance in (red, blue, materials.paint("#f2f0ec")):
        assert reflectance.min() > 0
        assert reflectance.max() <= 0.95


# --- rendering ----------------------------------------------------------------------------------


@pytest.fixture
def render(monkeypatch):
    from pipeline.simulate import render

    try:
        render.mitsuba()
    except InputError as error:
        pytest.skip(str(error))
    monkeypatch.setattr(render, "PASSES", (0,))  # three wavelengths will do
    return render


def band(*values):
    """A spectrum with these values at the first wavelengths."""
    spectrum = np.zeros(len(WAVELENGTHS))
    spectrum[: len(values)] = values
    return spectrum


def quiet(line):
    pass


def test_the_sphere_is_seen_where_geometry_says(render):
    from pipeline.simulate import room

    view = room.view(Camera())
    x, y, radius = view.rim()
    assert view.distance == pytest.approx(1.5)
    assert radius == pytest.approx(12500 * np.tan(np.arcsin(0.05 / 1.5)), rel=1e-4)
    assert 20 < abs(x - view.width / 2) < 60
    assert 20 < abs(y - view.height / 2) < 60
    np.testing.assert_allclose(view.world_axes @ view.world_axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(view.world_axes) == pytest.approx(1)
    # +X is to the right in the photograph, +Y up
    right = view.project(np.add(view.sphere, 0.01 * view.world_axes[0]))
    up = view.project(np.add(view.sphere, 0.01 * view.world_axes[1]))
    at = view.project(view.sphere)
    assert right[0] > at[0] + 50
    assert up[1] < at[1] - 50


def test_a_truth_shows_coloured_lights_in_the_directions_they_are_in(render):
    """The cube's convention, held against Mitsuba's: one light a colour, all directions unlike."""
    from pipeline.simulate.render import look

    where = np.array([[0.5, 0.3, 0.9], [-0.4, 0.9, 0.2], [0.9, -0.35, -0.3]])
    where /= np.linalg.norm(where, axis=1, keepdims=True)
    axes = np.array([[0.8, 0.0, -0.6], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8]])
    grey = {"type": "diffuse", "reflectance": band(0.5, 0.5, 0.5)}
    scene = {"type": "scene", "integrator": look()}
    for i, direction in enumerate(where):
        scene[f"light_{i}"] = {
            "type": "sphere",
            "center": list(1.0 + 5 * direction @ axes),
            "radius": 0.5,
            "bsdf": grey,
            "emitter": {"type": "area", "radiance": np.roll(band(1.0), i)},
        }
    seen = render.cubemap(
        scene, np.ones(3), axes, face_size=32, samples=128, seed=1, progress=quiet
    )
    assert seen.max() == pytest.approx(1.0)  # a lamp's reflectance adds nothing to its light
    weight = seen[..., :3] * cube.solid_angles(32)[..., None]
    found = np.einsum("fijk,fijc->kc", weight, cube.directions(32))
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    # a ball of 11 degrees, averaged over texels of 3
    assert np.degrees(np.arccos(np.clip((found * where).sum(1), -1, 1))).max() < 0.25
    assert weight.sum(axis=(0, 1, 2)) == pytest.approx(2 * np.pi * (1 - np.sqrt(0.99)), rel=0.05)


def test_a_steel_sphere_in_a_white_world_shows_its_reflectance_and_its_size(render):
    from pipeline.simulate.render import look

    index = materials.stainless_steel()
    view = render.View((0, 0, 0), 0.05, (0, 0, 1.5), (0, 0, 0), 600.0, 64, 64)
    scene = {
        "type": "scene",
        "integrator": look(),
        "sky": {"type": "constant", "radiance": band(1, 1, 1)},
        "sphere": {
            "type": "sphere",
            "center": [0, 0, 0],
            "radius": 0.05,
            "bsdf": {"type": "conductor", "eta": index.real, "k": index.imag},
        },
    }
    ((_, image),) = render.photograph(
        scene, view, subpixels=2, margin=2, samples=4, seed=1, progress=quiet
    )
    assert image.shape == (136, 136, 3)
    normal = np.abs((index - 1) / (index + 1)) ** 2  # Fresnel, head on
    np.testing.assert_allclose(image[67:69, 67:69].mean(axis=(0, 1)), normal[:3], rtol=1e-3)
    assert image[0, 0] == pytest.approx(1.0)  # past it, the world
    # A world of one brightness: the sphere's edge is where the picture is darker than the world.
    radius = 2 * 600 * np.tan(np.arcsin(0.05 / 1.5))
    assert (image[68, :, 0] < 0.999).sum() == pytest.approx(2 * radius, abs=1.5)


def test_light_on_surfaces_is_what_mitsubas_path_tracer_finds(render):
    """A box with a lamp in its ceiling and a block on its floor, seen both ways."""
    from pipeline.simulate.light import bake

    grey, red = band(0.5, 0.5, 0.5), band(0.2, 0.4, 0.7)

    def wall(corner, u, v, paint):
        corner, u, v = (np.array(a, float) for a in (corner, u, v))
        points = np.array([[corner, corner + u], [corner + v, corner + u + v]])
        return render.Surface(points, paint)

    walls = [
        wall((0, 0, 0), (0, 0, 1), (1, 0, 0), grey),
        wall((0, 1, 0), (1, 0, 0), (0, 0, 1), grey),
        wall((0, 0, 0), (1, 0, 0), (0, 1, 0), grey),
        wall((1, 0, 1), (-1, 0, 0), (0, 1, 0), grey),
        wall((0, 0, 1), (0, 0, -1), (0, 1, 0), red),
        wall((1, 0, 0), (0, 0, 1), (0, 1, 0), red),
        wall((0.3, 0.4, 0.3), (0, 0, 0.4), (0.4, 0, 0), grey),
    ]
    matrix = np.array([[0.2, 0, 0, 0.5], [0, 0, -1, 0.999], [0, 0.2, 0, 0.5], [0, 0, 0, 1.0]])
    light = {
        "type": "rectangle",
        "to_world": matrix,
        "bsdf": {"type": "diffuse", "reflectance": band()},
        "emitter": {"type": "area", "radiance": band(1, 2, 3)},
    }
    scene = {"type": "scene", "surfaces": walls, "light": light}
    path = scene | {"integrator": {"type": "path", "max_depth": 14, "rr_depth": 100}}

    def seen(a_scene, samples):
        centre, axes = np.array([0.6, 0.6, 0.75]), np.eye(3)
        return render.cubemap(
            a_scene, centre, axes, face_size=8, samples=samples, seed=1, progress=quiet
        )[..., :3]

    found = seen(bake(scene, spacing=0.04, samples=128, seed=1, progress=quiet), 64)
    traced = seen(path, 256)
    # Shadows are spread by the points' spacing; both have a percent of noise.
    assert np.median(np.abs(found / traced - 1)) < 0.03
    assert found.mean(axis=(0, 1, 2)) == pytest.approx(traced.mean(axis=(0, 1, 2)), rel=0.02)


def test_the_room_is_made_of_sound_surfaces_and_three_lights(render):
    from pipeline.simulate import room

    scene = room.sphere_on_stand()
    surfaces = scene["surfaces"]
    assert len(surfaces) > 1000
    for surface in surfaces:
        assert np.isfinite(surface.points).all()
        assert surface.reflectance.min() >= 0
        assert surface.reflectance.max() <= 0.96
    assert sum(name.startswith("light_") for name in scene) == 3
    assert len(room.without_sphere(scene)["surfaces"]) == len(room.room()["surfaces"])


def test_the_sphere_shows_all_but_what_is_behind_it_and_its_stand(render):
    from pipeline.simulate import room

    shown = room.visible(room.view(Camera()), 32)
    assert shown[4].all()  # the camera's side
    hidden = cube.directions(32)[~shown]
    assert 0 < len(hidden) < 0.03 * shown.size
    # the rod hangs down; behind is a cone of 1.9 degrees, less than a texel
    assert (hidden[:, 1] < 0).all()


# --- the whole ----------------------------------------------------------------------------------


def test_wrong_wishes_are_refused_in_one_line(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="no scene is called cave"):
        simulate("cave", tmp_path / "out")
    with pytest.raises(InputError, match="no quality is called best"):
        simulate("room", tmp_path / "out", quality="best")
    (tmp_path / "there").mkdir()
    with pytest.raises(InputError, match="there already"):
        simulate("room", tmp_path / "there")

    def missing(name):
        raise ImportError(f"No module named {name!r}")

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(InputError, match=r"pip install 'sixlight\[simulate\]'"):
        simulate("room", tmp_path / "out")
    assert [p.name for p in tmp_path.iterdir()] == ["there"]


@pytest.mark.slow
def test_a_whole_capture_is_written_and_nothing_beside_it(tmp_path, monkeypatch, render):
    from pipeline.simulate import room

    monkeypatch.setattr(camera, "BRACKET", camera.BRACKET[2:5])
    monkeypatch.setattr(chart, "LIGHTS", {"A": chart.LIGHTS["A"]})
    few = room.room()
    few["surfaces"] = few["surfaces"][:60]
    monkeypatch.setattr(render, "PASSES", (15,))  # green
    monkeypatch.setattr(room, "room", lambda: few)
    lines = []
    quality = Quality(spacing=0.5, rays=4, subpixels=1, truth_size=8, truth_samples=2, width=96)
    out = tmp_path / "capture"
    simulate("room", out, quality=quality, seed=4, progress=lines.append)
    assert lines
    assert [p.name for p in tmp_path.iterdir()] == ["capture"]
    for name in camera.FILTERS:
        assert len(list((out / name).glob("*.dng"))) == 3
    for name in ("spectral.exr", "cubemap.exr", "geometry.toml"):
        assert (out / "truth" / name).is_file()
    with rawpy.imread(str(out / "yellow/yellow_03.dng")) as raw:
        assert raw.raw_image_visible.shape == (86, 96)
        assert raw.raw_image_visible.max() > 700  # there is light
    # What the capture says of the lens is what the photographs were made with.
    told = tomllib.loads((out / "capture.toml").read_text())["camera"]
    truth = tomllib.loads((out / "truth" / "geometry.toml").read_text())
    focal_px = 1000.0 * told["focal_length_mm"] / told["pixel_pitch_um"]
    assert focal_px == pytest.approx(truth["focal_px"], rel=1e-4)


def test_a_simulated_capture_reads_as_the_sample_that_is_bundled():
    tables = [f'[[filter]]\nname = "{name}"\nfiles = "{name}/*"\n' for name in camera.FILTERS]
    sample = Path(__file__).parents[1] / "sample_captures" / "room" / "capture.toml"
    assert _capture(Camera(), tables, 'transform = "M_S.toml"') == sample.read_text()
