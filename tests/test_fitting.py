"""`sixlight fit`, from a folder of chart photographs and from known curves."""

from __future__ import annotations

import json
import re
import shutil

import numpy as np
import pytest
import small_capture
from chart_photograph import camera_bands, homography, reflectances
from chart_photograph import photograph as chart_photograph

from calibration import chart, primaries, sets
from calibration.fit import fit
from calibration.spectra import WAVELENGTHS, Spectra, write_spectra
from calibration.training import photographed
from calibration.transform import read_transform
from pipeline import fitting

LIGHTS = ("A", "D50", "D65", "F2", "F11")
PATCH_PX, COLUMNS, ROWS = 20, 6, 4


def bands() -> np.ndarray:
    """Curves (36, 6) of the tests' camera behind its filters."""
    rgb, glass = small_capture.sensitivities().values, small_capture.transmittances().values
    return (glass[:, :, None] * rgb[:, None, :]).reshape(len(WAVELENGTHS), -1)


def patches_under(light: str) -> np.ndarray:
    """Spectral radiance (24, 36) of the chart's patches, W/(sr m2 nm)."""
    spd = sets.lights("darling2011")[light]
    return sets.surfaces("colorchecker24").values.T * spd / spd.mean() * 0.02


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """A chart under five lights, one photograph a filter, with boxes and radiances."""
    folder = tmp_path_factory.mktemp("calibration")
    rng = np.random.default_rng(8)
    # half filled boxes: their edges are not to be read
    boxes = ["patch,x0,y0,x1,y1"]
    for i in range(24):
        x, y = PATCH_PX * (i % COLUMNS), PATCH_PX * (i // COLUMNS)
        boxes.append(f"{i + 1},{x + 4},{y + 4},{x + PATCH_PX - 4},{y + PATCH_PX - 4}")
    (folder / "boxes.csv").write_text("\n".join(boxes) + "\n")
    (folder / "calibration.toml").write_text('patches = "boxes.csv"\n')
    for light in LIGHTS:
        (folder / light).mkdir()
        spectra = Spectra(WAVELENGTHS, chart.PATCHES, patches_under(light).T)
        write_spectra(folder / light / "radiance.csv", spectra)
        photograph(folder, light, rng)
    return folder


def photograph(folder, light, rng, *, level=0.6, colours=(1.0, 1.0, 1.0)) -> None:
    """The chart under a light through both filters, the brightest sample at a level of full scale.

    colours  what is left of the light in R, G and B
    """
    signals = _signals(light)
    for k, name in enumerate(small_capture.SHIFTS):
        (folder / light / name).mkdir(exist_ok=True)
        mosaic = _mosaic(signals[:, 3 * k : 3 * k + 3] * colours)
        time_s = level / mosaic.max()
        tag = (round(time_s * 1e6), 10**6)
        raw = _raw(mosaic * time_s, rng)
        small_capture.write_shot(folder / light / name / "chart.dng", raw, tag)


def _signals(light) -> np.ndarray:
    """Of the patches (24, 6), full scales per second."""
    return patches_under(light) @ bands() * 4


def _mosaic(colours) -> np.ndarray:
    """The chart as the sensor sees patches of three colours (24, 3)."""
    image = np.kron(colours.reshape(ROWS, COLUMNS, 3), np.ones((PATCH_PX, PATCH_PX, 1)))
    mosaic = np.empty(image.shape[:2])
    for row in (0, 1):
        for column in (0, 1):
            mosaic[row::2, column::2] = image[row::2, column::2, row + column]
    return mosaic


def _raw(mosaic, rng) -> np.ndarray:
    """Raw samples of a mosaic in full scale."""
    electrons = rng.poisson(mosaic * 40000) / 40000
    scale = small_capture.SATURATION - small_capture.BLACK
    return np.round(small_capture.BLACK + np.minimum(electrons, 1.0) * scale).astype(np.uint16)


def test_a_chart_session_gives_m_s_in_absolute_units(sixlight, session, tmp_path):
    out = tmp_path / "M_S.toml"
    outcome = sixlight("fit", session, "-o", out, "--method", "ridge", "--quiet")
    assert outcome.status == 0, outcome.err
    assert "lights left out" in outcome.out
    transform = read_transform(out)
    assert transform.absolute
    assert transform.method == "ridge"
    assert set(transform.figures) >= {"training_delta_e", "leave_one_light_out_delta_e"}
    assert len(transform.inputs) == 5 * 3 + 1
    seen = np.concatenate([_signals(light) for light in sorted(LIGHTS)]) * 64  # f/8, ISO 100
    assert transform.signals.shape == seen.shape
    np.testing.assert_allclose(transform.signals / seen, 1, rtol=0.05)  # photon noise of dark bands
    # As good as signals that were never photographed: f/8, ISO 100.
    exact = photographed(
        {light: patches_under(light) @ bands() * 4 * 64 for light in LIGHTS},
        {light: np.zeros((24, 6)) for light in LIGHTS},
        {light: Spectra(WAVELENGTHS, chart.PATCHES, patches_under(light).T) for light in LIGHTS},
        patches=chart.PATCHES,
        channels=transform.channels,
    )
    exact = fit(exact, primaries.load(), method="ridge")
    white = sets.lights("darling2011")["D75"] @ bands()
    np.testing.assert_allclose(transform.matrix @ white, exact.matrix @ white, rtol=0.01)
    assert transform.figures["training_delta_e"]["mean"] < 1.0


def test_a_session_of_rounded_times_is_on_one_scale(session, tmp_path):
    """An electronic shutter, 1/60 is 1/60. The first light's brackets alone would pass for 1/64 and
    1/16, and its signals for 7 % brighter than the others'."""
    rng = np.random.default_rng(9)
    folder = shutil.copytree(session, tmp_path / "session")
    most = max(_signals(light).max() for light in LIGHTS)
    truth = {light: _signals(light) * 9 / most for light in LIGHTS}  # full scales per second
    for light in LIGHTS:
        tags = (60, 15) if light == LIGHTS[0] else (500, 60)
        for k, name in enumerate(small_capture.SHIFTS):
            (folder / light / name / "chart.dng").unlink()
            mosaic = _mosaic(truth[light][:, 3 * k : 3 * k + 3])
            for tag in tags:
                raw = _raw(mosaic / tag, rng)
                small_capture.write_shot(folder / light / name / f"{tag}.dng", raw, (1, tag))
    fitted = fitting.from_session(folder, None, "ridge", quiet=True)
    assert fitted.transform.figures["notes"] == []
    for light, signals in zip(fitted.chart.lights, fitted.chart.signals, strict=True):
        seen, known = (v.reshape(24, 2, 3).sum(axis=(0, 2)) for v in (signals, truth[light]))
        # f/8. Exposures are solved to .1 %; a filter's bands of all patches are known better.
        np.testing.assert_allclose(seen / (64 * known), 1, atol=0.003)


def test_the_same_session_gives_m_r(session):
    fitted = fitting.from_session(session, None, "ridge", reflectance=True, quiet=True)
    assert fitted.transform.quantity == "reflectance"
    assert fitted.transform.signals is None
    np.testing.assert_allclose(fitted.transform.matrix @ np.ones(6), 1.0, atol=0.01)
    assert "reflectance factor" in fitting.as_text(fitted, session)
    by_light = fitted.residuals.delta_e.mean(axis=1)
    expected = fitted.transform.figures["light_delta_e"]
    expected = [expected[light] for light in fitted.residuals.lights]
    np.testing.assert_allclose(by_light, expected, atol=6e-5)


def test_the_report_says_how_far_each_patch_is_off_under_each_light(sixlight, session, tmp_path):
    out = tmp_path / "M_S.toml"
    asked = ("fit", session, "-o", out, "--method", "ridge", "--quiet")
    figures = json.loads(sixlight(*asked, "--json").out)
    assert figures["matrix"] == read_transform(out).matrix.tolist()
    assert sorted(figures["delta_e"]) == sorted(LIGHTS)
    # The transform's own figures are means of the same, computed elsewhere.
    for light, off in figures["delta_e"].items():
        assert list(off) == list(chart.PATCHES)
        assert np.mean(list(off.values())) == pytest.approx(
            figures["light_delta_e"][light], abs=1e-4
        )
    of_patch = [figures["delta_e"][light]["15"] for light in LIGHTS]
    assert np.mean(of_patch) == pytest.approx(figures["sample_delta_e"]["15"], abs=1e-4)
    said = sixlight(*asked).out
    for light, off in figures["delta_e"].items():
        worst = max(off, key=off.get)
        (line,) = (line for line in said.splitlines() if line.split()[:1] == [light])
        assert f"patches {worst} {off[worst]:.2f}" in line


def test_clipped_and_uneven_patches_are_named_and_left_out(session, tmp_path):
    folder = shutil.copytree(session, tmp_path / "copy")
    boxes = (folder / "boxes.csv").read_text().splitlines()
    reaching = "12,90,24,119,36"  # to the next one's edge
    (folder / "boxes.csv").write_text("\n".join([*boxes[:12], reaching, *boxes[13:]]))
    photograph(folder, "D65", np.random.default_rng(3), level=1.5)
    got = fitting.from_session(folder, None, "ridge", quiet=True)
    left_out = got.transform.figures["left_out"]
    assert any(said.startswith("patch 12 is uneven in") for said in left_out)
    assert any(
        re.match(r"patch(es)? .*19.* clips? in .* under D65 through cyan", said)
        for said in left_out
    )
    off = fitting.figures(got)["delta_e"]
    assert off["A"]["12"] is None
    assert off["D65"]["19"] is None
    assert off["A"]["19"] < 3.0


def a_chart_upside_down(folder):
    boxes = (folder / "boxes.csv").read_text().splitlines()
    places = [row.split(",", 1)[1] for row in boxes[:0:-1]]
    rows = [f"{i + 1},{place}" for i, place in enumerate(places)]
    (folder / "boxes.csv").write_text("\n".join([boxes[0], *rows]))


def in_unit(factor):
    def spoil(folder):
        rewrite(folder, lambda values: values * factor)

    return spoil


def rewrite(folder, change, names=chart.PATCHES, light="A"):
    """Another radiance.csv of a light, whatever it then says."""
    spectra = Spectra(WAVELENGTHS, tuple(names), change(patches_under(light).T.copy()))
    write_spectra(folder / light / "radiance.csv", spectra)


def a_negative_patch(folder):
    rewrite(folder, lambda values: np.where(np.arange(24) == 3, -values, values))


def a_constant_patch(folder):
    rewrite(folder, lambda values: np.where(np.arange(24) == 18, values[:, 18].mean(), values))


def readings_of_another_light(folder):
    shutil.copy(folder / "A" / "radiance.csv", folder / "D65" / "radiance.csv")


def readings_down_the_columns(folder):
    rewrite(folder, lambda values: values.reshape(36, 4, 6).swapaxes(1, 2).reshape(36, 24))


def other_names(folder):
    rewrite(folder, lambda values: values, [f"patch {name}" for name in chart.PATCHES])


def all_but_the_darkest_clip(folder):
    for light in LIGHTS[1:]:
        shutil.rmtree(folder / light)
    photograph(folder, "A", np.random.default_rng(4), level=15.0)


def no_blue(folder):
    photograph(folder, "A", np.random.default_rng(5), colours=(1.0, 1.0, 0.0))


def one_filter_twice(folder):
    for light in LIGHTS:
        shutil.copy(folder / light / "cyan" / "chart.dng", folder / light / "yellow")


def no_yellow_under_a(folder):
    shutil.rmtree(folder / "A" / "yellow")


def a_third_filter_under_all_but_a(folder):
    for light in LIGHTS[1:]:
        shutil.copytree(folder / light / "cyan", folder / light / "magenta")


def corners_the_wrong_way(folder):
    (folder / "calibration.toml").write_text("corners = [[0, 0], [0, 80], [120, 80], [120, 0]]\n")


def a_picture_without_a_chart(folder):
    (folder / "calibration.toml").write_text("")  # these patches touch: no squares to be seen


@pytest.mark.parametrize(
    ("spoil", "naming", "remedy"),
    [
        (in_unit(1000.0), "light 'A': the chart shines with", "mW, um and cm2"),
        (in_unit(0.001), "times the radiance per signal of others", "convert its unit"),
        (a_negative_patch, "A/radiance.csv: line 37, column '4'", "subtract the dark reading"),
        (a_constant_patch, "light 'A', patch 19:", "measure it; this is a stand-in"),
        (readings_of_another_light, "light 'D65' has the readings of 'A'", "remove one of the two"),
        (readings_down_the_columns, "A: the patches' signals do not follow", "name each reading"),
        (other_names, "no column for patch 1, 2, 3, 4, 5, 6 and 18 more, but patch 1", "rename"),
        (a_chart_upside_down, "A: the patches look like the readings in reverse", "180 degrees"),
        (all_but_the_darkest_clip, "whole samples for 6 bands", "clip in R, G, B under A"),
        (no_blue, "cyan.B sees nothing under A", "expose longer"),
        (one_filter_twice, "follow from the other bands", "use filters that differ"),
        (no_yellow_under_a, "A: no photographs through yellow", "take them"),
        (a_third_filter_under_all_but_a, "A: no photographs through magenta", "take them"),
        (corners_the_wrong_way, "that do not go clockwise", "order them so"),
        (a_picture_without_a_chart, "A: no colorchecker24 found", "corners = [[x, y], ...]"),
    ],
)
def test_a_session_that_gives_no_matrix_is_refused_in_a_line(
    sixlight, session, tmp_path, spoil, naming, remedy
):
    folder = shutil.copytree(session, tmp_path / "copy")
    spoil(folder)
    out = tmp_path / "M_S.toml"
    outcome = sixlight("fit", folder, "-o", out, "--method", "ridge", "--quiet")
    assert outcome.status == 2
    assert outcome.out == ""
    lines = [line for line in outcome.err.splitlines() if "yellow.B sees nothing" not in line]
    assert len(lines) == 1
    assert naming in lines[0]
    assert remedy in lines[0]
    assert str(folder) in lines[0]
    assert not out.exists()


@pytest.mark.slow
def test_an_sg_session_needs_nothing_but_its_photographs_and_readings(sixlight, tmp_path):
    kind = chart.COLORCHECKER_SG
    names = chart.CHARTS[kind]
    glass = small_capture.transmittances()
    to_image = homography(4, 30.0, kind=kind, size=(360, 480))
    (tmp_path / "calibration.toml").write_text(f'chart = "{kind}"\nmethod = "ridge"\n')
    for light in ("A", "D65", "F11"):
        lamp = sets.lights("darling2011")[light]
        radiance = reflectances(kind) * lamp * (0.02 / lamp.mean())
        (tmp_path / light).mkdir()
        spectra = Spectra(WAVELENGTHS, names, radiance.T)
        write_spectra(tmp_path / light / "radiance.csv", spectra)
        for name in glass.names:
            seen = camera_bands(light, glass[name]) * (0.02 / lamp.mean())
            image, _ = chart_photograph(seen, to_image, kind, size=(360, 480), noise=0.003)
            mosaic = np.empty(image.shape[:2])
            for row in (0, 1):
                for column in (0, 1):
                    mosaic[row::2, column::2] = image[row::2, column::2, row + column]
            time_s = 0.8 / mosaic.max()
            scale = small_capture.SATURATION - small_capture.BLACK
            raw = np.round(small_capture.BLACK + mosaic * time_s * scale).astype(np.uint16)
            (tmp_path / light / name).mkdir()
            tag = (round(time_s * 1e6), 10**6)
            small_capture.write_shot(tmp_path / light / name / "chart.dng", raw, tag)
    outcome = sixlight("fit", tmp_path, "--json", "--quiet")
    assert outcome.status == 0, outcome.err
    figures = json.loads(outcome.out)
    assert [len(off) for off in figures["delta_e"].values()] == [140] * 3
    assert figures["training_delta_e"]["mean"] < 1.5


def test_the_papers_method_is_a_word_away(sixlight, session, tmp_path):
    out = tmp_path / "M_S.toml"
    assert sixlight("fit", session, "-o", out, "--method", "pinv", "--quiet").status == 0
    transform = read_transform(out)
    assert transform.method == "pinv"
    assert max(transform.figures["noise_amplification"]) > 5


def test_known_curves_give_m_s(sixlight, tmp_path):
    write_spectra(tmp_path / "C.csv", small_capture.sensitivities())
    write_spectra(tmp_path / "F.csv", small_capture.transmittances())
    curves = ["--camera", tmp_path / "C.csv", "--filters", tmp_path / "F.csv"]
    out = tmp_path / "M_S.toml"
    assert sixlight("fit", *curves, "-o", out, "--quiet").status == 0
    transform = read_transform(out)
    assert not transform.absolute
    light = sets.lights("darling2011")["D65"]
    made = transform.matrix @ (light @ bands())
    ratio = made / primaries.load().project(light)
    assert np.ptp(ratio) / ratio.mean() < 0.04


@pytest.mark.slow
def test_an_earlier_transform_is_replaced_and_another_file_is_not(sixlight, session, tmp_path):
    out = tmp_path / "M_S.toml"
    asked = ("fit", session, "-o", out, "--method", "pinv", "--quiet")
    assert sixlight(*asked).status == 0
    assert sixlight(*asked).status == 0
    out.write_text("a diary")
    refused = sixlight(*asked)
    assert refused.status == 2
    assert out.read_text() == "a diary"
    assert sixlight(*asked, "--force").status == 0


@pytest.mark.parametrize(
    ("arguments", "naming"),
    [
        (["nowhere"], "no such folder"),
        ([], "give a calibration folder"),
        (["--camera", "C.csv"], "--filters"),
        (["--camera", "C.csv", "--filters", "F.csv"], "C.csv"),
    ],
)
def test_what_fit_cannot_use_is_named(sixlight, arguments, naming):
    outcome = sixlight("fit", *arguments)
    assert outcome.status == 2
    assert naming in outcome.err
    assert len(outcome.err.splitlines()) == 1


def test_primaries_are_written_as_two_tables(sixlight, tmp_path):
    outcome = sixlight("primaries", "darling2011", "-o", tmp_path / "set")
    assert outcome.status == 0
    again = primaries.load(tmp_path / "set")
    np.testing.assert_array_equal(again.curves, primaries.load("darling2011").curves)
    assert sixlight("primaries", "darling1911", "-o", tmp_path / "other").status == 2


def test_inspect_touches_nothing(sixlight, small):
    from conftest import digests

    before = digests(small)
    outcome = sixlight("inspect", small)
    assert outcome.status == 0
    assert "cyan_3.dng" in outcome.out
    assert "Tests Plain" in outcome.out
    assert digests(small) == before
