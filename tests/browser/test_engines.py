"""What three.js shows of files that `sixlight convert` writes, and what ktx-parse reads of them.

Both come from the npm registry: `make test-browser` installs them in build/browser, or NODE_MODULES
names a folder that has them.
"""

from __future__ import annotations

import base64
import json
import os
from pathlib import Path

import numpy as np
import pytest
from seen_from_inside import VIEWS, colours, directions

from pipeline import io
from pipeline.files import ktx2
from stages import cube
from stages.prefilter import prefilter

MODULES = Path(
    os.environ.get("NODE_MODULES", Path(__file__).parents[2] / "build" / "browser" / "node_modules")
)
FILES = {  # as pages import them
    "three": "three/build/three.module.js",
    "three-core": "three/build/three.core.js",
    "hdr-loader": "three/examples/jsm/loaders/HDRLoader.js",
    "ktx-parse": "ktx-parse/dist/index.mjs",
}
SIZE = 24

# Renders of a scene with a half-float target: linear numbers, not a screen's.
SCENE = """
import * as THREE from "three";
export const renderer = new THREE.WebGLRenderer();
export const scene = new THREE.Scene();
export const target = new THREE.WebGLRenderTarget(SIZE, SIZE, { type: THREE.FloatType });
export function render(camera) {
  renderer.setRenderTarget(target);
  renderer.render(scene, camera);
  const pixels = new Float32Array(4 * SIZE * SIZE);
  renderer.readRenderTargetPixels(target, 0, 0, SIZE, SIZE, pixels);
  return Array.from(pixels);
}
export function look(towards, up) {
  const camera = new THREE.PerspectiveCamera(90, 1, 0.01, 100);
  camera.up.set(...up);
  camera.lookAt(...towards);
  return render(camera);
}
export function bytes(text) {
  return Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
}
"""


@pytest.fixture
def run(open_page, tmp_path):
    """run(script, **data): what a module's `result` is; data are its constants."""
    missing = [name for name in FILES.values() if not (MODULES / name).is_file()]
    if missing:
        pytest.skip(f"no {missing[0]} in {MODULES}; make test-browser installs it")

    def run(script: str, **data):
        sources = {name: (MODULES / file).read_text() for name, file in FILES.items()}
        sources["scene"] = SCENE.replace("SIZE", str(SIZE))
        imports = {
            name: "data:text/javascript;base64," + base64.b64encode(_bare(text).encode()).decode()
            for name, text in sources.items()
        }
        constants = "".join(
            f"const {name} = {json.dumps(value)};\n" for name, value in data.items()
        )
        page_file = tmp_path / "page.html"
        page_file.write_text(
            '<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,">'
            f'<script type="importmap">{json.dumps({"imports": imports})}</script>'
            f'<script type="module">{constants}{script}\nwindow.result = result;</script>'
        )
        page = open_page(page_file)
        page.wait_for_function("window.result !== undefined", timeout=60_000)
        return page.evaluate("window.result")

    return run


def _bare(text: str) -> str:
    """A module of data has no place that ./ could start from."""
    return text.replace("'./three.core.js'", "'three-core'")


@pytest.fixture
def rgb(tmp_path):
    path, n = tmp_path / "rgb.exr", 32
    io.write_exr(path, colours(cube.directions(n)).reshape(6 * n, n, 3), "RGB", {})
    return path


def encoded(path: Path) -> str:
    return base64.b64encode(path.read_bytes()).decode()


def picture(pixels):
    """What readRenderTargetPixels gives, row 0 at the top."""
    return np.array(pixels).reshape(SIZE, SIZE, 4)[::-1, :, :3]


READ_HDR = """
import * as THREE from "three";
import { HDRLoader } from "hdr-loader";
import { scene, look, render, bytes } from "scene";
const read = new HDRLoader().setDataType(THREE.FloatType).parse(bytes(file));
const map = new THREE.DataTexture(read.data, read.width, read.height, THREE.RGBAFormat, read.type);
map.mapping = THREE.EquirectangularReflectionMapping;
// as DataTextureLoader has it
map.flipY = true; map.minFilter = map.magFilter = THREE.LinearFilter; map.needsUpdate = true;
"""


def test_threejs_shows_the_world_as_it_is(sixlight, tmp_path, rgb, run):
    out = tmp_path / "three.hdr"
    assert sixlight("convert", rgb, out, "--preset", "threejs", "--size", 128).status == 0
    script = READ_HDR + "scene.background = map; const result = views.map((v) => look(...v));"
    pictures = run(script, file=encoded(out), views=VIEWS)
    for pixels, view in zip(pictures, VIEWS, strict=True):
        # RGBE's steps of 1/128, and three.js's cube of half the map's height
        np.testing.assert_allclose(picture(pixels), colours(directions(*view, SIZE)), atol=0.06)


def test_a_mirror_ball_in_threejs_shows_what_it_faces(sixlight, tmp_path, rgb, run):
    out = tmp_path / "three.hdr"
    assert sixlight("convert", rgb, out, "--preset", "threejs", "--size", 128).status == 0
    script = (
        READ_HDR
        + """
    const material = new THREE.MeshBasicMaterial({ envMap: map });
    scene.add(new THREE.Mesh(new THREE.SphereGeometry(1, 256, 128), material));
    const camera = new THREE.OrthographicCamera(-1, 1, 1, -1, 0.1, 10);
    camera.position.set(0, 0, 5);
    const result = render(camera);
    """
    )
    t = (np.arange(SIZE) + 0.5) * 2 / SIZE - 1
    x, y = np.meshgrid(t, -t)
    r2 = x * x + y * y
    inner = r2 < 0.8
    z = np.sqrt(np.where(inner, 1 - r2, 0.0))
    # A ray along -Z that comes back from the normal (x, y, z).
    reflected = np.stack([2 * z * x, 2 * z * y, 2 * z * z - 1], axis=-1)
    shown = picture(run(script, file=encoded(out)))
    np.testing.assert_allclose(shown[inner], colours(reflected)[inner], atol=0.08)


@pytest.fixture
def texture(tmp_path):
    """A KTX2 cube, and its levels (6, n, n, 3)."""
    levels = prefilter(colours(cube.directions(16)))
    path = tmp_path / "cube.ktx2"
    ktx2.write(path, levels, {"scale": "4"})
    return path, levels


READ_KTX2 = """
import * as THREE from "three";
import { read } from "ktx-parse";
import { scene, look, bytes } from "scene";
const container = read(new Uint8Array(bytes(file)));
"""


def test_ktx_parse_reads_faces_and_mips(texture, run):
    path, levels = texture
    script = """
    const text = (data) => btoa(Array.from(data, (b) => String.fromCharCode(b)).join(""));
    const result = {
      format: container.vkFormat, faces: container.faceCount, width: container.pixelWidth,
      levels: container.levels.map((level) => text(level.levelData)),
      scale: new TextDecoder().decode(container.keyValue["sixlight:scale"]),
      facing: container.keyValue["KTXorientation"],
      transfer: container.dataFormatDescriptor[0].transferFunction,
    };
    """
    result = run(READ_KTX2 + script, file=encoded(path))
    assert (result["format"], result["faces"], result["width"]) == (97, 6, 16)
    assert (result["scale"], result["facing"], result["transfer"]) == ("4\0", "rd", 1)
    assert len(result["levels"]) == len(levels)
    for data, level in zip(result["levels"], levels, strict=True):
        n = level.shape[1]
        read = np.frombuffer(base64.b64decode(data), "<f2").reshape(6, n, n, 4)
        np.testing.assert_array_equal(read[..., :3], level.astype(np.float16))
        assert (read[..., 3] == 1).all()


@pytest.mark.parametrize("level", [0, 2])
def test_threejs_shows_a_ktx2_cube_as_it_is(texture, run, level):
    """By ktx-parse, since its own KTX2Loader reads no uncompressed cubes, as docs/layouts.md says.

    three.js takes cube maps for left-handed and mirrors them in x, but for those it rendered.
    """
    path, levels = texture
    script = """
    const n = container.pixelWidth >> level, size = n * n * 4;
    const { buffer, byteOffset } = container.levels[level].levelData;
    const faces = [0, 1, 2, 3, 4, 5].map((face) => {
      const data = new Uint16Array(buffer, byteOffset + 2 * size * face, size);
      const image = new THREE.DataTexture(data, n, n, THREE.RGBAFormat, THREE.HalfFloatType);
      image.needsUpdate = true;
      return image;
    });
    const map = new THREE.CubeTexture(faces);
    map.type = THREE.HalfFloatType; map.generateMipmaps = false;
    map.minFilter = THREE.LinearFilter; map.needsUpdate = true;
    map.isRenderTargetTexture = true;
    scene.background = map;
    const result = views.map((v) => look(...v));
    """
    pictures = run(READ_KTX2 + script, file=encoded(path), views=VIEWS, level=level)
    # Not within half a texel of the cube's corners, where only three texels meet and each GPU fills
    # in the fourth in its own way.
    t = np.abs((np.arange(SIZE) + 0.5) * 2 / SIZE - 1) > 1 - 1 / levels[level].shape[1]
    known = ~(t[:, None] & t[None, :])
    for pixels, view in zip(pictures, VIEWS, strict=True):
        wanted = cube.sample(levels[level], directions(*view, SIZE))
        # 8 bits of filter weights, and half floats
        np.testing.assert_allclose(picture(pixels)[known], wanted[known], atol=0.02)
