"""Scene files: a few lines of TOML that say what stands where, of what, and who looks.

docs/scenes.md has the format and an example.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from calibration.primaries import Primaries
from pipeline.errors import InputError, Problem, fault
from pipeline.files import meshes
from pipeline.files.tables import Table, read_toml
from pipeline.materials import Maker
from stages.meshes import placed, plane, sphere, teapot_mesh
from stages.scene import Camera, Material, Mesh, Scene
from stages.scenes import fitted_camera

# Made here, each about a tenth of a metre and standing on y = 0 about the origin, but for the
# plane, which lies there and is one metre wide.
MESHES = {
    "sphere": lambda: placed(sphere(radius=0.1, segments=64), at=(0.0, 0.1, 0.0)),
    "teapot": teapot_mesh,
    "plane": plane,
}
_MOST_THINGS = 1000


@dataclass(frozen=True)
class SceneFile:
    """A scene file, read and checked.

    scene     what is seen
    aspect    width over height of its picture
    turn_deg  of the environment about +Y, from +Z towards +X
    notes     what was taken for granted
    """

    scene: Scene
    aspect: float
    turn_deg: float
    notes: tuple[str, ...]


def read(path: Path, primaries: Primaries) -> SceneFile:
    """A scene from a TOML file, its materials in the primaries.

    raises  InputError with every problem found
    """
    problems: list[Problem] = []
    notes: list[str] = []
    root = Table(read_toml(path), problems, path)
    environment = root.table("environment")
    turn_deg = environment.number("turn_deg", "degrees", low=-3600, high=3600) or 0.0
    blur = environment.number("blur", "mip levels: 0 sharp, each next half as sharp", low=0, high=8)
    environment.nothing_else()
    maker = Maker(primaries, path.parent, notes)
    aspect, view_deg, placed_camera = _camera(root)
    materials = _materials(root, maker)
    things = []
    tables = root.tables("thing")
    for table in tables[:_MOST_THINGS]:
        thing = _thing(table, maker, materials)
        if thing is not None:
            things.append(thing)
    root.nothing_else()
    if not tables:
        root.wrong("thing", "missing", "one [[thing]] or more", "say what is to be seen")
    if len(tables) > _MOST_THINGS:
        root.wrong("thing", f"given {len(tables)} times", f"at most {_MOST_THINGS}", "use fewer")
    if problems:
        raise InputError(problems)
    camera = placed_camera or fitted_camera(
        [mesh for mesh, _ in things], aspect=aspect, vertical_view_deg=view_deg
    )
    scene = Scene(tuple(things), camera, 1.5 if blur is None else blur)
    return SceneFile(scene, aspect, turn_deg, tuple(dict.fromkeys(notes)))


def _camera(root: Table) -> tuple[float, float, Camera | None]:
    """The picture's aspect, the angle of view, and the camera; None: what is there decides."""
    table = root.table("camera")
    eye = table.vector("eye", "metres")
    target = table.vector("target", "metres")
    view_deg = table.number("view_deg", "degrees from top to bottom", low=0.1, high=150) or 27.0
    aspect = table.number("aspect", "width over height", low=0.1, high=10) or 1.0
    table.nothing_else()
    if eye is None:
        if target is not None:
            table.wrong("target", "given without eye", "both or neither", "add eye")
        return aspect, view_deg, None
    target = target or (0.0, 0.0, 0.0)
    if eye[0] == target[0] and eye[2] == target[2]:
        table.wrong(
            "eye",
            "straight above or below the target, or in it",
            "a camera that does not look straight up or down",
            "move it a little",
        )
    return aspect, view_deg, Camera(eye, target, view_deg)


def _materials(root: Table, maker: Maker) -> dict[str, Material | None]:
    """[material.NAME] by name; None for one with problems, which are noted."""
    tables = root.table("material")
    return {name: maker.read(tables.table(name)) for name in tables.content}


def _thing(
    table: Table, maker: Maker, materials: dict[str, Material | None]
) -> tuple[Mesh, Material] | None:
    name = table.text("mesh")
    at = table.vector("at", "metres") or (0.0, 0.0, 0.0)
    scale = table.number("scale", "times its size", low=1e-9, high=1e9)
    turn_deg = table.number("turn_deg", "degrees", low=-3600, high=3600)
    up = table.text("up", "y")
    if up not in meshes.UPS:
        table.wrong("up", repr(up), '"y" or "z"', "say which of the file's axes is up")
        up = "y"
    material = _material(table, maker, materials)
    table.nothing_else()
    if name is None:
        if "mesh" not in table.content:
            known = ", ".join(MESHES)
            table.wrong("mesh", "missing", f"{known}, or a file", "say what it is")
        return None
    mesh = None
    with table.noting("mesh"):
        mesh = _mesh(name, maker, up or "y")
    if mesh is None or material is None:
        return None
    if material.image is not None and mesh.uv is None:
        table.wrong("mesh", f"{name!r}, without uv", "uv to lay the image by", "unwrap the mesh")
        return None
    if isinstance(material.roughness, tuple) and mesh.tangents is None:
        table.wrong(
            "mesh", f"{name!r}, without uv", "uv to tell along from across by", "unwrap the mesh"
        )
        return None
    here = placed(mesh, at=at, scale=1.0 if scale is None else scale, turn_deg=turn_deg or 0.0)
    return here, material


def _material(table: Table, maker: Maker, materials: dict[str, Material | None]) -> Material | None:
    """The thing's own material, or the one it names; None where it is wrong, which is noted."""
    value = table.raw("material")
    if isinstance(value, dict):
        return maker.read(table.table("material"))
    if isinstance(value, str) and value in materials:
        return materials[value]
    known = ", ".join(materials) or "[material.NAME] tables, of which there are none"
    found = "missing" if value is None else repr(value)
    table.wrong("material", found, known, "name one, or write { diffuse = ... }")
    return None


def _mesh(name: str, maker: Maker, up: str) -> Mesh:
    if name in MESHES:
        return MESHES[name]()
    if not Path(name).suffix:
        raise fault(repr(name), f"{', '.join(MESHES)}, or a file", "name one")
    mesh, said = meshes.read(maker.file(name), up=up)
    maker.notes.extend(said)
    return mesh
