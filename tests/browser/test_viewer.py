"""viewer.html in a browser: it draws what the previews draw, and tells what the map holds."""

from __future__ import annotations

import dataclasses
import json
from urllib.parse import parse_qsl

import cv2
import lit_room
import numpy as np
import pytest

from browser.conftest import DESKTOP, PHONE
from calibration import adaptation
from calibration.chromaticity import planckian_locus, temperature
from calibration.display import SHOULDER
from calibration.look import Look, shown
from pipeline import cli, io, previews
from pipeline.compositions import compose
from pipeline.materials import Maker
from pipeline.viewer.page import joined
from stages import cube
from stages.layouts import LATLONG
from stages.light import light as prepare
from stages.meshes import sphere
from stages.prefilter import mean
from stages.preview import Drawing, preview
from stages.scene import Camera, Scene, turned
from stages.scenes import on_stand, teapot
from stages.trichromatic import Trichromatic

NAME = 'hall <img src=x onerror="document.title=1"></script><b>bold</b> & "more"'
SMALL = {"width": 300, "height": 520}  # a small canvas: a processor draws it


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folder of a map and its page, made by the command."""
    folder = tmp_path_factory.mktemp("room")
    lit_room.write(folder, NAME)
    assert cli.status(["view", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def room(made):
    return previews.read(made)


@pytest.fixture
def viewer(made, open_page):
    """viewer(after="#...", size=SMALL, draft=False): the page, with its picture finished or not."""

    def opened(after="", size=SMALL, draft=False, **context):
        page = open_page(made / "viewer.html", size, after, **context)
        page.wait_for_selector("#picture:visible")
        if "probe=" in after:
            page.wait_for_selector("#reading:visible")
        return page if draft else finished(page)

    return opened


def finished(page):
    page.wait_for_selector("#picture[aria-busy=false]", timeout=120_000)
    return page


def saved(page):
    """The picture (H, W, 3) uint8, by the page's own button."""
    with page.expect_download() as download:
        page.click("#save")
    picture = cv2.imread(str(download.value.path()), cv2.IMREAD_COLOR)
    return picture[..., ::-1]


def state_of(page):
    """What the address says, once it says it."""
    page.wait_for_timeout(300)
    return dict(parse_qsl(page.evaluate("location.hash.slice(1)")))


# ------------------------------------------------------------------- it draws what previews draw


def reference(room, after: str, size):
    """The picture (H, W, 3) uint8 that the renderer of the previews makes of an address."""
    said = dict(parse_qsl(after.lstrip("#")))
    primaries, matrix = room.primaries, room.primaries.xyz_from_primaries
    prepared = prepare(room.light)
    white = matrix @ mean(room.light)
    scene = _scene(room, said, size[0] / size[1])
    if said.get("compare") == "three":
        three = Trichromatic.named("sharp", primaries)
        prepared, matrix, scene = (
            _in_three(prepared, three),
            three.xyz_from_channels,
            three.scene(scene),
        )
    samples = said.get("samples")
    xyz = preview(
        prepared, matrix, scene, Drawing(size[0], size[1], samples=samples and int(samples))
    )
    return _displayed(xyz, said, white)


def _displayed(xyz, said, white):
    named = said.get("white", "map")
    look = Look(
        adaptation=None if said.get("adapt") == "none" else said.get("adapt", "cat02"),
        degree=float(said.get("degree", 1)),
        white=None if named == "map" else named,
        exposure_ev=float(np.log2(SHOULDER / (0.65 * white[1]))) + float(said.get("ev", 0)),
        tone=said.get("tone", "shoulder"),
    )
    return np.round(255 * shown(xyz, look, white).signal).astype(np.uint8)


def _in_three(prepared, three):
    """Light prepared in the primaries, each part of it in three channels."""

    def part(whole):
        return dataclasses.replace(
            whole, mips=tuple(three.light(mip) for mip in whole.mips), flux=three.light(whole.flux)
        )

    matt = dataclasses.replace(
        prepared.matt,
        irradiance=three.light(prepared.matt.irradiance),
        flux=three.light(prepared.matt.flux),
    )
    forms = {name: part(getattr(prepared, name)) for name in ("whole", "narrow", "broad")}
    return dataclasses.replace(prepared, **forms, matt=matt)


def _scene(room, said, aspect) -> Scene:
    """The scene of an address, built from what the previews are built of."""
    maker = Maker(room.primaries)
    alpha = float(said.get("rough", 0.05))
    body = {
        "0": lambda: maker.patch("15", roughness=alpha),
        "7": lambda: maker.metal("nickel", roughness=alpha),
        "9": lambda: maker.grey(0.0, gloss=1.0, roughness=alpha),
    }[said.get("material", "0")]()
    stand = maker.patch("21", roughness=0.12)
    model = said.get("model", "teapot")
    widest = 1.0
    if model == "teapot":
        scene = teapot(body, stand)
    elif model == "sphere":
        scene, _ = on_stand(sphere(radius=0.1, segments=64), body, stand)
    else:
        composed = compose(model, room.light, room.primaries)
        scene, widest = composed.scene, composed.aspect
        if model == "colorchecker":
            things = tuple((m, dataclasses.replace(b, roughness=alpha)) for m, b in scene.things)
            scene = dataclasses.replace(scene, things=things)
    brdf = said.get("lobe", "ward")
    things = tuple((mesh, dataclasses.replace(b, brdf=brdf)) for mesh, b in scene.things)
    eye, target = np.array(scene.camera.eye), np.array(scene.camera.target)
    distance = np.linalg.norm(eye - target)
    first = np.degrees(np.arcsin((eye - target)[1] / distance))
    yaw, pitch = np.radians([float(said.get("yaw", 0)), float(said.get("pitch", round(first, 1)))])
    toward = np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
    slope = np.tan(np.radians(scene.camera.vertical_view_deg) / 2) * max(1.0, widest / aspect)
    camera = Camera(
        tuple(target + distance / float(said.get("zoom", 1)) * toward),
        tuple(target),
        float(np.degrees(2 * np.arctan(slope))),
    )
    blur = float(said.get("blur", scene.background_level))
    return turned(Scene(things, camera, blur), -float(said.get("turn", 0)))


STATES = {
    "teapot": "#compare=six",
    "teapot in three": "#compare=three&yaw=-35&turn=120",
    "nickel sphere, GGX": "#compare=six&model=sphere&material=7&rough=0.2&lobe=ggx&turn=40&yaw=30"
    "&zoom=1.3&pitch=5&blur=0",
    "mirror": "#compare=six&material=9&rough=0.02&samples=64&adapt=none&tone=clip&turn=290",
    "chart in three": "#compare=three&model=colorchecker&rough=0.1&pitch=0&blur=2&ev=1&adapt=cat16"
    "&degree=0.6&white=A&lobe=ward1992",
}


@pytest.mark.parametrize("which", STATES)
def test_the_picture_is_the_one_the_previews_render(viewer, room, which):
    """Half floats, another compiler and another precision of cosines: one 8-bit step."""
    page = viewer(STATES[which])
    picture = saved(page)
    expected = reference(room, STATES[which], picture.shape[1::-1])
    off = np.abs(picture.astype(int) - expected).max(axis=-1)
    assert np.std(expected) > 10  # there is something to compare
    assert np.mean(off <= 1) >= 0.999, (np.mean(off <= 1), off.max())


@pytest.mark.parametrize("primaries", ["signed5", "signed8"])
def test_other_numbers_of_channels_draw_as_well(open_page, tmp_path, primaries):
    lit_room.write(tmp_path, "room", primaries)
    assert cli.status(["view", str(tmp_path)]) == 0
    after = "#compare=six&turn=200&samples=16"
    page = finished(open_page(tmp_path / "viewer.html", SMALL, after + "&probe=0.5,0.5"))
    count = int(primaries[-1])
    assert page.locator("#values tbody tr").count() == count
    assert f"{count} channels" in page.inner_text("#tag-six")
    picture = saved(page)
    expected = reference(previews.read(tmp_path), after, picture.shape[1::-1])
    off = np.abs(picture.astype(int) - expected).max(axis=-1)
    assert np.mean(off <= 1) >= 0.999, (np.mean(off <= 1), off.max())


def test_the_unwrapped_map_is_the_map_as_latlong(viewer, room):
    page = viewer("#view=map&compare=six&turn=30&adapt=none")
    picture = saved(page)
    height, width = picture.shape[:2]
    rows = slice((height - width // 2 + 1) // 2 + 1, (height + width // 2) // 2 - 1)
    v, u = np.mgrid[rows, 0:width] + 0.5
    v = (v - (height - width / 2) / 2) / (width / 2)
    directions = LATLONG.direction(0, u / width, v)
    angle = np.radians(-30.0)  # what was at +Z is 30 degrees nearer to +X: look for it back there
    cos, sin = np.cos(angle), np.sin(angle)
    back = directions @ np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]]).T
    light = cube.sample(room.light, back)
    matrix = room.primaries.xyz_from_primaries
    expected = _displayed(light @ matrix.T, {"adapt": "none"}, matrix @ mean(room.light))
    off = np.abs(picture[rows].astype(int) - expected).max(axis=-1)
    # The page looks up coarser texels where the map has more of them than the picture has pixels.
    assert np.mean(off <= 12) > 0.97, np.percentile(off, [50, 90, 97, 99])


def test_the_divider_parts_the_two_pictures(viewer):
    split = saved(viewer("#divider=0.4"))
    six, three = saved(viewer("#compare=six")), saved(viewer("#compare=three"))
    edge = round(0.4 * split.shape[1])
    assert np.array_equal(split[:, :edge], six[:, :edge])
    assert np.array_equal(split[:, edge:], three[:, edge:])
    assert np.abs(six.astype(int) - three).max() > 3


# ---------------------------------------------------------------------------------------- the probe


def read(page):
    """XYZ and the six values that the reading shows, in full."""
    told = page.evaluate("({...document.getElementById('reading').dataset})")
    return np.array(told["xyz"].split(), float), np.array(told["values"].split(), float), told


def texel_at(direction, size):
    face, u, v = cube.face_positions(direction)
    column, row = (int((p + 1) / 2 * size) for p in (u, v))
    return int(face), row, column


@pytest.mark.parametrize("at", [(0.217, 0.517), (0.412, 0.373), (0.634, 0.602), (0.903, 0.451)])
def test_a_direction_of_the_map_reads_as_in_the_file(viewer, made, room, at):
    page = viewer(f"#view=map&probe={at[0]},{at[1]}", draft=True)
    xyz, values, told = read(page)
    size = page.evaluate("[picture.width, picture.height]")
    high = size[0] / 2 / size[1]
    direction = LATLONG.direction(0, at[0], (at[1] - (1 - high) / 2) / high)
    measured, _ = io.read_measured(made / "cubemap.exr", cube=True)
    texel = texel_at(direction, measured.values.shape[1])
    expected = room.primaries.xyz_from_primaries @ measured.values[texel]
    assert np.allclose(xyz, expected, rtol=1e-3, atol=0)
    assert np.allclose(values, measured.values[texel], rtol=1e-3, atol=0)
    warm = temperature(expected)
    assert warm is not None
    assert float(told["cct"]) == pytest.approx(warm.kelvin, rel=3e-3)
    said = [float(word) for word in page.inner_text("#colour dd >> nth=1").split(", ")]
    assert said == pytest.approx(expected[:2] / expected.sum(), abs=2e-4)
    spread = page.locator("#values td:nth-child(3)").all_inner_texts()
    sigma = np.array([words.removeprefix("± ") for words in spread], float)
    known = np.sqrt(measured.variance[texel])
    assert np.allclose(sigma / sigma[0], known / known[0], rtol=0.25)
    assert "All of this texel was measured" in page.inner_text("#reading")
    assert "(one standard deviation)" in page.inner_text("#reading")


def test_temperatures_are_those_of_python(open_page, tmp_path):
    """colour.js and calibration/chromaticity.py, also past the ends of the locus."""
    places = np.random.default_rng(1).uniform([0.2, 0.2], [0.6, 0.5], (300, 2))
    file = tmp_path / "page.html"
    file.write_text(
        '<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,">'
        f'<script type="module">{joined(("colour.js",))}\n'
        "window.temperature = temperature;</script>"
    )
    page = open_page(file)
    page.wait_for_function("window.temperature !== undefined")
    found = page.evaluate(
        "([places, locus]) => places.map((xy) => temperature(xy, locus))",
        [places.tolist(), planckian_locus().tolist()],
    )
    known = [temperature([x / y, 1.0, (1.0 - x - y) / y]) for x, y in places]
    assert [t is None for t in found] == [t is None for t in known]
    for told, t in zip(found, known, strict=True):
        if t is not None:
            assert told["kelvin"] == pytest.approx(t.kelvin, rel=3e-3)
            assert told["duv"] == pytest.approx(t.duv, abs=1e-4)


def test_what_was_not_measured_is_said_to_be_filled(viewer):
    page = viewer("#view=map&probe=0.5,0.5", draft=True)  # the middle is -Z, where the hole is
    assert "Not measured" in page.inner_text("#reading-trust")
    assert page.locator("#values td:nth-child(3)").all_inner_texts() == ["\u2013"] * 6


def test_a_direction_beside_the_model_reads_the_map_there(viewer, room):
    page = viewer("#probe=0.08,0.06&turn=70&compare=six", draft=True)
    xyz, _, _ = read(page)
    size = page.evaluate("[picture.width, picture.height]")
    camera = _scene(room, {"turn": "70"}, size[0] / size[1]).camera
    forward = np.subtract(camera.target, camera.eye)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 1, 0])
    right /= np.linalg.norm(right)
    half = np.tan(np.radians(camera.vertical_view_deg) / 2)
    place = (np.floor(np.array([0.08, 0.06]) * size) + 0.5) / size
    x, y = (2 * place[0] - 1) * half * size[0] / size[1], (1 - 2 * place[1]) * half
    direction = forward + x * right + y * np.cross(right, forward)
    expected = room.primaries.xyz_from_primaries @ room.light[texel_at(direction, lit_room.SIZE)]
    assert np.allclose(xyz, expected, rtol=1e-3, atol=0)


def test_a_spot_of_the_model_reads_as_rendered(viewer, room):
    """The stand in front, where nothing changes from pixel to pixel."""
    page = viewer("#probe=0.5,0.78&compare=six", draft=True)
    xyz, values, _ = read(page)
    width, height = page.evaluate("[picture.width, picture.height]")
    scene = _scene(room, {}, width / height)
    matrix = room.primaries.xyz_from_primaries
    rendered = preview(room.light, matrix, scene, Drawing(width, height))
    pixel = rendered[int(0.78 * height), int(0.5 * width)]
    assert page.inner_text("#reading-title") == "Surface"
    assert np.allclose(xyz, pixel, rtol=0.01)
    assert np.allclose(matrix @ values, xyz, rtol=1e-5)
    assert "XYZ by three" in page.inner_text("#colour")


# ---------------------------------------------------------------------------------- it is operated

CHANGES = {
    "model": "sphere",
    "material": "3",
    "lobe": "ggx",
    "samples": "16",
    "adapt": "none",
    "white": "A",
}
SLIDES = {"rough": 0.9, "turn": 0.3, "blur": 0.9, "ev": 0.7, "degree": 0.2}


def canvas(page):
    return page.locator("#picture").screenshot()


def test_every_control_changes_the_picture(viewer):
    page = viewer()
    form = page.locator("#controls")
    names = form.evaluate("form => [...new Set([...form.elements].map(e => e.name))]")
    tried = {""}
    for name, value in CHANGES.items():
        before = canvas(page)
        page.select_option(f"[name={name}]", value)
        finished(page)
        assert canvas(page) != before, name
        assert state_of(page)[name] == value
        tried.add(name)
        if name == "adapt":
            assert page.is_disabled("[name=white]")
            page.select_option("[name=adapt]", "cat02")
    for name, share in SLIDES.items():
        before, slider = canvas(page), page.locator(f"[name={name}]")
        slider.evaluate(
            "(e, s) => { e.value = Number(e.min) + s * (e.max - e.min);"
            " e.dispatchEvent(new Event('input', { bubbles: true })); }",
            share,
        )
        finished(page)
        assert canvas(page) != before, name
        assert name in state_of(page)
        tried.add(name)
    for name, value in (("tone", "clip"), ("compare", "three"), ("view", "map")):
        before = canvas(page)
        page.check(f"[name={name}][value={value}]", force=True)
        finished(page)
        assert canvas(page) != before, name
        tried.add(name)
    assert set(names) <= tried
    page.click("#reset")
    finished(page)
    assert state_of(page) == {}


def test_pointers_orbit_zoom_turn_the_light_part_the_picture_and_read(viewer):
    page = viewer(draft=True)
    box = page.locator("#picture").bounding_box()
    x, y = box["x"] + box["width"] / 4, box["y"] + box["height"] / 3

    def drag(dx, dy):
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + dx, y + dy, steps=4)
        page.mouse.up()

    drag(40, 20)
    said = state_of(page)
    assert {"yaw", "pitch"} <= set(said)
    assert "probe" not in said
    page.keyboard.down("Shift")
    drag(30, 0)
    page.keyboard.up("Shift")
    assert "turn" in state_of(page)
    page.mouse.wheel(0, -200)
    assert float(state_of(page)["zoom"]) > 1
    handle = page.locator("#divider").bounding_box()
    page.mouse.move(handle["x"] + handle["width"] / 2, y)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.75 * box["width"], y, steps=4)
    page.mouse.up()
    assert float(state_of(page)["divider"]) == pytest.approx(0.75, abs=0.02)
    page.mouse.click(x, y)
    page.wait_for_selector("#reading:not([hidden])")
    assert page.locator("#plot path").count() == 2
    page.click("#reading-close")
    assert page.is_hidden("#reading")


def test_two_fingers_zoom(viewer):
    page = viewer(draft=True, has_touch=True)
    for distance in (40, 80):
        page.evaluate(
            """d => { for (const [id, x] of [[11, -d], [12, d]]) {
                const all = { pointerId: id, pointerType: "touch", bubbles: true,
                    clientX: 150 + x, clientY: 150, buttons: 1 };
                picture.setPointerCapture = () => {};
                const kind = d === 40 ? "pointerdown" : "pointermove";
                picture.dispatchEvent(new PointerEvent(kind, all));
            } }""",
            distance,
        )
    assert float(state_of(page)["zoom"]) == pytest.approx(2.0, rel=0.01)


def test_the_keyboard_alone_is_enough(viewer):
    page = viewer(draft=True)
    reached = []
    for _ in range(40):
        page.keyboard.press("Tab")
        name = page.evaluate(
            "(e => e.id || e.name || e.textContent.trim())(document.activeElement)"
        )
        if name in reached:
            break
        reached.append(name)
        if name == "picture":
            for key in ("ArrowLeft", "ArrowUp", "+", "]", "p", "Shift+ArrowRight"):
                page.keyboard.press(key)
            said = state_of(page)
            assert {"yaw", "pitch", "zoom", "turn", "probe"} <= set(said)
            assert said["probe"] == "0.5200,0.5000"
            page.keyboard.press("Escape")
            assert "probe" not in state_of(page)
        if name == "divider":
            page.keyboard.press("ArrowRight")
            assert float(state_of(page)["divider"]) == pytest.approx(0.52)
    wanted = {"save", "theme", "picture", "divider", "model", "material", "ev", "tone", "view"}
    assert wanted <= set(reached)


def test_a_deep_link_brings_the_same_picture_back(viewer):
    first = viewer(draft=True)
    first.select_option("[name=model]", "sphere")
    first.focus("#picture")
    for key in ("ArrowLeft", "ArrowUp", "]", "p"):
        first.keyboard.press(key)
    finished(first)
    state_of(first)
    again = viewer(first.evaluate("location.hash"))
    off = np.abs(saved(first).astype(int) - saved(again)).max(axis=-1)  # drawn in other parts
    assert np.mean(off <= 1) >= 0.999
    assert np.array_equal(read(first)[0], read(again)[0])


def test_nonsense_in_a_link_is_passed_over(made, open_page):
    words = "#model=__proto__&zoom=NaN&ev=1e9&probe=7,x&nobody=1&rough=&material=99"
    words += "&__proto__=1&toString=2"
    page = open_page(made / "viewer.html", SMALL, words)
    page.wait_for_selector("#picture:visible")
    assert page.input_value("[name=model]") == "teapot"
    assert float(page.input_value("[name=ev]")) == 8
    assert page.is_hidden("#reading")


def test_the_metamers_match_on_one_side_and_part_on_the_other(viewer):
    page = viewer(draft=True)
    page.select_option("[name=model]", "metamers")
    said = page.inner_text("#apart")
    match, part = page.locator("#sides button").all()
    part.click()
    assert page.inner_text("#apart") != said
    assert part.get_attribute("aria-pressed") == "true"
    match.click()
    assert page.inner_text("#apart") == said


# ------------------------------------------------------------------------------ it is well-behaved


def test_a_name_stays_text(viewer):
    page = viewer(draft=True)
    assert page.inner_text("h1") == NAME
    assert NAME in page.title()
    assert page.locator("img, b").count() == 0


def test_only_its_own_script_runs(viewer, open_page):
    open_page.expected("Content Security Policy")
    page = viewer(draft=True)
    ran = page.evaluate(
        """() => { const script = document.createElement("script");
            script.textContent = "window.ran = true"; document.body.append(script);
            return Boolean(window.ran); }"""
    )
    assert not ran


@pytest.fixture
def refused(made, open_page):
    """refused(script): the sentence of a page whose browser lacks something."""

    def told(script):
        page = open_page(made / "viewer.html", SMALL, before=script)
        page.wait_for_selector("#sorry:not([hidden])")
        assert page.is_hidden("#stage")
        return page.inner_text("#sorry")

    return told


def test_without_webgl_2_it_says_so(refused):
    assert "WebGL 2" in refused("HTMLCanvasElement.prototype.getContext = () => null;")


def test_without_half_float_targets_it_says_so(refused):
    assert "half-float" in refused("WebGL2RenderingContext.prototype.getExtension = () => null;")


def test_without_decompression_it_says_so(refused):
    assert "DecompressionStream" in refused("delete globalThis.DecompressionStream;")


def test_nothing_is_wider_than_a_phone(viewer):
    page = viewer("#probe=0.5,0.78", size=PHONE, draft=True)
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]


def test_the_page_goes_light_and_dark(viewer):
    page = viewer(draft=True, color_scheme="dark")
    shade = "getComputedStyle(document.body).backgroundColor"
    dark = page.evaluate(shade)
    page.click("#theme")
    assert page.evaluate(shade) != dark
    page.emulate_media(color_scheme="light")
    assert page.evaluate("document.documentElement.dataset.theme") == "light"


@pytest.mark.parametrize(("name", "size"), [("desktop", DESKTOP), ("phone", PHONE)])
def test_pictures_to_look_at(viewer, picture, name, size):
    page = viewer("#probe=0.5,0.78", size=size)
    picture(page, f"viewer_{name}_light")
    page.click("#theme")
    picture(page, f"viewer_{name}_dark")
    if name == "phone":
        page.evaluate("scrollTo(0, 1e6)")
        picture(page, "viewer_phone_settings")


def test_the_contents_are_what_the_page_needs(made):
    """Every number of the page can be read by others too."""
    text = (made / "viewer.html").read_text(encoding="utf-8")
    told = json.loads(text.split('id="contents">')[1].split("</script>")[0])
    assert told["name"] == NAME
    assert set(adaptation.METHODS) == set(told["look"]["adaptation"])
