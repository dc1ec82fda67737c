"""Spectral rendering with Mitsuba 3, three exact wavelengths at a time.

A *spectral scene* is an ordinary Mitsuba scene dictionary in which every spectrum is an array whose
last axis is the 36 wavelengths: (36,) a uniform one, (H, W, 36) a texture. Mitsuba's rgb variants
carry three numbers along each path and never ask what they mean, so twelve passes with the same
seed give 36 wavelengths whose noise is the same path for path: a pixel may be a little too bright,
it is not coloured. (Random wavelengths, as the spectral variants draw them, are far noisier in
bands of 10 nm.)

All that is plain geometry - `scene["surfaces"]`, a list of `Surface` - becomes one mesh of
triangles that carry their own reflectance: one intersection and one material, much faster than
hundreds of shapes.

The light on the surfaces is found beforehand (`pipeline.simulate.light`), so that what Mitsuba
draws here - photograph and truth - is the very same room, without the grain of path tracing. All
that it computes is what must be right: the camera, the mirror and which way each ray goes.
"""

from __future__ import annotations

import ctypes.util
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.errors import fault
from calibration.spectra import WAVELENGTHS
from pipeline.simulate.materials import require

Scene = dict[str, Any]
Progress = Callable[[str], None]

PASSES = tuple(range(0, len(WAVELENGTHS), 3))  # first of the three wavelengths of each pass


@dataclass(frozen=True)
class Surface:
    """A matte surface through a grid of points, seen from the side its normals point to.

    points       (R, C, 3) metres; the normal is along columns x along rows
    reflectance  (36,), or of each cell (R - 1, C - 1, 36)
    smooth       whether it is curved between the points
    light        (R, C, 36) W/(sr m2 nm) that would leave a perfect white there; None until found
    """

    points: NDArray[np.float64]
    reflectance: NDArray[np.floating]
    smooth: bool = False
    light: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        per_cell = (self.points.shape[0] - 1, self.points.shape[1] - 1, len(WAVELENGTHS))
        assert self.reflectance.shape in (per_cell, per_cell[-1:]), self.reflectance.shape


@cache
def mitsuba():
    """The module mitsuba, set to three numbers a path and compiled by LLVM.

    Its variants without LLVM trace one ray at a time, which would take days.
    """
    # LLVM is found under this name from version 16 on; Mitsuba does not run with older ones.
    named = {"LLVM": "DRJIT_LIBLLVM_PATH" in os.environ}
    for library, package in (("atomic", "libatomic1"), ("LLVM", "libllvm19")):
        if not (named.get(library) or ctypes.util.find_library(library)):
            raise fault(
                f"Mitsuba needs the library {library}, which is not found",
                "",
                f"install it (Debian: apt-get install {package})",
            )
    mi = require("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    return mi


def spectrum_of(values) -> dict[str, Any]:
    """Mitsuba's texture of three wavelengths' values: (3,) uniform or (H, W, 3) over a surface.

    A texture's row 0 is at v = 0.
    """
    if values.ndim == 1:
        return {"type": "rgb", "value": [float(v) for v in values]}
    mi = mitsuba()
    bitmap = mi.Bitmap(np.ascontiguousarray(values, np.float32))
    return {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "clamp"}


def at_wavelengths(scene: Scene, first: int) -> Scene:
    """The Mitsuba scene of the wavelengths first, first + 1, first + 2."""
    mi = mitsuba()
    resolved: Scene = {}
    for name, item in scene.items():
        if name == "surfaces":
            lit = item[0].light is not None
            colour = {"type": "mesh_attribute", "name": "vertex_light" if lit else "face_paint"}
            bsdf = {"type": "diffuse", "reflectance": colour}
            resolved[name] = _mesh(name, item, first, {"bsdf": bsdf})
        elif isinstance(item, dict):
            item = at_wavelengths(item, first)
            if item.get("type") == "surface":
                roles = {"bsdf": item["bsdf"], "emitter": item["emitter"]}
                resolved[name] = _mesh(name, [item["surface"]], first, roles)
            else:
                resolved[name] = item
        elif isinstance(item, np.ndarray) and item.shape[-1] == len(WAVELENGTHS):
            resolved[name] = spectrum_of(item[..., first : first + 3])
        elif isinstance(item, np.ndarray) and item.shape == (4, 4):
            resolved[name] = mi.ScalarTransform4f(item)
        else:
            resolved[name] = item
    return resolved


def _mesh(name: str, surfaces: Sequence[Surface], first: int, roles: Scene):
    """One Mitsuba mesh of many surfaces; `roles` its bsdf and emitter."""
    mi = mitsuba()
    corners, faces, shading, paints, lights = [], [], [], [], []
    count = 0
    for surface in surfaces:
        p = surface.points
        quads = cells(p)
        n = quads.shape[0] * quads.shape[1]
        first_corner = count + 4 * np.arange(n)[:, None]
        faces.append((first_corner[:, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3))
        corners.append(quads.reshape(-1, 3))
        curved = cells(normals(p)) if surface.smooth else flat_normals(quads)[:, :, None]
        shading.append(np.broadcast_to(curved, quads.shape).reshape(-1, 3))
        paint = surface.reflectance[..., first : first + 3]
        paints.append(np.repeat(np.broadcast_to(paint.reshape(-1, 3), (n, 3)), 2, axis=0))
        if surface.light is not None:
            light = cells(surface.light[..., first : first + 3])
            lights.append(
                (light * (paint[:, :, None] if paint.ndim == 3 else paint)).reshape(-1, 3)
            )
        count += 4 * n
    properties = mi.Properties()
    for role, plugin in roles.items():
        properties[role] = mi.load_dict(plugin)
    triangles = sum(map(len, faces))
    mesh = mi.Mesh(name, count, triangles, props=properties, has_vertex_normals=True)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.concatenate(corners).ravel().astype(np.float32)
    parameters["vertex_normals"] = np.concatenate(shading).ravel().astype(np.float32)
    parameters["faces"] = np.concatenate(faces).ravel().astype(np.uint32)
    parameters.update()
    mesh.add_attribute("face_paint", 3, np.concatenate(paints).ravel().astype(np.float32))
    if lights:
        mesh.add_attribute("vertex_light", 3, np.concatenate(lights).ravel().astype(np.float32))
    return mesh


def cells(grid):
    """The four corners (R - 1, C - 1, 4, ...) of each cell of a grid (R, C, ...), in turn."""
    return np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=2)


def flat_normals(quads):
    """Normals (..., 3) of quadrilaterals (..., 4, 3)."""
    n = np.cross(quads[..., 2, :] - quads[..., 0, :], quads[..., 3, :] - quads[..., 1, :])
    return n / np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-12)


def normals(points) -> NDArray[np.float64]:
    """Normals (R, C, 3) of the smooth surface through points (R, C, 3)."""
    p = np.asarray(points, np.float64)
    # A closed surface's first and last column are the same line: differences run on across it.
    if np.allclose(p[:, 0], p[:, -1]):
        wrapped = np.concatenate([p[:, -2:-1], p, p[:, 1:2]], axis=1)
        across = (wrapped[:, 2:] - wrapped[:, :-2]) / 2
    else:
        across = np.gradient(p, axis=1)
    normal = np.cross(across, np.gradient(p, axis=0))
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    # At a pole all columns meet and the difference across vanishes: look a little beside it.
    beside = np.concatenate([normal[1:2], normal[1:-1], normal[-2:-1]])
    normal = np.where(length > 1e-9 * length.max(), normal, beside)
    return normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)


@cache
def look() -> Scene:
    """An integrator that sees the light found on surfaces, directly or in one perfect mirror."""

    mi, dr = mitsuba(), require("drjit")

    class Look(mi.SamplingIntegrator):  # type: ignore[name-defined]
        def sample(self, scene, sampler, ray, medium=None, active=True):
            def seen(hit):
                facing = hit.is_valid() & (mi.Frame3f.cos_theta(hit.wi) > 0)
                facing &= ~hit.shape.is_emitter()  # a lamp's own reflectance is no light
                # A lit surface's "reflectance" is the radiance that leaves it.
                light = hit.bsdf().eval_diffuse_reflectance(hit, facing)
                return hit.emitter(scene).eval(hit) + dr.select(facing, light, 0.0)

            first = scene.ray_intersect(ray, active)
            bsdf = first.bsdf()
            mirror = first.is_valid() & mi.has_flag(bsdf.flags(), mi.BSDFFlags.DeltaReflection)
            bounce, weight = bsdf.sample(mi.BSDFContext(), first, 0.5, mi.Point2f(0.5), mirror)
            second = scene.ray_intersect(first.spawn_ray(first.to_world(bounce.wo)), mirror)
            light = dr.select(mirror, weight * seen(second), seen(first))
            return light, first.is_valid(), []

    mi.register_integrator("look_at_lit_surfaces", lambda properties: Look(properties))
    return {"type": "look_at_lit_surfaces"}


@dataclass(frozen=True)
class View:
    """A sphere and the pinhole camera that looks at it, in the scene's coordinates (metres, +Y up).

    sphere     centre of the sphere
    radius     of the sphere
    eye        the camera's entrance pupil
    target     a point on the optical axis
    focal_px   image distance
    width, height  px; the principal point is at half of both
    """

    sphere: tuple[float, float, float]
    radius: float
    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    focal_px: float
    width: int
    height: int

    @property
    def distance(self) -> float:
        return float(np.linalg.norm(np.subtract(self.eye, self.sphere)))

    @property
    def camera_axes(self) -> NDArray[np.float64]:
        """Rows: the photograph's right, down and the optical axis, in scene coordinates."""
        forward = _unit(np.subtract(self.target, self.eye))
        right = _unit(np.cross(forward, (0.0, 1.0, 0.0)))
        return np.stack([right, np.cross(forward, right), forward])

    @property
    def world_axes(self) -> NDArray[np.float64]:
        """Rows: +X, +Y, +Z of the result's world in scene coordinates.

        +Z from the sphere's centre to the entrance pupil, +Y the photograph's up made
        perpendicular to it.
        """
        z = _unit(np.subtract(self.eye, self.sphere))
        up = -self.camera_axes[1]
        y = _unit(up - z * (up @ z))
        return np.stack([np.cross(y, z), y, z])

    def project(self, point) -> tuple[float, float]:
        """Where a point of the scene appears, px; the first pixel's centre is at (0.5, 0.5)."""
        x, y, z = self.camera_axes @ np.subtract(point, self.eye)
        focal = self.focal_px
        return float(self.width / 2 + focal * x / z), float(self.height / 2 + focal * y / z)

    def outline(self) -> NDArray[np.float64]:
        """The sphere's rim (360, 2) px: where the tangent cone from the eye meets the image."""
        z = _unit(np.subtract(self.eye, self.sphere))
        x, y = self.world_axes[:2]
        angle = np.radians(np.arange(360.0))[:, None]
        # the circle of tangent points stands r^2 / d before the centre
        height = self.radius**2 / self.distance
        ring = self.radius * np.sqrt(1 - (self.radius / self.distance) ** 2)
        points = self.sphere + height * z + ring * (np.cos(angle) * x + np.sin(angle) * y)
        return np.array([self.project(p) for p in points])

    def rim(self) -> tuple[float, float, float]:
        """x, y and radius of the circle through the outline, px (least squares)."""
        x, y = self.outline().T
        a = np.stack([2 * x, 2 * y, np.ones_like(x)], axis=1)
        (cx, cy, c), *_ = np.linalg.lstsq(a, x * x + y * y, rcond=None)
        return float(cx), float(cy), float(np.sqrt(c + cx * cx + cy * cy))


def _unit(v) -> NDArray[np.float64]:
    v = np.asarray(v, np.float64)
    return v / np.linalg.norm(v)


def photograph(
    scene: Scene, view: View, *, subpixels: int, margin: int, samples: int, seed: int,
    progress: Progress,
) -> Iterator[tuple[int, NDArray[np.float32]]]:  # fmt: skip
    """The photograph's radiance at subpixels, pass by pass, lens and sensor not yet considered.

    Yields (first wavelength, image ((height + 2 margin) * subpixels, (width + 2 margin) *
    subpixels, 3)). `samples` paths a subpixel. The principal point is the image's middle.
    """
    mi = mitsuba()
    columns = (view.width + 2 * margin) * subpixels
    rows = (view.height + 2 * margin) * subpixels
    half_angle = np.arctan((view.width / 2 + margin) / view.focal_px)
    strip = max(1, int(4e6) // (columns * samples))  # rows at once: bounds the memory

    def sensor(top: int):
        film = {"type": "hdrfilm", "width": columns, "height": rows, "pixel_format": "rgb",
                "component_format": "float32", "rfilter": {"type": "box"},
                "crop_offset_x": 0, "crop_offset_y": top,
                "crop_width": columns, "crop_height": min(strip, rows - top)}  # fmt: skip
        look = mi.ScalarTransform4f().look_at(list(view.eye), list(view.target), [0, 1, 0])
        return mi.load_dict(
            {"type": "perspective", "fov_axis": "x", "fov": float(np.degrees(2 * half_angle)),
             "near_clip": 0.01, "far_clip": 100.0, "to_world": look, "film": film,
             "sampler": {"type": "independent", "sample_count": samples}}
        )  # fmt: skip

    for first in PASSES:
        loaded = mi.load_dict(at_wavelengths(scene, first))
        image = np.empty((rows, columns, 3), np.float32)
        for number, top in enumerate(range(0, rows, strip)):
            part = mi.render(loaded, sensor=sensor(top), spp=samples, seed=seed + number)
            image[top : top + strip] = np.array(part)
        progress(f"photograph: {_label(first)}")
        yield first, image


def cubemap(
    scene: Scene, centre, world_axes, *, face_size: int, samples: int, seed: int,
    progress: Progress,
) -> NDArray[np.float32]:  # fmt: skip
    """The radiance (6, N, N, 36) that arrives at a point, in the layout of `stages.cube`.

    centre      the point, in scene coordinates
    world_axes  rows +X, +Y, +Z of the world in scene coordinates, as `View.world_axes`
    samples     paths a texel, uniform over the texel
    """
    from stages.cube import face_directions

    mi = mitsuba()
    ahead = face_directions(0.0, 0.0)
    up = face_directions(0.0, -1.0) - ahead / np.sqrt(2)  # v runs down a face

    def sensor(face: int):
        look = mi.ScalarTransform4f().look_at(
            list(centre), list(centre + ahead[face] @ world_axes), list(up[face] @ world_axes)
        )
        film = {"type": "hdrfilm", "width": face_size, "height": face_size, "pixel_format": "rgb",
                "component_format": "float32", "rfilter": {"type": "box"}}  # fmt: skip
        return mi.load_dict(
            {"type": "perspective", "fov": 90.0, "near_clip": 1e-3, "far_clip": 100.0,
             "to_world": look, "film": film,
             "sampler": {"type": "independent", "sample_count": samples}}
        )  # fmt: skip

    at_once = max(1, int(4e6) // face_size**2)  # samples at once: bounds the memory
    rounds = -(-samples // at_once)
    cube = np.zeros((6, face_size, face_size, len(WAVELENGTHS)), np.float32)
    for first in PASSES:
        loaded = mi.load_dict(at_wavelengths(scene, first))
        for face in range(6):
            for number in range(rounds):
                part = mi.render(
                    loaded, sensor=sensor(face), spp=-(-samples // rounds),
                    seed=seed + face * rounds + number,
                )  # fmt: skip
                # A camera sees its world from inside, as a cube map's face is not drawn: its
                # columns run the other way.
                seen = np.array(part)[:, ::-1]
                cube[face, ..., first : first + 3] += seen / np.float32(rounds)
        progress(f"truth: {_label(first)}")
    return cube


def blocked(scene: Scene, places, directions, distances=None) -> NDArray[np.bool_]:
    """Whether rays from places (n, 3) in directions (n, 3) meet anything, within distances (n,)."""
    mi = mitsuba()
    loaded = scene if isinstance(scene, mi.Scene) else mi.load_dict(at_wavelengths(scene, 0))
    ray = mi.Ray3f(
        mi.Point3f(np.asarray(places, np.float32).T),
        mi.Vector3f(np.asarray(directions, np.float32).T),
    )
    if distances is not None:
        ray.maxt = mi.Float(np.asarray(distances, np.float32))
    return np.array(loaded.ray_test(ray))


def _label(first: int) -> str:
    return f"{WAVELENGTHS[first]:.0f} {WAVELENGTHS[first + 1]:.0f} {WAVELENGTHS[first + 2]:.0f} nm"
