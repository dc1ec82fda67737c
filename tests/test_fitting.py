"""`sixlight fit`, from a folder of chart photographs and from known curves."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
import small_capture

from calibration import chart, fit, primaries, sets
from calibration.errors import InputError
from calibration.spectra import WAVELENGTHS, Spectra, write_spectra
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
        radiance = patches_under(light)
        (folder / light).mkdir()
        spectra = Spectra(WAVELENGTHS, chart.PATCHES, radiance.T)
        write_spectra(folder / light / "radiance.csv", spectra)
        signals = radiance @ bands() * 4  # full scales per second
        for k, name in enumerate(small_capture.SHIFTS):
            (folder / light / name).mkdir()
            colours = signals[:, 3 * k : 3 * k + 3].reshape(ROWS, COLUMNS, 3)
            image = np.kron(colours, np.ones((PATCH_PX, PATCH_PX, 1)))
            mosaic = np.empty(image.shape[:2])
            for row in (0, 1):
                for column in (0, 1):
                    mosaic[row::2, column::2] = image[row::2, column::2, row + column]
            time_s = 0.6 / mosaic.max()
            electrons = rng.poisson(mosaic * time_s * 40000) / 40000
            scale = small_capture.SATURATION - small_capture.BLACK
            raw = np.round(small_capture.BLACK + electrons * scale).astype(np.uint16)
            tag = (round(time_s * 1e6), 10**6)
            small_capture.write_shot(folder / light / name / "chart.dng", raw, tag)
    return folder


def test_a_chart_session_gives_m_s_in_absolute_units(sixlight, session, tmp_path):
    out = tmp_path / "M_S.toml"
    outcome = sixlight("fit", session, "-o", out, "--quiet")
    assert outcome.status == 0, outcome.err
    assert "lights left out" in outcome.out
    transform = fit.read_transform(out)
    assert transform.absolute
    assert transform.method == "delta-e"
    assert set(transform.figures) >= {"training_delta_e", "leave_one_light_out_delta_e"}
    assert len(transform.inputs) == 5 * 3 + 1
    # As good as signals that were never photographed: f/8, ISO 100.
    radiances = np.concatenate([patches_under(light) for light in LIGHTS])
    exact = fit.fit(
        radiances @ bands() * 4 * 64,
        radiances,
        primaries=primaries.load("darling2011"),
        channels=transform.channels,
        groups=[light for light in LIGHTS for _ in range(24)],
        method="delta-e",
    )
    white = sets.lights("darling2011")["D75"] @ bands()
    np.testing.assert_allclose(transform.matrix @ white, exact.matrix @ white, rtol=0.01)
    assert transform.figures["training_delta_e"]["mean"] < 1.0


def test_the_same_session_gives_m_r(session):
    transform = fitting.from_session(session, None, None, reflectance=True, quiet=True)
    assert transform.quantity == "reflectance"
    np.testing.assert_allclose(transform.matrix @ np.ones(6), 1.0, atol=0.01)
    assert "reflectance factor" in fitting.as_text(transform, session)


def test_a_chart_upside_down_and_a_spoilt_patch_are_named(session, tmp_path):
    folder = shutil.copytree(session, tmp_path / "copy")
    boxes = (folder / "boxes.csv").read_text().splitlines()
    wide = [*boxes[:12], "12,104,24,119,36", *boxes[13:]]  # reaches the next one's edge
    (folder / "boxes.csv").write_text("\n".join(wide).replace("12,104,24", "12,90,24"))
    got = fitting.from_session(folder, None, "ridge", quiet=True)
    assert any(said.startswith("patch 12 is uneven in") for said in got.figures["left_out"])
    places = [row.split(",", 1)[1] for row in boxes[:0:-1]]
    turned = [f"{i + 1},{place}" for i, place in enumerate(places)]
    (folder / "boxes.csv").write_text("\n".join([boxes[0], *turned]))
    with pytest.raises(InputError, match="a chart upside down"):
        fitting.from_session(folder, None, "ridge", quiet=True)


def test_the_papers_method_is_a_word_away(sixlight, session, tmp_path):
    out = tmp_path / "M_S.toml"
    assert sixlight("fit", session, "-o", out, "--method", "pinv", "--quiet").status == 0
    transform = fit.read_transform(out)
    assert transform.method == "pinv"
    assert max(transform.figures["noise_amplification"]) > 5


def test_known_curves_give_m_s(sixlight, tmp_path):
    write_spectra(tmp_path / "C.csv", small_capture.sensitivities())
    write_spectra(tmp_path / "F.csv", small_capture.transmittances())
    curves = ["--camera", tmp_path / "C.csv", "--filters", tmp_path / "F.csv"]
    out = tmp_path / "M_S.toml"
    assert sixlight("fit", *curves, "-o", out, "--quiet").status == 0
    transform = fit.read_transform(out)
    assert not transform.absolute
    light = sets.lights("darling2011")["D65"]
    made = transform.matrix @ (light @ bands())
    ratio = made / primaries.load("darling2011").project(light)
    assert np.ptp(ratio) / ratio.mean() < 0.04


def test_an_earlier_transform_is_replaced_and_another_file_is_not(sixlight, session, tmp_path):
    out = tmp_path / "M_S.toml"
    assert sixlight("fit", session, "-o", out, "--quiet").status == 0
    assert sixlight("fit", session, "-o", out, "--quiet").status == 0
    out.write_text("a diary")
    refused = sixlight("fit", session, "-o", out, "--quiet")
    assert refused.status == 2
    assert out.read_text() == "a diary"
    assert sixlight("fit", session, "-o", out, "--quiet", "--force").status == 0


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
