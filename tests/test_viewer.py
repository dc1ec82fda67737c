"""viewer.html as it is put together; what it does in a browser is in tests/browser."""

from __future__ import annotations

import base64
import hashlib
import html.parser
import json
import re
import zlib

import lit_room
import numpy as np
import pytest

from pipeline.viewer import contents, packing, page
from stages import cube
from stages.prefilter import prefilter

NAME = "</script><img src=x onerror=alert(1)>{{numbers}} <!-- é"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A page of a map whose name is hostile."""
    measured, primaries = lit_room.measured(32)
    return page.page(NAME, lit_room.UNIT, measured, primaries)


@pytest.fixture(scope="module")
def parsed(made):
    return _Parsed(made)


class _Parsed(html.parser.HTMLParser):
    """Tags with their attributes, and the text of scripts and styles, as a browser takes them."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.texts = [], {}
        self._within = None
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        told = dict(attrs)
        self.tags.append((tag, told))
        if tag in ("script", "style"):
            self._within = told.get("id", told.get("type", tag))

    def handle_data(self, data):
        if self._within:
            self.texts[self._within] = self.texts.get(self._within, "") + data

    def handle_endtag(self, tag):
        self._within = None


def test_the_policy_lets_its_own_script_and_style_run_and_nothing_else(parsed):
    (policy,) = [t["content"] for tag, t in parsed.tags if t.get("http-equiv")]
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    for rule, part in (("script-src", "module"), ("style-src", "style")):
        digest = hashlib.sha256(parsed.texts[part].encode()).digest()
        assert rules[rule] == f"'sha256-{base64.b64encode(digest).decode()}'"
    assert rules["default-src"] == "'none'"
    assert rules["img-src"] == "data: blob:"
    assert rules["base-uri"] == rules["form-action"] == "'none'"
    assert "unsafe" not in policy


def test_it_asks_nobody_for_anything(parsed):
    for tag, told in parsed.tags:
        assert not {"src", "href", "srcset", "data", "action", "style"} & set(told), tag
        assert not [name for name in told if name.startswith("on")], tag
    assert not re.search(r"@import|url\(|https?:", parsed.texts["style"])
    asks = r"\bfetch\(|XMLHttpRequest|WebSocket|sendBeacon|\bimport\("
    makes_markup = r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\(|\bFunction\("
    assert not re.search(f"{asks}|{makes_markup}", parsed.texts["module"])


def test_a_name_never_becomes_markup(made, parsed):
    assert json.loads(parsed.texts["contents"])["name"] == NAME
    assert "<" not in parsed.texts["contents"]
    assert made.count("<img") == 0
    assert [tag for tag, _ in parsed.tags].count("script") == 3


def test_it_says_what_is_missing_without_script(made):
    sentence = re.search(r"<noscript>(.*?)</noscript>", made, re.DOTALL)[1]
    assert "JavaScript" in sentence
    script = page.joined(page.SCRIPTS)
    for word in ("WebGL 2", "half-float", "DecompressionStream"):
        assert word in script


def test_modules_are_joined_in_an_order_that_works():
    text = page.joined(page.SCRIPTS)
    assert not re.search(r"^(import|export) ", text, re.MULTILINE)
    defined = re.findall(r"^(?:async )?(?:function|class|const|let) \*?(\w+)", text, re.MULTILINE)
    assert len(defined) == len(set(defined)), "two modules have a name in common"
    with pytest.raises(AssertionError, match=r"main\.js imports"):
        page.joined(("main.js",))


def test_every_script_beside_the_page_is_in_it():
    folder = page.resources.files(page.here)
    assert {f.name for f in folder.iterdir() if f.name.endswith(".js")} == set(page.SCRIPTS)


def test_the_shaders_are_those_the_previews_use(parsed):
    import shaders

    told = json.loads(parsed.texts["contents"])["shaders"]
    assert {"ward.frag", "ward1992.frag", "ggx.frag", "surface.vert"} <= set(told)
    for file, text in told.items():
        assert text == shaders.load(file, shaders.ES_VERSION).text


def test_faces_are_told_as_cube_py_has_them(parsed):
    told = json.loads(parsed.texts["contents"])["map"]
    a, b, c = np.moveaxis(np.array(told["faces"]), 1, 0)
    u, v = 0.3, -0.6
    along = a + u * b + v * c
    expected = cube.face_directions(u, v)
    assert np.allclose(along / np.linalg.norm(along, axis=-1, keepdims=True), expected)


def test_sigma_is_told_to_an_eighth_of_a_stop_and_0_where_it_is_not_known(parsed):
    sigma = np.geomspace(1e-8, 3e-4, 50).reshape(1, 5, 5, 2)
    sigma[0, 2, 3] = np.nan
    known = np.isfinite(sigma)
    steps = contents._sigma_steps(sigma)
    told = json.loads(parsed.texts["contents"])["map"]["sigma"]["steps"]
    back = sigma[known].max() * 2.0 ** ((steps[known].astype(float) - 255) / told)
    assert np.abs(np.log2(back / sigma[known])).max() <= 1 / 8 + 1e-9
    assert not steps[~known].any()


# ----------------------------------------------------------------------------------- packing


def unpacked(pack):
    """The bytes that a page's text stands for."""
    alphabet = bytes.maketrans(b",.:/", b"<>&`")
    framed = base64.b85decode(pack.text().encode().translate(alphabet))
    length = int.from_bytes(framed[:4], "little")
    return zlib.decompress(framed[4 : 4 + length], -15)


def value(codes, bits):
    """The half floats that codes stand for, as unpack.js has them."""
    pattern = np.abs(codes).astype(np.uint16) << (10 - bits)
    return np.copysign(pattern.view(np.float16).astype(np.float64), codes)


def test_codes_are_right_to_a_thousandth_over_all_magnitudes():
    rng = np.random.default_rng(1)
    values = rng.uniform(1, 2, 100_000) * 2.0 ** rng.integers(-14, 15, 100_000)
    values *= rng.choice([-1, 1], values.shape)
    back = value(packing.code(values, 9), 9)
    assert np.abs(back / values - 1).max() <= 2.0**-10 + 2.0**-16
    assert np.array_equal(value(packing.code([65504.0, 0.0], 9), 9)[1:], [0.0])
    assert np.isfinite(value(packing.code([65504.0], 9), 9)).all()


def test_codes_are_in_the_order_of_values():
    values = np.sort(np.random.default_rng(2).standard_normal(1000))
    assert (np.diff(packing.code(values, 9)) >= 0).all()


def test_a_map_is_told_without_loss():
    """Undone here in the plainest way; unpack.js is compared by what it draws."""
    codes = packing.code(np.random.default_rng(3).standard_normal((6, 4, 4, 2)).cumsum(axis=2), 9)
    pack = packing.Pack()
    pack.cube("map", codes)
    assert pack.index == [{"name": "map", "told": "cube", "shape": [6, 4, 4, 2]}]
    raw = np.frombuffer(unpacked(pack), np.uint8).astype(np.int64)
    folded = (raw[: raw.size // 2] + 256 * raw[raw.size // 2 :]).reshape(6, 2, 4, 4)
    difference = np.where(folded % 2, -(folded + 1) // 2, folded // 2)
    back = np.zeros((6, 2, 5, 5), np.int64)
    for y in range(4):
        for x in range(4):
            a, b, c = back[..., y + 1, x], back[..., y, x + 1], back[..., y, x]
            expected = np.where(
                c >= np.maximum(a, b),
                np.minimum(a, b),
                np.where(c <= np.minimum(a, b), np.maximum(a, b), a + b - c),
            )
            back[..., y + 1, x + 1] = expected + difference[..., y, x]
    assert np.array_equal(np.moveaxis(back[..., 1:, 1:], 1, -1), codes)


def test_a_mip_is_mostly_told_by_the_one_before_it():
    measured, _ = lit_room.measured(64)
    mips = prefilter(np.nan_to_num(measured.values) / 1e-4)
    finer, coarser = (packing.code(mip, 9) for mip in mips[:2])
    sizes = []
    for told in ("cube", "mip"):
        pack = packing.Pack()
        if told == "cube":
            pack.cube("mip", coarser)
        else:
            pack.mip("mip", coarser, "finer", finer)
        sizes.append(len(pack.text()))
    assert sizes[1] < 0.8 * sizes[0]


def test_the_text_means_nothing_to_html():
    pack = packing.Pack()
    pack.bytes("all", np.random.default_rng(4).integers(0, 256, (6, 32, 32, 1)).astype(np.uint8))
    assert not set(pack.text()) & set("<>&`'\"\\\n")


def test_a_page_too_large_is_told_less_exactly(made, parsed, monkeypatch):
    measured, primaries = lit_room.measured(32)
    limit = len(made) - 5000
    monkeypatch.setattr(page, "LIMIT", limit)
    text = page.page("room", lit_room.UNIT, measured, primaries)
    assert json.loads(parsed.texts["contents"])["bits"] == 9
    assert json.loads(_Parsed(text).texts["contents"])["bits"] < 9
    assert len(text) < limit


@pytest.mark.slow
def test_a_map_of_256_texels_makes_a_page_under_four_megabytes():
    """With noise of two per cent in every texel, which nothing can predict."""
    measured, primaries = lit_room.measured(256, noise=0.02)
    assert len(page.page("room", lit_room.UNIT, measured, primaries).encode()) < 4_000_000


# ---------------------------------------------------------------------------------- the command


def test_the_command_writes_beside_the_map_and_replaces_nothing_of_others(
    sixlight, tmp_path, monkeypatch
):
    monkeypatch.setattr(page, "page", lambda name, unit, measured, primaries: f"page of {name}")
    lit_room.write(tmp_path, "room")
    assert sixlight("view", tmp_path).out.strip() == str(tmp_path / "viewer.html")
    assert (tmp_path / "viewer.html").read_text() == "page of room"
    again = sixlight("view", tmp_path)
    assert again.status == 2
    assert again.err.count("\n") == 1
    assert "viewer.html" in again.err
    assert sixlight("view", tmp_path, "--force").status == 0
    other = tmp_path / "new" / "a.html"
    assert sixlight("view", tmp_path / "cubemap.exr", "-o", other).status == 0
    assert [p.name for p in other.parent.iterdir()] == ["a.html"]


def test_envmap_writes_the_page_of_its_capture(finished_once):
    text = (finished_once / "viewer.html").read_text(encoding="utf-8")
    header = json.loads(_Parsed(text).texts["contents"])
    assert header["unit"]
    assert header["map"]["size"] <= 256
