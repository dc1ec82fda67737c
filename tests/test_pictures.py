"""Pictures as files: other programs read the numbers, and know which colours they are."""

import io
import re
import struct
import warnings

import measured_screen as screen
import numpy as np
import OpenImageIO as oiio
import pytest

from calibration import icc, measured_display, sets
from calibration import primaries as primary_sets
from calibration.display import DISPLAY_P3, REC2020_PQ, SRGB, rec2020_pq
from calibration.look import Look, shown
from pipeline import io as files
from pipeline import pictures
from pipeline.files import header as headers

LAMP = np.array([1.09850, 1.0, 0.35585])  # illuminant A, CIE 15


@pytest.fixture(scope="module")
def panel():
    return measured_display.characterise(measured_display.check(screen.table()), "panel").display


@pytest.fixture(scope="module")
def signal():
    return np.random.default_rng(1).random((12, 20, 3)).astype(np.float32)


@pytest.fixture
def xyz(tmp_path):
    """An XYZ EXR under a lamp, whose header tells the lamp's colour."""
    values = np.random.default_rng(2).uniform(0.02, 0.5, (12, 20, 3)) * LAMP
    path = tmp_path / "lit.exr"
    files.write_exr(path, values, "XYZ", pictures.about_white(3 * LAMP))
    return path


def read(path):
    """Pixels as they are stored, and the attributes, by OpenImageIO."""
    image = oiio.ImageInput.open(str(path))
    pixels = image.read_image(image.spec().format)
    attributes = {p.name: p.value for p in image.spec().extra_attribs}
    image.close()
    return pixels, attributes


def chunks(path):
    """The chunks of a PNG in order, by name; of two of a name the last."""
    data, at, found = path.read_bytes(), 8, {}
    while at < len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        found[data[at + 4 : at + 8].decode()] = data[at + 8 : at + 8 + length]
        at += 12 + length
    return found


def quantised(signal, bits):
    return np.rint(signal * (2**bits - 1)).astype(f"uint{bits}")


# ----------------------------------------------------------------------------------- the formats


@pytest.mark.parametrize(
    ("display", "suffix"),
    [
        (display, suffix)
        for display in (SRGB, DISPLAY_P3, REC2020_PQ, None)
        for suffix in files.PICTURES
        if not (display is REC2020_PQ and suffix.startswith(".tif"))  # which pictures.check refuses
    ],
    ids=lambda given: given if isinstance(given, str) else given.name if given else "panel",
)
@pytest.mark.parametrize("bits", [8, 16])
def test_numbers_and_colours_come_back(tmp_path, signal, panel, suffix, bits, display):
    display = display or panel
    path = tmp_path / f"picture{suffix}"
    files.write_picture(path, signal, display, bits=bits)
    pixels, attributes = read(path)
    assert pixels.dtype == f"uint{bits}"
    np.testing.assert_array_equal(pixels, quantised(signal, bits))
    if display.cicp and not suffix.startswith(".tif"):
        assert tuple(attributes["CICP"]) == (*display.cicp, 0, 1)
    else:
        assert attributes["ICCProfile:profile_description"] == display.name
        assert bytes(attributes["ICCProfile"]) == icc.profile(display)


def test_a_png_gives_one_account_of_its_colours(tmp_path, signal, panel):
    path = tmp_path / "picture.png"

    def said(display):
        files.write_picture(path, signal, display, bits=16)
        return {k: v for k, v in chunks(path).items() if k in {"cICP", "iCCP", "sRGB", "gAMA"}}

    # primaries, transfer function, matrix coefficients, full range: Rec. ITU-T H.273
    assert said(SRGB)["cICP"] == bytes([1, 13, 0, 1])
    assert "sRGB" in said(SRGB)
    assert said(DISPLAY_P3)["cICP"] == bytes([12, 13, 0, 1])
    assert said(DISPLAY_P3).keys() == {"cICP", "iCCP"}
    assert said(REC2020_PQ) == {"cICP": bytes([9, 16, 0, 1])}
    assert said(panel).keys() == {"iCCP"}
    names = list(chunks(path))
    assert names.index("iCCP") < names.index("IDAT")


@pytest.mark.parametrize("name", ["picture.png", "picture.tif"])
@pytest.mark.parametrize("display", [DISPLAY_P3, None], ids=["Display P3", "panel"])
def test_pillow_and_little_cms_show_the_same_colours_on_srgb(
    tmp_path, signal, panel, name, display
):
    cms = pytest.importorskip("PIL.ImageCms")
    image = pytest.importorskip("PIL.Image")
    display = display or panel
    # of colours that sRGB has
    within = SRGB.xyz(0.2 + 0.6 * signal)
    files.write_picture(tmp_path / name, display.signal(within), display)
    with image.open(tmp_path / name) as opened:
        profile = cms.ImageCmsProfile(io.BytesIO(opened.info["icc_profile"]))
        converted = cms.profileToProfile(opened, profile, cms.createProfile("sRGB"), 1)
    if display is DISPLAY_P3:  # whose white is sRGB's
        expected = 0.2 + 0.6 * signal
    else:
        expected = SRGB.signal(within @ _bradford(panel.white, SRGB.white).T)
    # a step of the file and one of the conversion
    assert np.abs(np.asarray(converted) - 255 * expected).max() < 2.5


def _bradford(white_from, white_to):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        colour = pytest.importorskip("colour")
        return colour.adaptation.matrix_chromatic_adaptation_VonKries(
            white_from, white_to, transform="Bradford"
        )


def test_tifffile_finds_values_and_profile(tmp_path, signal):
    tifffile = pytest.importorskip("tifffile")
    files.write_picture(tmp_path / "a.tif", signal, DISPLAY_P3, bits=16, description="a teapot")
    with tifffile.TiffFile(tmp_path / "a.tif") as opened:
        (page,) = opened.pages
        np.testing.assert_array_equal(page.asarray(), quantised(signal, 16))
        assert page.tags["InterColorProfile"].value == icc.profile(DISPLAY_P3)
        assert page.description == "a teapot"


def test_another_decoder_reads_the_jpeg_xl(tmp_path, signal):
    codecs = pytest.importorskip("imagecodecs")
    files.write_picture(tmp_path / "a.jxl", signal, REC2020_PQ, bits=16)
    decoded = codecs.jpegxl_decode((tmp_path / "a.jxl").read_bytes())
    np.testing.assert_array_equal(decoded, quantised(signal, 16))


def test_hdr_read_back_is_the_luminance_that_was_meant(tmp_path):
    """203 cd/m2 for the white, and a lamp above it, through file and EOTF."""
    colour = _colour()
    scene = np.array([[[0.5], [1.0], [3.0]]]) * LAMP
    made = shown(scene, Look(REC2020_PQ, exposure_ev=0.0), LAMP)
    for name in ("a.png", "a.jxl"):
        pictures.write(tmp_path / name, made.signal, Look(REC2020_PQ))
        pixels, _ = read(tmp_path / name)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            cd_m2 = colour.models.eotf_ST2084(pixels / 65535)
        # steps of PQ in 16 bits are .03 %
        np.testing.assert_allclose(cd_m2[0], [[101.5] * 3, [203.0] * 3, [609.0] * 3], rtol=1e-3)


def _colour():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return pytest.importorskip("colour")


@pytest.mark.parametrize("suffix", files.PICTURES)
def test_the_same_picture_is_the_same_file(tmp_path, signal, panel, suffix):
    for name in ("one", "two"):
        files.write_picture(tmp_path / f"{name}{suffix}", signal, panel, description="x")
    one, two = ((tmp_path / f"{name}{suffix}").read_bytes() for name in ("one", "two"))
    assert one == two


def test_a_caption_and_the_look_are_in_the_description(tmp_path, signal):
    pictures.write(tmp_path / "a.png", signal, Look(white="D50"), caption="a teapot")
    assert read(tmp_path / "a.png")[1]["ImageDescription"] == (
        "a teapot; sRGB, cat02 from D50, shoulder"
    )


def test_pq_takes_16_bits_and_others_8():
    assert pictures.depth(Look()) == 8
    assert pictures.depth(Look(), 16) == 16
    assert pictures.depth(Look(REC2020_PQ)) == 16
    assert pictures.depth(Look(rec2020_pq(203.0, 203.0))) == 16  # HDR without room above its white


def test_a_header_tells_the_white():
    np.testing.assert_allclose(pictures.white_of(pictures.about_white(LAMP)), LAMP, rtol=1e-8)
    for text in ("", "1 2", "white", "1 2 nan"):
        assert pictures.white_of({"white_xyz": text}) is None
    assert pictures.white_of({}) is None


# ----------------------------------------------------------------------------------- the command


def test_show_makes_the_picture_that_the_look_is(sixlight, xyz, tmp_path):
    out = tmp_path / "new" / "lit.png"
    done = sixlight("show", xyz, "-o", out, "--display", "display-p3", "--bits", 16)
    assert done.status == 0
    assert done.out.strip() == str(out)
    assert "Display P3, cat02 from the white of the scene, shoulder; exposure" in done.err
    values, _, _ = files.read_exr(xyz)
    expected = shown(values, Look(DISPLAY_P3), LAMP).signal
    np.testing.assert_array_equal(read(out)[0], quantised(expected, 16))
    assert [p.name for p in out.parent.iterdir()] == ["lit.png"]


def test_show_on_a_measured_display(sixlight, xyz, tmp_path):
    csv = screen.write(tmp_path / "panel.csv", screen.table(levels=9, mixed=0))
    words = ["--adapt", "cat16", "--white", "A", "--exposure", "-1", "--tone", "clip", "--quiet"]
    done = sixlight("show", xyz, "-o", tmp_path / "lit.tif", "--display", csv, *words)
    assert (done.status, done.err) == (0, "")
    assert read(tmp_path / "lit.tif")[1]["ICCProfile:profile_description"] == "panel"


def test_pixels_without_a_value_are_told(sixlight, tmp_path):
    values = np.full((10, 10, 3), 0.3)
    values[0] = np.nan
    files.write_exr(tmp_path / "holed.exr", values, "XYZ", {})
    words = ["--adapt", "none"]
    done = sixlight("show", tmp_path / "holed.exr", "-o", tmp_path / "a.png", *words)
    assert done.status == 0
    assert "10.00% of the pixels have no value" in done.err
    assert (read(tmp_path / "a.png")[0][0] == 0).all()


def test_show_takes_what_preview_wrote(sixlight, finished_once, tmp_path):
    source = finished_once / "preview_teapot.exr"
    done = sixlight("show", source, "-o", tmp_path / "a.jxl", "--white", "D65")
    assert done.status == 0, done.err
    size = files.read_exr(source)[0].shape
    assert read(tmp_path / "a.jxl")[0].shape == size


@pytest.mark.parametrize("shape", [(48, 8), (8, 16)], ids=["cube", "latlong"])
def test_a_map_is_shown_from_its_own_white(sixlight, tmp_path, shape):
    """Under one light from everywhere all is the display's white, but for what is unknown."""
    primaries = primary_sets.load(primary_sets.DEFAULT)
    lamp = primaries.project(sets.lights("darling2011")["A"])
    light = np.broadcast_to(lamp, (*shape, len(lamp))).copy()
    light[2, 3] = np.nan
    header = headers.of_primaries(primaries, unit="relative", quantity="light")
    files.write_exr(tmp_path / "map.exr", light, primaries.channels, header)
    words = ["--exposure", -np.log2(2 * (primaries.xyz_from_primaries @ lamp)[1])]
    done = sixlight("show", tmp_path / "map.exr", "-o", tmp_path / "map.png", *words)
    assert done.status == 0, done.err
    pixels, _ = read(tmp_path / "map.png")
    assert (pixels[2, 3] == 0).all()
    pixels[2, 3] = pixels[0, 0]
    np.testing.assert_array_equal(pixels, 188)  # .5 in sRGB, 187.5 of 255


def test_the_white_of_a_map_weighs_by_solid_angle():
    """Red above 60 degrees of latitude, white below: the cap is (1 - sin 60) / 2 of the sphere."""
    xyz = np.ones((600, 1200, 3))
    xyz[:100] = [2.0, 1.0, 0.0]
    cap = (1 - np.sin(np.radians(60))) / 2
    expected = [1 + cap, 1.0, 1 - cap]
    np.testing.assert_allclose(pictures._mean(xyz), expected, atol=1e-5)
    top = np.ones((6 * 32, 32, 3))
    top[2 * 32 : 3 * 32] = [2.0, 1.0, 0.0]  # one face, +Y, of six
    np.testing.assert_allclose(pictures._mean(top), [7 / 6, 1.0, 5 / 6])


def test_reflectance_is_no_light(sixlight, tmp_path):
    primaries = primary_sets.load(primary_sets.DEFAULT)
    header = headers.of_primaries(primaries, unit="factor", quantity="reflectance")
    path = tmp_path / "surface.exr"
    files.write_exr(path, np.ones((8, 16, len(primaries.channels))), primaries.channels, header)
    done = sixlight("show", path, "-o", tmp_path / "a.png")
    assert (done.status, "channels P1" in done.err) == (2, True)


@pytest.mark.parametrize(
    ("name", "words", "said"),
    [
        ("a.jpg", [], "a.jpg: a picture .jpg .*rename"),
        ("a", [], "without suffix"),
        ("a.tif", ["--display", "rec2020-pq"], "in TIFF"),
        ("a.png", ["--display", "rec2020-pq", "--bits", 8], "in 8 bits"),
        ("a.png", ["--bits", 12], "12 bits a channel"),
        ("a.png", ["--display", "adobe"], "'adobe'"),
        ("a.png", ["--exposure", "bright"], "'bright'"),
        ("there.png", [], "there.png: exists .*--force"),
    ],
)
def test_bad_words_write_nothing(sixlight, xyz, tmp_path, name, words, said):
    (tmp_path / "there.png").write_text("mine")
    before = sorted(tmp_path.iterdir())
    done = sixlight("show", xyz, "-o", tmp_path / name, *words)
    assert done.status == 2
    assert re.search(said, done.err), done.err
    assert len(done.err.splitlines()) == 1
    assert sorted(tmp_path.iterdir()) == before
    assert (tmp_path / "there.png").read_text() == "mine"


def test_force_replaces(sixlight, xyz, tmp_path):
    (tmp_path / "there.png").write_text("mine")
    assert sixlight("show", xyz, "-o", tmp_path / "there.png", "--force").status == 0
    assert read(tmp_path / "there.png")[0].shape == (12, 20, 3)


def test_a_file_that_is_no_xyz_is_named(sixlight, tmp_path):
    out = tmp_path / "a.png"
    files.write_exr(tmp_path / "rgb.exr", np.ones((4, 4, 3)), "RGB", {})
    assert "channels R, G, B" in sixlight("show", tmp_path / "rgb.exr", "-o", out).err
    (tmp_path / "broken.exr").write_bytes(b"v/1\x01no more")
    assert "not a readable image" in sixlight("show", tmp_path / "broken.exr", "-o", out).err
    assert "no such file" in sixlight("show", tmp_path / "none.exr", "-o", out).err
    files.write_exr(tmp_path / "bare.exr", np.ones((4, 4, 3)), "XYZ", {})
    done = sixlight("show", tmp_path / "bare.exr", "-o", out)
    assert (done.status, "--white D65" in done.err) == (2, True)
    assert not out.exists()
