"""Simulated rooms whose light changed, or did not, between two filters' passes."""

from __future__ import annotations

import json
from dataclasses import replace

import furnished_room
import numpy as np
import pytest
import small_capture

from calibration import bands as camera_bands
from calibration import sets, training
from calibration.transform import write_transform
from pipeline import capture as captures
from pipeline import io
from pipeline.capture import Calibration
from pipeline.settings import Settings
from pipeline.steps import STEPS
from stages import cube
from stages.drift import drift, worth_telling
from stages.merge import InMemory, merge
from stages.shutter import true_shutter
from stages.types import Frame, Measured

NAMES = ("cyan", "yellow")
BLIND = furnished_room.DIRECTIONS[..., 2] < np.cos(np.deg2rad(165))


@pytest.fixture(scope="module")
def sensitivities():
    camera, filters = small_capture.sensitivities(), small_capture.transmittances()
    return camera_bands.sensitivities(camera, filters, NAMES)[1]


@pytest.fixture(scope="module")
def known(sensitivities):
    """Bands of known spectra: of other lights and surfaces than the rooms have."""
    lights, surfaces = training.checked(None, None)
    reflectances = training.with_white(surfaces)[0][::4]
    return training.lit(lights.values.T, reflectances) @ sensitivities


def chart_under(lights, sensitivities):
    """What the bands see of a chart in a calibration session."""
    patches, spectra = sets.surfaces("colorchecker24").values.T, sets.lights("darling2011")
    return np.concatenate([patches * spectra[light] for light in lights]) @ sensitivities


@pytest.fixture(scope="module")
def photographed(sensitivities):
    """photographed(room as it was for cyan, as it was for yellow, seed) -> its noisy bands."""

    def shoot(first, second, seed, noise=0.005):
        bands = np.concatenate(
            [
                first.radiance() @ sensitivities[:, :3],
                second.radiance() @ sensitivities[:, 3:],
            ],
            axis=-1,
        )
        middle = np.median(bands)  # photon noise, and in the dark that of reading
        sigma = noise * np.sqrt(bands * middle + (0.1 * middle) ** 2)
        bands += sigma * np.random.default_rng(seed).normal(size=bands.shape)
        valid = np.where(BLIND, 0, 1)
        bands[BLIND] = sigma[BLIND] = np.nan
        return Measured(*(a.astype(np.float32) for a in (bands, sigma**2, valid)))

    return shoot


def dimmed(room, light, to):
    return room.with_light(light, strength=to * room.lights[light].strength)


def turned(room, light, degrees):
    """The room with a light moved sideways."""
    place = room.lights[light].place
    aside = np.cross(place, (0.0, 1.0, 0.0))
    angle = np.deg2rad(degrees)
    to = np.cos(angle) * place + np.sin(angle) * aside / np.linalg.norm(aside)
    return room.with_light(light, place=to)


@pytest.mark.parametrize("seed", range(6))
def test_a_room_whose_light_stood_still_raises_no_alarm(photographed, known, seed):
    room = furnished_room.furnished(seed)
    bands = photographed(room, room, seed)
    for spectra in (None, known):
        changes = drift(bands, known=spectra)
        assert worth_telling(changes, NAMES) == []
        assert changes[0].share < 1e-3


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("absolute", [False, True])
def test_a_lamp_that_moved_by_a_degree_is_found_where_it_is(photographed, known, seed, absolute):
    room = furnished_room.furnished(seed)
    after = turned(room, 1, 1.5)
    changes = drift(photographed(room, after, seed), known=known if absolute else None)
    (said,) = worth_telling(changes, NAMES)
    assert "of the light changed between the photographs through cyan and yellow" in said
    lamp = room.lights[1]
    off = np.arccos(changes[0].direction @ lamp.place)
    assert off < lamp.radius + np.deg2rad(1.5) + np.pi / 2 / 32


@pytest.mark.parametrize("seed", range(3))
def test_the_light_that_changed_is_told_as_much_as_it_was(photographed, known, seed, sensitivities):
    room = furnished_room.furnished(seed)
    after = turned(room, 1, 5.0)
    light = [(r.radiance() @ sensitivities[:, 3:]).sum(axis=-1) for r in (room, after)]
    omega = np.where(BLIND, 0.0, cube.solid_angles(furnished_room.SIZE))
    share = np.sum(np.abs(light[1] - light[0]) * omega) / np.sum(np.maximum(*light) * omega)
    found = drift(photographed(room, after, seed), known=known)[0].share
    assert found == pytest.approx(share, rel=0.15)


@pytest.mark.parametrize("seed", range(3))
def test_a_cloud_shows_where_the_spectra_are_known(photographed, known, seed):
    room = furnished_room.furnished(seed)
    change = drift(photographed(room, dimmed(room, 0, 0.9), seed), known=known)[0]
    assert worth_telling([change], NAMES)
    at_the_window = (furnished_room.DIRECTIONS @ room.lights[0].place > 0.99) & ~BLIND
    ratio = np.exp(np.nanmedian(change.log_ratio[at_the_window]))
    assert ratio == pytest.approx(0.9, abs=0.03)


@pytest.mark.parametrize("ratio", [0.94, 1.06])
def test_a_change_of_all_light_is_told_where_the_spectra_are_known(photographed, known, ratio):
    room = furnished_room.furnished(1)
    bands = photographed(room, room, 1)
    bands.values[..., 3:] *= ratio
    bands.variance[..., 3:] *= ratio**2
    change = drift(bands, known=known)[0]
    assert change.overall == pytest.approx(ratio, abs=0.015)
    assert any("all light changed" in said for said in worth_telling([change], NAMES))
    # Without them it looks like another filter, and nothing is claimed.
    blind_to_it = drift(bands)[0]
    assert blind_to_it.overall is None
    assert worth_telling([blind_to_it], NAMES) == []


@pytest.mark.parametrize("lights", [("A", "D65", "F11"), ("A", "D50", "D65", "F2", "F11")])
def test_a_chart_under_some_lights_shows_a_change_of_all_light(photographed, sensitivities, lights):
    seen = chart_under(lights, sensitivities)
    for seed in range(3):
        room = furnished_room.furnished(seed)
        bands = photographed(room, room, seed)
        assert worth_telling(drift(bands, known=seen), NAMES) == []
        bands.values[..., 3:] *= 0.9
        bands.variance[..., 3:] *= 0.9**2
        change = drift(bands, known=seen)[0]
        assert change.overall == pytest.approx(0.9, abs=0.015)
        assert any("all light changed" in said for said in worth_telling([change], NAMES))


def test_too_few_known_spectra_are_as_good_as_none(photographed, sensitivities):
    room = furnished_room.furnished(1)
    bands = photographed(room, room, 1)
    few, none = (drift(bands, known=k)[0] for k in (chart_under(["D65"], sensitivities), None))
    assert few.overall is None
    np.testing.assert_array_equal(few.log_ratio, none.log_ratio)


def test_sigma_is_what_noise_makes_of_a_room_of_one_grey(known, sensitivities):
    """Where all spectra are alike only noise is left: at a tenth of the signal it rules sigma."""
    rng = np.random.default_rng(3)
    grey = np.full((6, 32, 32, 36), 0.5) @ sensitivities
    sigma = 0.1 * grey
    bands = Measured(
        (grey + sigma * rng.normal(size=grey.shape)).astype(np.float32),
        (sigma**2).astype(np.float32),
        np.ones(grey.shape[:-1], np.float32),
    )
    change = drift(bands, known=known)[0]
    z = (change.log_ratio - np.nanmedian(change.log_ratio)) / change.sigma
    assert np.nanstd(z) == pytest.approx(1, abs=0.25)


def test_three_filters_are_each_held_against_the_first(photographed):
    room = furnished_room.furnished(2)
    still = photographed(room, room, 2)
    moved = photographed(room, turned(room, 1, 5.0), 3)
    three = Measured(
        np.concatenate([still.values, moved.values[..., 3:]], axis=-1),
        np.concatenate([still.variance, moved.variance[..., 3:]], axis=-1),
        still.valid,
    )
    second, third = drift(three)
    assert second.share < 1e-3 < third.share
    (said,) = worth_telling([second, third], ("cyan", "yellow", "magenta"))
    assert "through cyan and magenta" in said


@pytest.mark.parametrize("size", [16, 33, 64, 100])
def test_any_size_of_map_is_gathered_into_the_same_light(size):
    """One light, twice as strong above: each coarse texel holds what its texels hold."""
    d = cube.directions(size)
    values = np.where(d[..., 1:2] > 0, 2.0, 1.0) * np.arange(1.0, 7.0)
    ones = np.ones(values.shape, np.float32)
    bands = Measured(values.astype(np.float32), 1e-6 * ones, ones[..., 0])
    change = drift(bands)[0]
    n = min(size, 32)
    assert change.log_ratio.shape == (6, n, n)
    assert np.abs(change.log_ratio).max() < 1e-3


def test_what_is_not_known_or_too_dark_is_not_judged(photographed):
    room = furnished_room.furnished(4)
    bands = photographed(room, room, 4)
    bands.values[0, :8, :8] = 1e-9
    change = drift(bands)[0]
    assert np.isnan(change.log_ratio[BLIND]).all()
    assert np.isnan(change.log_ratio[0, :8, :8]).all()
    assert np.isfinite(change.log_ratio[1:5]).mean() > 0.9


def test_a_black_capture_says_nothing():
    black = np.zeros((6, 32, 32, 6), np.float32)
    change = drift(Measured(black, black + 1e-6, black[..., 0] + 1))[0]
    assert np.isnan(change.log_ratio).all()
    assert change.share == 0
    assert worth_telling([change], NAMES) == []


@pytest.fixture(scope="module")
def drift_of(small_capture_once, finished_once, tmp_path_factory):
    """drift_of(factor on yellow) -> what the step says of the small capture, and its map."""
    capture = captures.load(small_capture_once)
    step = next(step for step in STEPS if step.name == "drift")
    folder = tmp_path_factory.mktemp("drift")

    def run(factor, capture=capture):
        bands, names = io.read_measured(finished_once / "cubemap_bands.exr", cube=True)
        bands.values[..., 3:] *= factor
        io.write_measured(folder / "bands.exr", bands, names, {})
        reads = [folder / "bands.exr", finished_once / "work" / "sphere.json"]
        made = folder / "drift.exr"
        return step.run(reads, [made], **step.given(capture, Settings(), 0)), io.read_exr(made)

    return run


def test_photographs_of_steady_light_are_told_to_be_so(finished_once):
    result = json.loads((finished_once / "result.json").read_text())
    learnt = result["steps"]["drift"]["learnt"]
    assert learnt["absolute"]
    assert result["notes"] == []
    yellow = learnt["filters"]["yellow"]
    assert yellow["overall_ratio"] == pytest.approx(1, abs=0.02)
    assert yellow["share_of_light"] < 1e-3


def test_photographs_of_less_light_are_told_to_be_so(drift_of):
    learnt, (maps, names, header) = drift_of(0.9)
    assert learnt["filters"]["yellow"]["overall_ratio"] == pytest.approx(0.9, abs=0.02)
    assert learnt["filters"]["yellow"]["share_of_light"] == pytest.approx(0.1, abs=0.02)
    assert any("all light changed to 0." in note for note in learnt["notes"])
    assert names == ["yellow.log_ratio", "yellow.significance"]
    assert maps.shape == (6 * 32, 32, 2)
    assert np.nanmedian(maps[..., 0]) == pytest.approx(np.log(0.9), abs=0.02)
    assert np.nanmedian(maps[..., 1]) < -4
    assert "cyan" in header["unit"]


def test_a_matrix_fitted_to_a_chart_tells_less_light_too(
    drift_of, small_capture_once, sensitivities, tmp_path
):
    """No curves of camera and filters, only what M_S.toml holds of its chart's session."""
    capture = captures.load(small_capture_once)

    def fitted(signals):
        write_transform(tmp_path / "M_S.toml", replace(capture.transform, signals=signals))
        return replace(capture, calibration=Calibration(transform=tmp_path / "M_S.toml"))

    learnt, _ = drift_of(0.9, fitted(None))  # as earlier versions wrote it
    assert not learnt["absolute"]
    assert learnt["filters"]["yellow"]["overall_ratio"] is None
    seen = chart_under(("A", "D50", "D65", "F2", "F11"), sensitivities)
    learnt, _ = drift_of(0.9, fitted(seen))
    assert learnt["absolute"]
    assert learnt["filters"]["yellow"]["overall_ratio"] == pytest.approx(0.9, abs=0.02)
    assert any("all light changed to 0." in note for note in learnt["notes"])


@pytest.mark.parametrize("as_tagged", [False, True])
def test_brackets_of_other_times_end_on_one_scale(as_tagged):
    """Each filter's exposures are solved by themselves, yet stay comparable: by the nominal times.

    Shutters keep to the series that tags are rounded from (1/60 is 1/64 s), or to the tags.
    """
    levels = np.geomspace(0.02, 20.0, 12)
    world = np.tile(np.repeat(levels, 20), (160, 1))
    rng = np.random.default_rng(7)
    scales = []
    for tags in (
        (1 / 1000, 1 / 250, 1 / 60, 1 / 15, 0.3, 1.0),
        (1 / 500, 1 / 125, 1 / 30, 1 / 8, 0.5),
    ):
        frames = []
        for tag in tags:
            time_s = tag if as_tagged else true_shutter(tag)
            electrons = rng.poisson(np.minimum(world * time_s, 4.0) * 30000.0)
            raw = np.clip(1000.5 + electrons / 30000.0 * 14000.0, 0, 15000).astype(np.uint16)
            level = np.full((2, 2), 1000.0)
            cfa = np.array([[0, 1], [1, 2]])
            frames.append(Frame(raw, cfa, level, level + 14000.0, tag, 100.0, 1.0))
        merged = merge(InMemory(frames)).mosaic
        scales.append(np.nanmedian(merged / world))
    assert scales[0] == pytest.approx(1, abs=2e-3)
    assert scales[1] == pytest.approx(scales[0], rel=2e-3)
