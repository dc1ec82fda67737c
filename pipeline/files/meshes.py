"""Meshes from files, OBJ and glTF and others, through trimesh; each doubt about one is a note.

trimesh's conventions are those of `stages.scene.Mesh`, which tests/test_mesh_files.py makes sure
of: triangles counter-clockwise from outside; uv with (0, 0) the image's lower left corner, also for
glTF, whose own is the upper left. A file's axes are taken as they stand: glTF has +Y up by its
standard, OBJ and the others by habit.
"""

from __future__ import annotations

import json
import logging
import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.errors import InputError, fault
from stages.meshes import CREASE_DEG, joined, places, with_normals, with_tangents
from stages.scene import Mesh

FORMATS = (".obj", ".gltf", ".glb", ".ply", ".stl", ".off")
MOST_TRIANGLES = 5_000_000  # a gigabyte or two of memory while one is read
UPS = ("y", "z")
_FARTHEST = 1e4  # sizes from the origin: single floats then hold a thousandth of the size
_Y_FROM_Z = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def read(path: Path, *, up: str = "y") -> tuple[Mesh, tuple[str, ...]]:
    """All that a file holds as one mesh, as large as it is there, and notes.

    up      which of the file's axes is up: "z" is turned to y
    raises  InputError, one line, where the file is none, is broken, or holds no triangles
    """
    assert up in UPS, up
    path = Path(path)
    notes: list[str] = []
    parts = []
    found = _parts(path)
    upright = _upright(up, found, notes)
    for geometry, transform in found:
        try:
            part = _part(geometry, upright @ transform, notes)
        except InputError as error:
            raise error.at(path) from None
        if part is not None:
            parts.append(part)
    if not parts:
        raise fault(
            "no triangles",
            "a mesh of triangles",
            "export it as a mesh, not as points, curves or an empty scene",
            path,
        )
    return with_tangents(joined(parts)), tuple(
        dict.fromkeys(f"{path.name}: {note}" for note in notes)
    )


def _parts(path: Path) -> list[tuple[Any, Any]]:
    """Each geometry of a file as trimesh has it, with its place (4, 4) in the file's scene."""
    if not path.is_file():
        found = "a folder" if path.is_dir() else "no such file"
        raise fault(found, f"a mesh: {', '.join(FORMATS)}", "check the path", path)
    if path.suffix.lower() not in FORMATS:
        raise fault(
            f"a file {path.suffix or 'without suffix'}",
            f"a mesh: {', '.join(FORMATS)}",
            "export it in one of these formats",
            path,
        )
    import trimesh  # .3 s

    resolver: Any = _Beside(path)  # all of trimesh's Resolver that its readers of these ask for
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # what matters is said below
    try:
        with path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if path.suffix.lower() == ".gltf":
                json.load(file)  # trimesh takes what is no JSON for a name to look up
                file.seek(0)
            scene = trimesh.load_scene(
                file,
                file_type=path.suffix.lower()[1:],
                resolver=resolver,
                process=False,
            )
        placed_parts = []
        for node in scene.graph.nodes_geometry:
            transform, name = scene.graph[node]
            vertices = getattr(scene.geometry[name], "vertices", ())
            if len(vertices) and np.shape(vertices)[1:] != (3,):
                raise ValueError("points of other than three coordinates")
            placed_parts.append((scene.geometry[name], np.asarray(transform, float)))
    except InputError as error:
        raise error.at(path) from None
    # Its readers trust the file: a broken one ends in whatever error comes first.
    except Exception as error:
        said = " ".join(str(error).split())[:120]
        raise fault(
            f"cannot be read as {path.suffix.lower()[1:]} ({type(error).__name__}: {said})",
            "a complete file",
            "export it again",
            path,
        ) from error
    return placed_parts


def _upright(up: str, parts, notes: list[str]):
    """The transform (4, 4) of the file's scene that turns up to +Y.

    A mesh further from its origin than single floats can tell its points apart, as maps and scans
    are, is brought to it.
    """
    turn = np.eye(4) if up == "y" else _Y_FROM_Z
    corners = []
    for geometry, transform in parts:
        if len(getattr(geometry, "vertices", ())):
            low_high = np.stack(
                [np.min(geometry.vertices, axis=0), np.max(geometry.vertices, axis=0)]
            )
            corners.append(low_high @ transform[:3, :3].T + transform[:3, 3])
    if corners and np.isfinite(corners).all():
        places = np.concatenate(corners)
        middle, size = places.mean(axis=0), np.ptp(places, axis=0).max()
        if size > 0 and np.abs(middle).max() > _FARTHEST * size:
            notes.append(
                f"{np.abs(middle).max() / size:.0f} times its size from its origin: moved there"
            )
            move = np.eye(4)
            move[:3, 3] = -middle
            return turn @ move
    return turn


class _Beside:
    """What a file names and needs, buffers of a glTF, from its own folder and nowhere else."""

    def __init__(self, path: Path):
        self.folder = path.parent.resolve()

    def get(self, name: str) -> bytes:
        path = (self.folder / name).resolve()
        if Path(name).suffix.lower() in {".mtl", ".png", ".jpg", ".jpeg", ".tga", ".bmp", ".ktx2"}:
            raise FileNotFoundError(name)  # materials are not looked at
        if not path.is_relative_to(self.folder):
            raise fault(f"{name!r}, outside its folder", "files beside it", "move it there")
        if not path.is_file():
            raise fault(f"{name!r} is missing", "the files it names beside it", "copy it there")
        return path.read_bytes()

    def __getitem__(self, name: str) -> bytes:
        return self.get(name)

    def namespaced(self, namespace: str) -> _Beside:
        return _Beside(self.folder / namespace / os.curdir)


def _part(geometry, transform, notes: list[str]) -> Mesh | None:
    """One geometry in place, with normals; None where it has no triangles."""
    if not hasattr(geometry, "faces") or not len(geometry.faces):
        if len(getattr(geometry, "vertices", ())):
            notes.append("points or lines in it are left out")
        return None
    positions = np.asarray(geometry.vertices, np.float64)
    triangles = np.asarray(geometry.faces, np.int64)
    if len(triangles) > MOST_TRIANGLES:
        raise fault(
            f"{len(triangles)} triangles in a part",
            f"at most {MOST_TRIANGLES}",
            "simplify the mesh",
        )
    if triangles.min() < 0 or triangles.max() >= len(positions):
        raise fault(
            f"a triangle names vertex {triangles.max() + 1} of {len(positions)}",
            "vertices that are there",
            "export it again",
        )
    used = np.unique(triangles)
    if not np.isfinite(positions[used]).all() or not np.isfinite(transform).all():
        bad = int((~np.isfinite(positions[used]).all(axis=1)).sum())
        raise fault(
            f"{bad} vertices at NaN or infinity" if bad else "a transform that is not finite",
            "finite coordinates",
            "repair the mesh where it was made",
        )
    if getattr(geometry.visual, "material", None) is not None:
        notes.append("materials and pictures in the file are not used; give them in a scene file")
    normals = _normals(geometry, used, notes)
    uv = getattr(geometry.visual, "uv", None)
    uv = None if uv is None or len(uv) != len(positions) else np.asarray(uv, np.float64)
    if uv is not None and not np.isfinite(uv[used]).all():
        notes.append("its uv has NaN and is not used")
        uv = None

    positions = positions @ transform[:3, :3].T + transform[:3, 3]
    turn = float(np.sign(np.linalg.det(transform[:3, :3])))
    if turn < 0:
        triangles = triangles[:, ::-1]
    areas = np.linalg.norm(_crosses(positions, triangles), axis=1)
    if (areas == 0).any():
        notes.append("triangles without area are left out")
        triangles = triangles[areas > 0]
    if not len(triangles) or turn == 0:
        return None
    if normals is not None:
        normals = normals @ np.linalg.inv(transform[:3, :3])  # as a plane's, not as a point
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        small = np.ascontiguousarray(triangles, np.int32)
        return Mesh(
            _single(positions), _single(normals), small, None if uv is None else _single(uv)
        )
    notes.append(f"no normals in the file: computed, smooth but at edges over {CREASE_DEG:g} deg")
    if _inside_out(positions, triangles):
        notes.append("a closed surface that faces inwards is turned outwards")
        triangles = triangles[:, ::-1]
    return with_normals(_single(positions), triangles, uv)


def _normals(geometry, used, notes: list[str]):
    """The file's own normals (V, 3), or None where it has none that can be used."""
    if "vertex_normals" not in geometry._cache:  # what trimesh itself asks before it exports them
        return None
    normals = np.asarray(geometry.vertex_normals, np.float64)
    length = np.linalg.norm(normals, axis=1)
    if not np.isfinite(length[used]).all() or (length[used] == 0).any():
        notes.append("normals of no length or NaN")
        return None
    return np.divide(normals, length[:, None], out=np.zeros_like(normals),
                     where=length[:, None] > 0)  # fmt: skip


def _inside_out(positions, triangles) -> bool:
    """Whether a surface is closed and its triangles run clockwise, seen from outside."""
    place = places(positions)[triangles]
    sides = np.concatenate([place[:, [0, 1]], place[:, [1, 2]], place[:, [2, 0]]])
    there, back = (np.unique(s, axis=0, return_counts=True) for s in (sides, sides[:, ::-1]))
    closed = len(there[0]) == len(sides) and np.array_equal(there[0], back[0])
    middle = positions[triangles].mean(axis=(0, 1))
    volume = np.einsum(
        "ij,ij->", positions[triangles[:, 0]] - middle, _crosses(positions, triangles)
    )
    return bool(closed and volume < 0)


def _crosses(positions, triangles):
    """Twice each triangle's area as a vector (T, 3), outwards."""
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def _single(values):
    return np.ascontiguousarray(values, np.float32)
