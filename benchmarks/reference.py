"""The picture a scene really makes: any number of wavelengths, nothing filtered, nothing sampled.

The whole environment shines on every point of the picture, texel by texel, past whatever stands in
the way; Mitsuba 3 finds what each ray meets. `stages.scene.Scene` serves as it is: with materials
of 36 wavelengths under a cube of 36 it is full-spectral, and `calibration.sets.xyz` brings the
picture to XYZ.

With `bounces`, what the things reflect into one another is added by Mitsuba's own path tracer,
which knows the BRDFs as a plugin (`gloss_bsdf`) and the environment as one of its emitters, three
wavelengths a pass as in `pipeline.simulate.render`.

Of the shaders and of stages/preview.py nothing is used. Nor is benchmarks/quadrature.py, which can
do one point of a lone convex thing, more exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.errors import fault
from pipeline.simulate.render import mitsuba
from stages import cube as cubes
from stages.scene import BRDFS, Camera, Material, Scene

# Points of the picture times texels at once: bounds the memory to some 200 MB.
_AT_ONCE = 1 << 23
# Texels are parted for the gloss until they are no broader than this times alpha, so that a lamp of
# one texel is shown right to a hundredth or two. Towards the outline more, up to so many parts.
_FINE = 1.0
_MOST_PARTS = 4
# A lobe fainter than this over alpha^2 (its peak is some .1 or more) needs no ray of its own.
_FAINT = 1e-5
_SMOOTH_PX = 3


@dataclass(frozen=True)
class Picture:
    """What a pinhole camera sees, one ray through the middle of each pixel.

    radiance  (H, W, C) float32, row 0 at the top
    thing     (H, W) which of the scene's things is there, from 1; 0: the environment
    normal    (H, W, 3) of what is there
    """

    radiance: NDArray[np.float32]
    thing: NDArray[np.int32]
    normal: NDArray[np.float32]


def render(
    cube, scene: Scene, *, width: int, height: int, bounces: int = 0, samples: int = 64,
    seed: int = 1,
) -> Picture:  # fmt: skip
    """A scene in an environment, all channels apart.

    cube     (6, N, N, C) linear, without NaN; each texel counts as evenly bright. The time grows as
             N^2: 64 is plenty for a room
    scene    its materials are given in the same channels
    width, height  of the picture, px
    bounces  how often light goes from thing to thing before it is let go; 0: light comes from the
             environment alone, and what hides it is black
    samples  paths a pixel for the bounces; what comes straight from the environment needs none
    seed     of the paths
    Raises InputError where Mitsuba or its LLVM is missing, and for materials that are more than
    even, isotropic and of one specular reflectance at all angles.
    """
    _check(scene)
    mi = mitsuba()
    cube = np.asarray(cube, np.float32)
    channels = cube.shape[-1]
    plain = mi.load_dict({"type": "scene"} | _shapes(scene, None))
    rays = camera_rays(scene.camera, width, height).reshape(-1, 3)
    hit = _first_hits(plain, scene.camera, rays)
    thing = hit.thing.reshape(height, width)
    radiance = cubes.sample(cube, rays).astype(np.float32)
    for number, (_, material) in enumerate(scene.things, start=1):
        on = np.flatnonzero(hit.thing == number)
        diffuse, gloss = _light_at(plain, cube, hit.at(on), -rays[on], material)
        radiance[on] = np.float32(material.diffuse) * diffuse + np.float32(
            material.specular
        ) * np.float32(gloss)
    radiance = radiance.reshape(height, width, channels)
    picture = Picture(radiance, thing, hit.normal.reshape(height, width, 3))
    if not bounces:
        return picture
    between = indirect(cube, scene, picture, bounces=bounces, samples=samples, seed=seed)
    return replace(picture, radiance=radiance + between)


def indirect(
    cube, scene: Scene, picture: Picture, *, bounces: int, samples: int = 64, seed: int = 1
) -> NDArray[np.float32]:
    """What things reflect onto one another (H, W, C), at each pixel: `render`'s bounces alone.

    picture  the scene's, as `render` gives it: what is where
    The rest as for `render`.

    Path for path what `traced` finds with bounces, less what it finds without; and of pixels on the
    same thing that face alike, within three of each other, a mean: this light changes slowly.
    """
    height, width = picture.thing.shape

    def paths(more: int):
        return traced(
            cube, scene, width=width, height=height, bounces=more, samples=samples, seed=seed
        )

    found = np.where(picture.thing[..., None] > 0, paths(bounces) - paths(0), 0)
    total, weights = np.zeros_like(found), np.zeros((height, width, 1), np.float32)
    for dy in range(-_SMOOTH_PX, _SMOOTH_PX + 1):
        for dx in range(-_SMOOTH_PX, _SMOOTH_PX + 1):
            to = slice(max(0, dy), height + min(0, dy)), slice(max(0, dx), width + min(0, dx))
            of = slice(max(0, -dy), height - max(0, dy)), slice(max(0, -dx), width - max(0, dx))
            alike = np.einsum("yxi,yxi->yx", picture.normal[to], picture.normal[of])
            weight = np.exp(-(dx * dx + dy * dy) / 4.5) * np.maximum(alike, 0) ** 16
            weight = (weight * (picture.thing[to] == picture.thing[of])).astype(np.float32)[
                ..., None
            ]
            total[to] += weight * found[of]
            weights[to] += weight
    return np.asarray(total / np.maximum(weights, 1e-6), np.float32)


def camera_rays(camera: Camera, width: int, height: int) -> NDArray[np.float64]:
    """Unit directions (height, width, 3) through the middles of a pinhole camera's pixels."""
    forward = np.subtract(camera.target, camera.eye)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    half = np.tan(np.radians(camera.vertical_view_deg) / 2)
    x = (2 * (np.arange(width) + 0.5) / width - 1) * half * width / height
    y = (1 - 2 * (np.arange(height) + 0.5) / height) * half
    d = forward + x[:, None] * right + y[:, None, None] * np.cross(right, forward)
    return np.asarray(d / np.linalg.norm(d, axis=-1, keepdims=True))


def traced(
    cube, scene: Scene, *, width: int, height: int, bounces: int = 0, samples: int = 64,
    seed: int = 1, margin: int = 1,
) -> NDArray[np.float32]:  # fmt: skip
    """The same (H, W, C) by Mitsuba's path tracer: noisy, and with light from thing to thing.

    margin   how many times finer than the cube's own texels the environment is told to Mitsuba,
             which knows none but latitude-longitude maps
    The rest as for `render`. Paths are the same for all channels, and for any number of bounces as
    far as they go: differences are much less noisy than the pictures.
    """
    _check(scene)
    mi = mitsuba()
    gloss_bsdf()
    samples = int(np.ceil(np.sqrt(samples))) ** 2  # as the sampler parts a pixel
    cube = np.asarray(cube, np.float32)
    look = mi.ScalarTransform4f().look_at(
        list(scene.camera.eye), list(scene.camera.target), [0, 1, 0]
    )
    film = {"type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgb",
            "component_format": "float32", "rfilter": {"type": "box"}}  # fmt: skip
    sensor = mi.load_dict(
        {"type": "perspective", "fov_axis": "y", "fov": scene.camera.vertical_view_deg,
         "near_clip": 1e-3, "far_clip": 1e3, "to_world": look, "film": film,
         "sampler": {"type": "multijitter", "sample_count": samples}}
    )  # fmt: skip
    integrator = mi.load_dict({"type": "path", "max_depth": 2 + bounces, "rr_depth": 100})
    environment = latlong(cube, margin)
    picture = np.empty((height, width, cube.shape[-1]), np.float32)
    for first in range(0, cube.shape[-1], 3):
        triple = np.minimum(np.arange(first, first + 3), cube.shape[-1] - 1)
        emitter = {"type": "envmap", "bitmap": mi.Bitmap(environment[..., triple])}
        loaded = mi.load_dict({"type": "scene", "environment": emitter} | _shapes(scene, triple))
        part = mi.render(loaded, sensor=sensor, integrator=integrator, spp=samples, seed=seed)
        picture[..., triple] = np.array(part)
    return picture


def latlong(cube, finer: int = 1) -> NDArray[np.float32]:
    """A cube as Mitsuba wants an environment: (2 N f, 4 N f, C), row 0 at +Y, the middle at +Z."""
    height = 2 * np.shape(cube)[1] * finer
    theta = np.pi * (np.arange(height) + 0.5)[:, None] / height
    phi = np.pi * (np.arange(2 * height) + 0.5) / height
    sin, cos = np.sin(theta), np.cos(theta)
    d = np.stack([sin * np.sin(phi), cos + 0 * phi, -sin * np.cos(phi)], axis=-1)
    return np.ascontiguousarray(cubes.sample(np.asarray(cube, np.float32), d))


def _check(scene: Scene) -> None:
    for _, material in scene.things:
        plain = np.ndim(material.roughness) == 0 and np.ndim(material.specular) == 1
        if not plain or material.image is not None:
            raise fault(
                "a material the reference does not know",
                "one diffuse and one specular reflectance and one roughness",
                "leave out images, pairs of roughness and specular reflectance by angle",
            )


# ------------------------------------------------------------------------------- what rays meet


@dataclass(frozen=True)
class _Hits:
    """Where rays meet things: position (K, 3), shading normal (K, 3) toward the eye, thing (K,)."""

    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    thing: NDArray[np.int32]

    def at(self, which) -> _Hits:
        return _Hits(self.position[which], self.normal[which], self.thing[which])


def _shapes(scene: Scene, triple) -> dict[str, Any]:
    """Mitsuba's meshes of the things; with materials of three channels, or none."""
    mi = mitsuba()
    shapes = {}
    for number, (mesh, material) in enumerate(scene.things, start=1):
        properties = mi.Properties()
        if triple is not None:
            properties["bsdf"] = mi.load_dict(_bsdf(material, triple))
        name = f"thing_{number:04d}"
        shape = mi.Mesh(
            name, len(mesh.positions), len(mesh.triangles), props=properties,
            has_vertex_normals=True,
        )  # fmt: skip
        parameters = mi.traverse(shape)
        parameters["vertex_positions"] = np.float32(mesh.positions).ravel()
        parameters["vertex_normals"] = np.float32(mesh.normals).ravel()
        parameters["faces"] = mesh.triangles.astype(np.uint32).ravel()
        parameters.update()
        shapes[name] = shape
    return shapes


def _first_hits(loaded, camera: Camera, rays) -> _Hits:
    mi = mitsuba()
    import drjit as dr

    ray = mi.Ray3f(mi.Point3f(*map(float, camera.eye)), mi.Vector3f(np.float32(rays).T))
    hit = loaded.ray_intersect(ray)
    order = {shape.id(): number for number, shape in enumerate(loaded.shapes())}
    numbers = [int(name.split("_")[-1]) for name in sorted(order, key=lambda name: order[name])]
    thing = dr.zeros(mi.Int32, len(rays))
    for shape, number in zip(loaded.shapes(), numbers, strict=True):
        thing = dr.select(hit.is_valid() & (hit.shape == mi.ShapePtr(shape)), number, thing)
    position, normal = np.array(hit.p).T, np.array(hit.sh_frame.n).T
    away = np.einsum("ij,ij->i", normal, rays) > 0
    # Seen from the back a surface is as from the front; past its outline a normal may turn away.
    back = np.einsum("ij,ij->i", np.array(hit.n).T, rays) > 0
    normal = np.where((away & back)[:, None], -normal, normal)
    lean = np.maximum(1e-3 + np.einsum("ij,ij->i", normal, rays), 0)[:, None]
    normal = normal - lean * rays
    normal = np.where(np.array(hit.is_valid())[:, None], normal, 0.0)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    return _Hits(position.astype(np.float32), normal.astype(np.float32), np.array(thing))


def _light_at(loaded, cube, hits: _Hits, views, material: Material):
    """What a white diffuser and a gloss of rho_s = 1 would show, each (K, C), at points of a thing.

    views  (K, 3) unit, towards the eye
    """
    diffuse, gloss = (np.zeros((len(views), cube.shape[-1]), np.float32) for _ in range(2))
    facing = np.einsum("ij,ij->i", hits.normal, views)
    # A lobe is as broad as alpha, and towards the outline as alpha times the cosine one way.
    breadth = float(np.asarray(material.roughness)) * np.minimum(_FINE, 2 * facing)
    parts = np.ceil(np.pi / 2 / cube.shape[1] / breadth).clip(1, _MOST_PARTS).astype(int)
    shiny = bool(np.any(material.specular))
    for rows in _few(np.flatnonzero(parts == 1) if shiny else np.arange(len(views)), cube, 1):
        diffuse[rows], gloss[rows] = _sums(loaded, cube, hits.at(rows), views[rows], material)
    if shiny:
        for k in range(2, _MOST_PARTS + 1):
            fine = cube.repeat(k, axis=1).repeat(k, axis=2)
            for rows in _few(np.flatnonzero(parts == k), cube, k):
                at = (loaded, hits.at(rows), views[rows], material)
                diffuse[rows], _ = _sums(at[0], cube, *at[1:], gloss=False)
                _, gloss[rows] = _sums(at[0], fine, *at[1:], diffuse=False)
    return diffuse, gloss


def _few(rows, cube, parts: int):
    """Rows in turn, so few at once that points times texels are no more than _AT_ONCE."""
    texels = 6 * (cube.shape[1] * parts) ** 2
    count = max(1, -(-len(rows) * texels // _AT_ONCE))
    return [some for some in np.array_split(rows, count) if len(some)]


def _sums(loaded, cube, hits: _Hits, views, material: Material, *, diffuse=True, gloss=True):
    """Over all texels: what a white diffuser and a gloss of rho_s = 1 would show, each (K, C).

    diffuse, gloss  which of them; the other is 0
    """
    mi = mitsuba()
    import drjit as dr

    count, n = len(views), cube.shape[1]
    texels = 6 * n * n
    light = cube.reshape(texels, -1)
    directions, solid_angles = _sky(n)
    normals, places, eyes = (
        mi.Vector3f(np.float32(a).T) for a in (hits.normal, hits.position, views)
    )
    lane = dr.arange(mi.UInt32, count * texels)
    at, of = lane // texels, lane % texels
    normal, view = dr.gather(mi.Vector3f, normals, at), dr.gather(mi.Vector3f, eyes, at)
    direction = dr.gather(mi.Vector3f, directions, of)
    cosine = dr.dot(normal, direction)
    lit = cosine > 0
    share = cosine * dr.gather(mi.Float, solid_angles, of, lit)
    alpha = float(np.asarray(material.roughness))
    lobe = brdf(material.brdf, direction, view, normal, alpha)
    if not diffuse:
        lit &= lobe > _FAINT / alpha**2
    # Off the surface by what rounding may put a point below it.
    above = 1e-5 * float(np.linalg.norm(np.subtract(loaded.bbox().max, loaded.bbox().min)))
    origin = mi.Point3f(dr.gather(mi.Vector3f, places, at, lit) + above * normal)
    lit &= ~loaded.ray_test(mi.Ray3f(origin, direction), lit)
    share = dr.select(lit, share, 0.0)
    lobe = lobe * share
    dr.eval(share, lobe)
    none = np.zeros((count, light.shape[1]), np.float32)
    return (
        np.array(share).reshape(count, texels) @ light / np.float32(np.pi) if diffuse else none,
        np.array(lobe).reshape(count, texels) @ light if gloss else none,
    )


@cache
def _sky(n: int):
    """Directions and solid angles of a cube's texels, in Mitsuba's arrays."""
    mi = mitsuba()
    directions = np.ascontiguousarray(cubes.directions(n).reshape(-1, 3).T, np.float32)
    solid_angles = np.tile(cubes.solid_angles(n).ravel(), 6).astype(np.float32)
    return mi.Vector3f(directions), mi.Float(solid_angles)


def brdf(name: str, light, view, normal, alpha: float):
    """A BRDF over rho_s in Mitsuba's arrays; all vectors unit, light and view above the surface.

    As in Mitsuba's own plugins, over the slopes of the half vector: the papers' forms are in
    benchmarks/quadrature.py.
    """
    import drjit as dr

    assert name in BRDFS, name
    h = dr.normalize(light + view)
    n_h, n_l, n_v = (dr.maximum(dr.dot(a, normal), 1e-6) for a in (h, light, view))
    h_l = dr.maximum(dr.dot(h, light), 1e-6)
    tan2 = (1 - n_h * n_h) / (n_h * n_h)
    if name == "ggx":
        density = 1 / (dr.pi * alpha**2 * n_h**4 * dr.square(1 + tan2 / alpha**2))

        def toward(c):
            return c + dr.sqrt(alpha**2 + (1 - alpha**2) * c * c)

        # G_2 / (4 cos cos) as J. Dupuy writes it: 1 / (2 (n_l root_v + n_v root_l))
        root_l, root_v = toward(n_l) - n_l, toward(n_v) - n_v
        return density / (2 * (n_l * root_v + n_v * root_l))
    slopes = dr.exp(-tan2 / alpha**2) / (dr.pi * alpha**2)
    if name == "ward1992":
        return slopes / (4 * dr.sqrt(n_l * n_v))
    return slopes / (4 * dr.square(h_l) * dr.square(dr.square(n_h)))


# ------------------------------------------------------------------------- in the path tracer


def _bsdf(material: Material, triple) -> dict[str, Any]:
    def three(values):
        return mitsuba().ScalarColor3f(*(float(v) for v in np.asarray(values)[triple]))

    return {
        "type": "six_gloss",
        "diffuse": {"type": "rgb", "value": three(material.diffuse)},
        "specular": {"type": "rgb", "value": three(material.specular)},
        "alpha": float(np.asarray(material.roughness)),
        "brdf": material.brdf,
    }


@cache
def gloss_bsdf():
    """A matt body under a gloss as Mitsuba's plugin `six_gloss`: diffuse, specular, alpha, brdf."""
    mi = mitsuba()
    import drjit as dr

    class Gloss(mi.BSDF):  # type: ignore[name-defined]
        def __init__(self, properties):
            super().__init__(properties)
            self.diffuse = mi.Color3f(properties["diffuse"])
            self.specular = mi.Color3f(properties["specular"])
            self.alpha = mi.Float(properties["alpha"])
            self.brdf = properties["brdf"]
            # Of the samples, how many go to the gloss.
            body, shine = dr.mean(self.diffuse), dr.mean(self.specular)
            self.share = 0.2 + 0.6 * shine / dr.maximum(body + shine, 1e-6)
            # Numbers out of the code: it is compiled once for all materials of one BRDF.
            dr.make_opaque(self.diffuse, self.specular, self.alpha, self.share)
            front = mi.BSDFFlags.FrontSide
            self.m_components = [mi.BSDFFlags.DiffuseReflection | front]
            self.m_components += [mi.BSDFFlags.GlossyReflection | front]
            self.m_flags = self.m_components[0] | self.m_components[1]

        def _density(self, si, wo):
            h = dr.normalize(wo + si.wi)
            tan2 = (1 - h.z * h.z) / (h.z * h.z)
            lobe = dr.exp(-tan2 / self.alpha**2) / (dr.pi * self.alpha**2)
            return lobe / (4 * dr.maximum(dr.dot(h, wo), 1e-6) * h.z * h.z * h.z)

        def sample(self, context, si, sample1, sample2, active=True):
            glossy = active & (sample1 < self.share)
            slope = self.alpha * dr.sqrt(-dr.log(1 - sample2.x))
            sin, cos = dr.sincos(2 * dr.pi * sample2.y)
            h = dr.normalize(mi.Vector3f(slope * cos, slope * sin, 1))
            mirrored = 2 * dr.dot(h, si.wi) * h - si.wi
            wo = dr.select(glossy, mirrored, mi.warp.square_to_cosine_hemisphere(sample2))
            out = mi.BSDFSample3f()
            out.wo = wo
            out.pdf = self.pdf(context, si, wo, active)
            out.eta = 1.0
            out.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
            out.sampled_component = mi.UInt32(0)
            active &= out.pdf > 0
            return out, dr.select(active, self.eval(context, si, wo, active) / out.pdf, 0.0)

        def eval(self, context, si, wo, active=True):
            up = mi.Vector3f(0, 0, 1)
            active &= (si.wi.z > 0) & (wo.z > 0)
            value = self.diffuse / dr.pi
            value += self.specular * brdf(self.brdf, wo, si.wi, up, self.alpha)
            return dr.select(active, value * wo.z, 0.0)

        def pdf(self, context, si, wo, active=True):
            active &= (si.wi.z > 0) & (wo.z > 0)
            even = mi.warp.square_to_cosine_hemisphere_pdf(wo)
            return dr.select(
                active, self.share * self._density(si, wo) + (1 - self.share) * even, 0.0
            )

        def eval_pdf(self, context, si, wo, active=True):
            return self.eval(context, si, wo, active), self.pdf(context, si, wo, active)

        def to_string(self):
            return f"Gloss[{self.brdf}, alpha = {self.alpha}]"

    mi.register_bsdf("six_gloss", lambda properties: Gloss(properties))
    return Gloss
