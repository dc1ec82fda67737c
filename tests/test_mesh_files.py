"""Meshes from files: trimesh's conventions against those of Mesh, and what broken files say."""

import base64
import json
import shutil

import numpy as np
import pytest

from calibration.errors import InputError
from pipeline.files import meshes

SQUARE = """v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
"""
CUBE = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1)) + (
    "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
)


def write(path, text):
    path.write_text(text)
    return path


def gltf(path, *, nodes, normals=True, material=True):
    """A glTF of one triangle in the plane z = 0, whose image has its upper left corner at +Y."""
    parts = {
        "POSITION": np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0]]),
        "TEXCOORD_0": np.float32([[0, 1], [1, 1], [0, 0]]),
    }
    if normals:
        parts["NORMAL"] = np.float32([[0, 0, 1]] * 3)
    blob, views, accessors = b"", [], []
    for values in [*parts.values(), np.uint32([0, 1, 2])]:
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": values.nbytes})
        kind = {1: "SCALAR", 2: "VEC2", 3: "VEC3"}[1 if values.ndim == 1 else values.shape[1]]
        component = 5125 if values.ndim == 1 else 5126
        accessors.append(
            {"bufferView": len(views) - 1, "componentType": component, "count": 3, "type": kind}
        )
        blob += values.tobytes()
    accessors[0] |= {"min": [0, 0, 0], "max": [1, 1, 0]}
    primitive = {"attributes": {n: i for i, n in enumerate(parts)}, "indices": len(parts)}
    if material:
        primitive["material"] = 0
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(nodes)))}],
        "nodes": [{"mesh": 0, **node} for node in nodes],
        "meshes": [{"primitives": [primitive]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}}],
        "buffers": [
            {
                "byteLength": len(blob),
                "uri": "data:application/octet-stream;base64," + base64.b64encode(blob).decode(),
            }
        ],
        "bufferViews": views,
        "accessors": accessors,
    }
    return write(path, json.dumps(document))


def winding(mesh):
    a, b, c = (mesh.positions[mesh.triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def test_an_objs_own_normals_uv_and_winding_are_kept(tmp_path):
    tilted = "vn 0 0.6 0.8\n" + "f 1/1/1 2/2/1 3/3/1 4/4/1\n"
    mesh, notes = meshes.read(write(tmp_path / "square.obj", SQUARE + tilted))
    np.testing.assert_allclose(mesh.normals, np.tile([0, 0.6, 0.8], (4, 1)), atol=1e-6)
    assert (winding(mesh)[:, 2] > 0).all()  # counter-clockwise, seen from +Z
    np.testing.assert_allclose(mesh.uv, mesh.positions[:, :2])  # (0, 0) lower left
    assert not any("normals" in note for note in notes)


def test_tangents_run_along_u(tmp_path):
    mesh, _ = meshes.read(write(tmp_path / "square.obj", SQUARE + "f 1/2 2/3 3/4 4/1\n"))
    # u grows from vertex 4 (0, 1) down to 1, and from 3 down to 2: along -Y
    np.testing.assert_allclose(mesh.tangents, np.tile([0, -1, 0], (4, 1)), atol=1e-6)


def test_gltf_has_y_up_and_its_images_the_other_way_up(tmp_path):
    mesh, notes = meshes.read(gltf(tmp_path / "one.gltf", nodes=[{}]))
    top = mesh.positions[:, 1].argmax()
    assert mesh.uv[top].tolist() == [0.0, 1.0]  # upper left, as (0, 0) is the lower left here
    assert (winding(mesh)[:, 2] > 0).all()
    assert any("materials" in note for note in notes)


def test_parts_of_a_file_are_put_in_their_places(tmp_path):
    nodes = [{"translation": [5, 0, 0]}, {"scale": [-2, 1, 1]}]
    mesh, _ = meshes.read(gltf(tmp_path / "two.gltf", nodes=nodes))
    assert len(mesh.triangles) == 2
    assert sorted(mesh.positions[:, 0].tolist()) == [-2, 0, 0, 5, 5, 6]
    # a mirrored part still faces the way its normals do
    assert (winding(mesh)[:, 2] > 0).all()
    np.testing.assert_allclose(mesh.normals, np.tile([0, 0, 1], (6, 1)), atol=1e-6)


def test_a_cube_without_normals_keeps_its_edges(tmp_path):
    mesh, notes = meshes.read(write(tmp_path / "cube.obj", CUBE))
    assert len(mesh.positions) == 24
    assert (np.sort(np.abs(mesh.normals), axis=1) == [0, 0, 1]).all()
    outwards = np.einsum("ij,ij->i", mesh.normals, mesh.positions - 0.5)
    assert (outwards > 0).all()
    assert any("no normals" in note for note in notes)


def test_a_cube_turned_inside_out_is_turned_back(tmp_path):
    faces = [line.split()[1:] for line in CUBE.splitlines() if line.startswith("f")]
    vertices = CUBE.split("f ", 1)[0]
    inside_out = vertices + "".join(f"f {' '.join(f[::-1])}\n" for f in faces)
    mesh, notes = meshes.read(write(tmp_path / "cube.obj", inside_out))
    assert (np.einsum("ij,ij->i", mesh.normals, mesh.positions - 0.5) > 0).all()
    assert any("inwards" in note for note in notes)


def test_z_may_be_up(tmp_path):
    mesh, _ = meshes.read(write(tmp_path / "square.obj", SQUARE + "f 1 2 3 4\n"), up="z")
    np.testing.assert_allclose(mesh.normals, np.tile([0, 1, 0], (4, 1)), atol=1e-6)


@pytest.mark.parametrize("size", [1e-12, 1e12])
def test_size_is_kept_however_small_or_large(tmp_path, size):
    vertices = f"v 0 0 0\nv {size} 0 0\nv 0 {size} 0\n"
    mesh, _ = meshes.read(write(tmp_path / "one.obj", vertices + "f 1 2 3\n"))
    assert np.ptp(mesh.positions[:, 0]) == pytest.approx(size, rel=1e-6)
    np.testing.assert_allclose(mesh.normals, np.tile([0, 0, 1], (3, 1)), atol=1e-6)


def test_a_scan_far_from_its_origin_is_brought_there(tmp_path):
    far = "v 4500000 0 0\nv 4500001 0 0\nv 4500000.5 0.25 0\nf 1 2 3\n"
    mesh, notes = meshes.read(write(tmp_path / "scan.obj", far))
    assert np.abs(mesh.positions).max() < 1
    assert np.ptp(mesh.positions, axis=0).tolist() == pytest.approx([1, 0.25, 0], abs=1e-3)
    assert any("origin" in note for note in notes)


def test_triangles_without_area_are_left_out(tmp_path):
    mesh, notes = meshes.read(write(tmp_path / "s.obj", SQUARE + "f 1 2 3\nf 1 2 2\nf 4 4 4\n"))
    assert len(mesh.triangles) == 1
    assert any("without area" in note for note in notes)


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("empty.obj", "", "no triangles"),
        ("points.obj", "v 0 0 0\nv 1 1 1\n", "no triangles"),
        ("index.obj", "v 0 0 0\nv 1 1 1\nv 1 0 0\nf 1 2 9\n", "export it again"),
        ("nan.obj", "v 0 0 nan\nv 1 1 1\nv 1 0 0\nf 1 2 3\n", "NaN"),
        ("text.obj", "v a b c\nf x y z\n", "text.obj"),
        ("half.gltf", '{"asset": {', "export it again"),
        ("half.glb", "glTF", "export it again"),
        ("flat.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "no triangles"),
        ("mesh.blend", "BLENDER", "export it in one of these formats"),
    ],
)
def test_a_broken_file_says_so_in_a_line(tmp_path, name, text, says):
    with pytest.raises(InputError) as caught:
        meshes.read(write(tmp_path / name, text))
    said = str(caught.value)
    assert "\n" not in said
    assert name in said
    assert says in said


def test_what_a_file_names_must_lie_beside_it(tmp_path):
    path = gltf(tmp_path / "one.gltf", nodes=[{}])
    document = json.loads(path.read_text())
    document["buffers"][0]["uri"] = "part.bin"
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"'part\.bin' is missing"):
        meshes.read(path)
    document["buffers"][0]["uri"] = "../part.bin"
    inner = tmp_path / "inner"
    inner.mkdir()
    (tmp_path / "part.bin").write_bytes(bytes(200))
    shutil.move(write(path, json.dumps(document)), inner / "one.gltf")
    with pytest.raises(InputError, match="outside its folder"):
        meshes.read(inner / "one.gltf")
