"""Scene files and materials against what is written in them, and what is wrong with them."""

import re
from pathlib import Path

import numpy as np
import pytest

from calibration import metals, primaries, sets
from calibration.errors import InputError
from calibration.spectra import WAVELENGTHS, Spectra, write_spectra
from pipeline import io
from pipeline.files import header as headers
from pipeline.files import scenes
from stages.types import Measured

SET = primaries.load("darling2011")
DOCS = Path(__file__).parent.parent / "docs" / "scenes.md"
ONE = '[[thing]]\nmesh = "sphere"\nmaterial = {{ {} }}\n'


def read(folder, text):
    path = folder / "scene.toml"
    path.write_text(text)
    return scenes.read(path, SET)


def material(folder, words):
    return read(folder, ONE.format(words)).scene.things[0][1]


def refused(folder, text):
    with pytest.raises(InputError) as caught:
        read(folder, text)
    lines = str(caught.value).splitlines()
    assert all("scene.toml" in line for line in lines)
    return lines


def texture(path, values, *, quantity="reflectance", of=SET):
    values = np.asarray(values, np.float32)
    valid = np.isfinite(values).all(axis=-1).astype(np.float32)
    about = headers.of_primaries(of, unit="reflectance factor", quantity=quantity)
    io.write_measured(path, Measured(values, np.zeros_like(values), valid), of.channels, about)


def test_the_documented_example_is_read(tmp_path):
    (example,) = re.findall(r"```toml\n(.*?)```", DOCS.read_text(), re.S)
    made = read(tmp_path, example)
    assert (made.turn_deg, made.aspect, made.scene.background_level) == (20.0, 1.5, 2.0)
    assert made.scene.camera.eye == (0.0, 0.35, 0.9)
    (pot, enamel), (ball, steel), (plane, _) = made.scene.things
    np.testing.assert_allclose(enamel.diffuse, SET.project(sets.surfaces("colorchecker24")["13"]))
    assert enamel.roughness == 0.06
    assert (steel.roughness, steel.brdf) == ((0.05, 0.25), "ggx")
    assert plane.tangents is not None
    # half of .1 m radius, standing on the plane at (.17, .05)
    middle = (ball.positions.min(axis=0) + ball.positions.max(axis=0)) / 2
    np.testing.assert_allclose(middle, [0.17, 0.05, 0.05], atol=1e-4)
    # the spout points to +X, turned by -25 degrees from +Z towards +X: to +Z
    tip = pot.positions[pot.positions[:, 0].argmax()]
    assert tip[2] > 0.04


def test_glass_reflects_four_percent_head_on_and_all_at_grazing(tmp_path):
    gloss = material(tmp_path, "diffuse = 0.2, index = 1.5").specular
    np.testing.assert_allclose(gloss[0], ((1.5 - 1) / (1.5 + 1)) ** 2)
    np.testing.assert_allclose(gloss[-1], 1.0)
    assert (np.ptp(gloss, axis=1) < 1e-12).all()  # colourless
    # at 60 degrees, by hand: sin t = sin 60 / 1.5; r_s = -.4204, r_p = -.0424
    middle = (len(gloss) - 1) // 2
    np.testing.assert_allclose(gloss[middle], (0.4204**2 + 0.0424**2) / 2, atol=2e-4)


def test_a_metal_has_no_body_and_its_own_reflectance(tmp_path):
    silver = material(tmp_path, 'metal = "silver", roughness = 0.2')
    assert not silver.diffuse.any()
    expected = SET.project(metals.reflectance("silver", [0.0]))[0]
    np.testing.assert_allclose(silver.specular[0], expected)
    rows = "".join(f"{w:g},1.5,0\n" for w in WAVELENGTHS)
    (tmp_path / "glass.csv").write_text("wavelength_nm,n,k\n" + rows)
    glass = material(tmp_path, 'metal = "glass.csv"').specular
    np.testing.assert_allclose(glass[0], 0.04, rtol=1e-6)


def test_a_spectrum_may_be_a_column_of_a_file(tmp_path):
    curves = np.stack([np.linspace(0.1, 0.6, 36), np.linspace(0.8, 0.2, 36)], axis=1)
    write_spectra(tmp_path / "paints.csv", Spectra(WAVELENGTHS, ("ochre", "smalt"), curves))
    smalt = material(tmp_path, 'diffuse = "paints.csv:smalt"')
    np.testing.assert_allclose(smalt.diffuse, SET.project(curves[:, 1]))
    (line,) = refused(tmp_path, ONE.format('diffuse = "paints.csv"'))
    assert "ochre, smalt" in line


def test_a_texture_is_laid_on_and_its_holes_are_closed(tmp_path):
    values = np.full((2, 3, 6), 0.25)
    values[0, 0] = np.nan
    texture(tmp_path / "card.exr", values)
    text = ONE.format('diffuse = "card.exr"').replace("sphere", "plane")
    made = read(tmp_path, text)
    np.testing.assert_allclose(made.scene.things[0][1].image, 0.25)
    np.testing.assert_allclose(made.scene.things[0][1].diffuse, 0.25)
    assert any("not known" in note for note in made.notes)
    (line,) = refused(tmp_path, ONE.format('diffuse = "card.exr"').replace("sphere", "teapot"))
    assert "without uv" in line


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"quantity": "light"}, "quantity 'light'"),
        ({"of": primaries.load("signed6")}, "primaries 'signed6'"),
    ],
)
def test_a_texture_of_something_else_is_refused(tmp_path, change, says):
    texture(tmp_path / "card.exr", np.full((2, 2, 6), 0.25), **change)
    (line,) = refused(tmp_path, ONE.format('diffuse = "card.exr"').replace("sphere", "plane"))
    assert says in line


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("diffuse = 0.7, specular = 0.5", "returns 1.20 of the light"),
        ("diffuse = 1.2", "a reflectance from 0 to 1"),
        ("diffuse = 0.5, roughness = 0", "alpha above 0 and at most 1"),
        ("diffuse = 0.5, roughness = 1.5", "alpha above 0 and at most 1"),
        ("diffuse = 0.5, roughness = [0.1, 0.2, 0.3]", "or two of them"),
        ("diffuse = 0.5, brdf = 'phong'", "ward, ward1992, ggx"),
        ("diffuse = 0.5, index = 1.5, specular = 0.1", "one kind of gloss"),
        ("diffuse = 'colorchecker24:25'", "no spectrum '25'"),
        ("diffuse = 'nothing.csv'", "no such file"),
        ("diffuse = '../nothing.csv'", "outside the scene's folder"),
        ("diffuse = 'blue'", "a patch of"),
        ("metal = 'unobtainium'", "stainless steel"),
        ("roughness = 0.1", "a reflectance, or metal"),
        ("diffuse = 0.5, shiny = true", "not known here"),
    ],
)
def test_a_wrong_material_says_so_in_a_line(tmp_path, words, says):
    (line,) = refused(tmp_path, ONE.format(words))
    assert says in line


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "[[thing]]"),
        ('[[thing]]\nmesh = "cow"\nmaterial = { diffuse = 0.5 }\n', "sphere, teapot, plane"),
        ('[[thing]]\nmesh = "cow.obj"\nmaterial = { diffuse = 0.5 }\n', "no such file"),
        ('[[thing]]\nmesh = "sphere"\nmaterial = "gold"\n', "gold"),
        ('[[thing]]\nmesh = "sphere"\n', "material is missing"),
        (ONE.format("diffuse = 0.5") + "at = [0, 1]\n", "[x, y, z] in metres"),
        (ONE.format("diffuse = 0.5") + "[camera]\neye = [0, 1, 0]\n", "straight up or down"),
        (ONE.format("diffuse = 0.5") + "[lamp]\n", "not known here"),
        ("[[thing]\n", "not TOML"),
    ],
)
def test_a_wrong_scene_says_so_in_a_line(tmp_path, text, says):
    (line,) = refused(tmp_path, text.replace("{{", "{").replace("}}", "}"))
    assert says in line


def test_two_roughnesses_need_a_mesh_with_a_direction(tmp_path):
    words = ONE.format("diffuse = 0.5, roughness = [0.1, 0.2]")
    assert read(tmp_path, words).scene.things[0][1].roughness == (0.1, 0.2)
    (line,) = refused(tmp_path, words.replace("sphere", "teapot"))
    assert "without uv" in line


def test_everything_wrong_is_said_at_once(tmp_path):
    wrong = ONE.format("diffuse = 2.0") + ONE.format("diffuse = 0.5, roughness = 0")
    assert len(refused(tmp_path, wrong + "[camera]\nview_deg = 500\n")) == 3
