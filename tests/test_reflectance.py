"""A painting in uneven light comes back as its reflectances; bad folders are named."""

import json
import shutil
import warnings

import flat_capture
import numpy as np
import pytest
import small_capture

from calibration import sets, transform
from calibration.adaptation import D65, cat02
from calibration.difference import delta_e_2000, lab
from calibration.errors import InputError
from pipeline import io, reflectance
from pipeline.files import header


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
    # Colour: what the figures say noise does, beside what it did, shrunk to where the first order
    # holds. A Gaussian of one to three dimensions lies under .67 to .89 of its rms half the time.
    light = flat_capture.PRIMARIES.project(sets.lights("darling2011")["D65"])
    to_xyz = flat_capture.PRIMARIES.xyz_from_primaries * light
    white = to_xyz.sum(axis=1)
    seen = measured.values[inner].reshape(-1, 6)
    seen = seen[np.isfinite(seen).all(axis=1)] @ to_xyz.T
    adapted = cat02(white, D65) / white[1]
    shrunk = white + (seen - seen.mean(axis=0)) / 100
    off = 100 * delta_e_2000(lab(adapted @ white), lab(shrunk @ adapted.T))
    told = figures["noise_delta_e"]
    assert told["light"] == "D65"
    assert 0.6 < np.median(off) / told["median"] < 1.0
    assert told["median"] < told["p95"]
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


def test_surface_and_white_of_other_times_are_on_one_scale(folder):
    """An electronic shutter: 1/60 is 1/60. The white's times alone would pass for 1/64 and 1/16."""
    rng = np.random.default_rng(7)
    for name, tags in (("surface", ((1, 500), (1, 60))), ("white", ((1, 60), (1, 15)))):
        shutil.rmtree(folder / name)
        times_s = [numerator / denominator for numerator, denominator in tags]
        flat_capture.photograph(
            folder / name, flat_capture.white, rng, times_s=times_s, tags=tags, dim=0.3
        )
    session = reflectance.load(folder / "surface", folder / "white", folder / "M_R.toml")
    figures = reflectance.reflectance(session, folder / "out.exr", quiet=True)
    measured, _ = io.read_measured(folder / "out.exr")
    # 1 % is what .1 % of an exposure may come to in this matrix; 1/64 for 1/60 would be 7.
    np.testing.assert_allclose(np.nanmean(measured.values, axis=(0, 1)), 1, atol=0.01)
    assert not any("shutter's true times" in note for note in figures["notes"])


def test_a_shutter_that_surface_and_white_do_not_tell_is_noted(folder):
    rng = np.random.default_rng(8)
    for name, tag in (("surface", (1, 500)), ("white", (1, 60))):
        shutil.rmtree(folder / name)
        flat_capture.photograph(
            folder / name, flat_capture.white, rng, times_s=[tag[0] / tag[1]], tags=[tag], dim=0.3
        )
    session = reflectance.load(folder / "surface", folder / "white", folder / "M_R.toml")
    notes = reflectance.reflectance(session, folder / "out.exr", quiet=True)["notes"]
    assert any(
        "surface through cyan and the 3 others may differ in scale by 4.2%" in n for n in notes
    )


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


def spoil_camera(folder):
    for path in (folder / "white").rglob("*.dng"):
        raw = np.full(flat_capture.SIZE, 900, np.uint16)
        small_capture.write_shot(path, raw, flat_capture.TAGS[0], model="Another")


def spoil_outside(folder):
    (folder / "white" / "capture.toml").write_text(
        '[[filter]]\nname = "cyan"\nfiles = "../*"\n[[filter]]\nname = "yellow"\n'
    )


def spoil_singular(folder):
    from dataclasses import replace

    m_r = flat_capture.m_r()
    transform.write_transform(folder / "M_R.toml", replace(m_r, matrix=0 * m_r.matrix))


@pytest.mark.parametrize(
    ("spoil", "line"),
    [
        (
            spoil_rename,
            "white: the filters amber, cyan (expected cyan, yellow, as the surface has); "
            "photograph the white through the same filters, or rename the folders",
        ),
        (
            spoil_missing,
            "white: no such folder (expected a folder of raw photographs); check the path",
        ),
        (
            spoil_one_filter,
            "surface: only one filter, 'cyan' (expected photographs through two filters or more); "
            "add the other filter's folder",
        ),
        (
            spoil_no_raw,
            "surface: no raw files found (expected a sub-folder of raw files for each filter, such"
            " as cyan/ and yellow/); copy the photographs there or name them in capture.toml",
        ),
        (
            spoil_text,
            "white/cyan/0.dng: the raw data cannot be decoded (Input/output error) (expected a "
            "complete raw file); copy the file again from the camera",
        ),
        (
            spoil_count,
            "white: filters have unequal numbers of photographs: 1 cyan, 2 yellow (expected the "
            "same bracket through each filter); add the missing photographs or remove the surplus",
        ),
        (
            spoil_camera,
            "white/cyan/0.dng: camera 'Tests Another' (expected 'Tests Plain' as in "
            "FOLDER/surface/cyan/0.dng); keep photographs of one camera and setting only",
        ),
        (
            spoil_outside,
            "white/capture.toml: filter[1].files is '../*' (expected files inside the capture's "
            "folder); move them there",
        ),
        (
            spoil_light,
            "M_R.toml: a matrix for light (M_S) (expected one for reflectance (M_R)); "
            "name the M_R that sixlight fit wrote",
        ),
        (
            spoil_scale,
            "M_R.toml: M_R makes 99.20, 100.14, 99.61, 99.82, 100.54, 99.76 of a white (expected "
            "about 1 in each primary); fit it from signals over those of a white: "
            "sixlight fit --reflectance",
        ),
        (
            spoil_singular,
            "M_R.toml: M_R makes 0.00, 0.00, 0.00, 0.00, 0.00, 0.00 of a white (expected "
            "about 1 in each primary); fit it from signals over those of a white: "
            "sixlight fit --reflectance",
        ),
        (
            spoil_bands,
            "M_R.toml: a matrix for the bands cyan.R, cyan.G, cyan.B, red.R, red.G, red.B "
            "(expected cyan.R, cyan.G, cyan.B, yellow.R, yellow.G, yellow.B, as the capture has); "
            "fit one for this capture's filters, or rename the filters",
        ),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_bad_input_takes_one_line(sixlight, folder, spoil, line):
    spoil(folder)
    said = run(sixlight, folder)
    assert said == f"{folder}/{line}\n".replace("FOLDER", str(folder))


def run(sixlight, folder, *more) -> str:
    """What the command says of a spoilt folder; nothing may have been written."""
    before = sorted(folder.rglob("*"))
    names = [folder / "surface", "--white", folder / "white", "--transform", folder / "M_R.toml"]
    outcome = sixlight("reflectance", *names, "-o", folder / "out.exr", *more)
    assert outcome.status == 2
    assert sorted(folder.rglob("*")) == before
    return outcome.err


def test_a_matrix_that_is_not_there_or_for_other_primaries(sixlight, folder):
    said = run(sixlight, folder, "--primaries", "signed6")
    assert said == (
        f"{folder}/M_R.toml: a matrix to the primaries 'darling2011' (expected 'signed6'); "
        "fit the matrix again, or choose the primaries it was fitted to\n"
    )
    spoil_no_transform(folder)
    said = run(sixlight, folder)
    assert said.startswith(f"{folder}/M_R.toml: no such file")
    assert len(said.splitlines()) == 1


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
