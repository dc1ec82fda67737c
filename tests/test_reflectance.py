"""A painting in uneven light comes back as its reflectances; bad folders are named."""

import json
import shutil
import warnings

import flat_capture
import numpy as np
import pytest

from calibration import transform
from calibration.errors import InputError
from pipeline import header, io, reflectance


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return flat_capture.make(tmp_path_factory.mktemp("flat"))


@pytest.fixture(scope="module")
def finished(made):
    session = reflectance.load(made / "surface", made / "white", made / "M_R.toml")
    figures = reflectance.reflectance(session, made / "painting.exr", quiet=True)
    return made / "painting.exr", figures


@pytest.fixture
def folder(made, tmp_path):
    """A copy that a test may spoil."""
    return shutil.copytree(made, tmp_path / "flat", ignore=shutil.ignore_patterns("*.exr"))


def test_the_painting_comes_back(finished):
    measured, names = io.read_measured(finished[0])
    known = measured.valid > 0
    assert names == flat_capture.PRIMARIES.channels
    assert known.mean() > 0.95
    error = (measured.values - flat_capture.truth())[known]
    # In the mean: nothing of the lamp's shading (2 times over the frame), its colour, the shift.
    assert np.abs(error.mean(axis=0)).max() < 0.002
    # Per pixel: noise, which this matrix raises 4 to 40 times, and edges softened by demosaicing.
    sigma = np.sqrt(measured.variance[known])
    assert (np.median(np.abs(error), axis=0) < 1.5 * np.median(sigma, axis=0)).all()
    for part in (np.s_[:40, :40], np.s_[-40:, -40:]):
        local = (measured.values - flat_capture.truth())[part]
        assert np.abs(np.nanmean(local, axis=(0, 1))).max() < 0.012


def test_the_filters_are_registered(finished):
    figures = finished[1]
    np.testing.assert_allclose(figures["shifts_px"], list(flat_capture.SHIFTS.values()), atol=0.04)
    assert figures["shading"]["cyan.G"] == pytest.approx(0.49, abs=0.04)
    assert figures["notes"] == []


def test_the_file_says_what_it_is(finished):
    path, _ = finished
    _, channels, about = io.read_exr(path)
    assert {"P1", "P6", "valid", "sigma.P1", "sigma.P6"} <= set(channels)
    assert about["quantity"] == "reflectance"
    assert about["name"] == "surface"
    assert header.primaries_of(path, flat_capture.PRIMARIES.channels, about).name == "darling2011"


def test_a_plain_white_is_one_and_its_noise_is_as_told(folder):
    rng = np.random.default_rng(5)
    flat_capture.photograph(folder / "again", flat_capture.white, rng)
    session = reflectance.load(folder / "again", folder / "white", folder / "M_R.toml")
    figures = reflectance.reflectance(session, folder / "white.exr", quiet=True)
    measured, _ = io.read_measured(folder / "white.exr")
    inner = np.s_[20:-20, 20:-20]
    # The exposures of each bracket are known to .1 %; this matrix makes up to 1 % of it.
    np.testing.assert_allclose(np.nanmean(measured.values[inner], axis=(0, 1)), 1, atol=0.01)
    z = (measured.values[inner] - 1) / np.sqrt(measured.variance[inner])
    assert 0.6 < np.nanstd(z) < 1.4
    assert "without texture" in figures["notes"][0]
    assert figures["correlation"] == [1.0, None]
    assert json.loads(json.dumps(figures, allow_nan=False)) == figures


def test_filters_may_be_named_in_another_order(folder):
    (folder / "white" / "capture.toml").write_text(
        "".join(f'[[filter]]\nname = "{name}"\n' for name in ("yellow", "cyan"))
    )
    session = reflectance.load(folder / "surface", folder / "white", folder / "M_R.toml")
    assert [f.name for f in session.white] == [f.name for f in session.surface]


def test_different_exposures_are_noted(folder):
    rng = np.random.default_rng(6)
    shutil.rmtree(folder / "white")
    flat_capture.photograph(
        folder / "white",
        flat_capture.white,
        rng,
        times_s=(2.0**-6,),
        tags=((1, 60),),
    )
    session = reflectance.load(folder / "surface", folder / "white", folder / "M_R.toml")
    assert "exposure times" in session.notes[0]


def spoil_rename(folder):
    (folder / "white" / "yellow").rename(folder / "white" / "amber")


def spoil_missing(folder):
    shutil.rmtree(folder / "white")


def spoil_one_filter(folder):
    shutil.rmtree(folder / "surface" / "yellow")


def spoil_no_raw(folder):
    for sub in (folder / "surface").iterdir():
        shutil.rmtree(sub)


def spoil_text(folder):
    (folder / "white" / "cyan" / "0.dng").write_text("not a photograph")


def spoil_count(folder):
    next((folder / "white" / "cyan").iterdir()).unlink()


def spoil_light(folder):
    from dataclasses import replace

    matrix = replace(flat_capture.m_r(), quantity=transform.LIGHT)
    transform.write_transform(folder / "M_R.toml", matrix)


def spoil_scale(folder):
    from dataclasses import replace

    m_r = flat_capture.m_r()
    transform.write_transform(folder / "M_R.toml", replace(m_r, matrix=100 * m_r.matrix))


def spoil_bands(folder):
    channels = tuple(f"{f}.{c}" for f in ("cyan", "red") for c in "RGB")
    transform.write_transform(folder / "M_R.toml", flat_capture.m_r(channels))


def spoil_no_transform(folder):
    (folder / "M_R.toml").unlink()


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (spoil_rename, "filters amber, cyan"),
        (spoil_missing, "no such folder"),
        (spoil_one_filter, "only one filter"),
        (spoil_no_raw, "no raw files"),
        (spoil_text, r"cyan.0\.dng"),
        (spoil_count, "unequal numbers"),
        (spoil_light, "M_R"),
        (spoil_scale, "of a white"),
        (spoil_bands, r"red\.R"),
        (spoil_no_transform, "no such file"),
    ],
)
def test_bad_input_is_named(folder, spoil, said):
    spoil(folder)
    with pytest.raises(InputError, match=said):
        reflectance.load(folder / "surface", folder / "white", folder / "M_R.toml")


def test_everything_wrong_is_said_at_once(folder):
    spoil_one_filter(folder)
    spoil_count(folder)
    spoil_light(folder)
    with pytest.raises(InputError) as raised:
        reflectance.load(folder / "surface", folder / "white", folder / "M_R.toml")
    said = str(raised.value)
    assert "only one filter" in said
    assert "unequal numbers" in said
    assert "M_S" in said


def test_surface_and_white_must_be_two(folder):
    with pytest.raises(InputError, match="same folder"):
        reflectance.load(folder / "white", folder / "white", folder / "M_R.toml")


def test_nothing_is_overwritten_unasked(finished, made):
    session = reflectance.load(made / "surface", made / "white", made / "M_R.toml")
    with pytest.raises(InputError, match="exists"):
        reflectance.reflectance(session, finished[0], quiet=True)


def test_a_moved_painting_is_refused(folder):
    rng = np.random.default_rng(7)
    shutil.rmtree(folder / "surface" / "yellow")

    def elsewhere(x, y):
        return flat_capture.painting(y * 1.4 + 300, x * 0.7 - 200)

    flat_capture.photograph(folder / "moved", elsewhere, rng)
    (folder / "moved" / "yellow").rename(folder / "surface" / "yellow")
    session = reflectance.load(folder / "surface", folder / "white", folder / "M_R.toml")
    with pytest.raises(InputError, match="does not match"):
        reflectance.reflectance(session, folder / "out.exr", quiet=True)
    assert not (folder / "out.exr").exists()


def test_a_white_that_clips_everywhere_is_refused(folder):
    rng = np.random.default_rng(8)
    shutil.rmtree(folder / "white")
    flat_capture.photograph(folder / "white", flat_capture.white, rng, dim=2000.0)
    session = reflectance.load(folder / "surface", folder / "white", folder / "M_R.toml")
    with warnings.catch_warnings(), pytest.raises(InputError):
        reflectance.reflectance(session, folder / "out.exr", quiet=True)
    assert not (folder / "out.exr").exists()
