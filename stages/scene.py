"""What a picture shows: meshes, materials, a camera, and how the environment is turned about them.

Lengths in metres, the world's axes as in `stages/cube.py`: +Y up, the camera on the +Z side.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

BRDFS = ("ward", "ward1992", "ggx")


@dataclass(frozen=True)
class Mesh:
    """Triangles with a normal at each vertex.

    positions  (V, 3) world, metres
    normals    (V, 3) unit, outwards
    triangles  (T, 3) vertex numbers, counter-clockwise from outside
    uv         (V, 2) place in an image laid on the surface, (0, 0) its lower left corner; None
               where there is none to lay
    tangents   (V, 3) unit, along the surface: what the first roughness of a material is measured
               along; None where nothing says
    """

    positions: NDArray[np.float32]
    normals: NDArray[np.float32]
    triangles: NDArray[np.int32]
    uv: NDArray[np.float32] | None = None
    tangents: NDArray[np.float32] | None = None


@dataclass(frozen=True)
class Material:
    """A matt body under a gloss.

    diffuse    (C,) rho_d, reflectance in each channel of the light it is shown under
    specular   (C,) rho_s, likewise; or (K, C), by the angle of incidence on the facets that
               mirror: at K equal steps of its cosine from 1, head on, down to 0
    roughness  alpha: standard deviation of the surface's slope, (0, 1]; or two of them, along the
               mesh's tangents and across
    brdf       one of BRDFS: Ward's in its bounded form, Ward's as of 1992, GGX
    image      (H, W, C) reflectances in place of `diffuse`, row 0 the upper edge; needs the
               mesh's uv
    """

    diffuse: NDArray[np.float64]
    specular: NDArray[np.float64]
    roughness: float | tuple[float, float]
    brdf: str = "ward"
    image: NDArray[np.float32] | None = None


@dataclass(frozen=True)
class Camera:
    """A pinhole: where it is, what it looks at (world), its angle of view; +Y is up."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    vertical_view_deg: float


@dataclass(frozen=True)
class Scene:
    """Things in an environment, and who looks.

    things            (mesh, material) each
    background_level  mip level at which the environment itself is seen: 0 sharp, 1 half as sharp
    """

    things: tuple[tuple[Mesh, Material], ...]
    camera: Camera
    background_level: float = 0.0


def turned(scene: Scene, degrees: float) -> Scene:
    """The scene, camera and all, turned about +Y: as if the environment turned the other way.

    degrees  positive from +Z towards +X
    """
    angle = np.radians(degrees)
    cos, sin = np.cos(angle), np.sin(angle)
    rotation = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])

    def about(vectors):
        return (np.asarray(vectors, np.float64) @ rotation.T).astype(np.float32)

    def point(place) -> tuple[float, float, float]:
        x, y, z = (rotation @ place).tolist()
        return x, y, z

    things = tuple(
        (
            replace(
                mesh,
                positions=about(mesh.positions),
                normals=about(mesh.normals),
                tangents=None if mesh.tangents is None else about(mesh.tangents),
            ),
            material,
        )
        for mesh, material in scene.things
    )
    camera = replace(scene.camera, eye=point(scene.camera.eye), target=point(scene.camera.target))
    return replace(scene, things=things, camera=camera)
