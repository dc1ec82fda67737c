"""The render: its error in CIEDE2000 against exact integrals and full spectra, and what it costs.

Everything is drawn at one point a pixel, so that a pixel has one right value. Costs are CPU seconds
and ratios within this run. White is what a small white sphere scatters on the whole, adapted from
by CAT02, unless a line says otherwise.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks import quadrature, worlds
from benchmarks.figure import Figure
from benchmarks.reference import Picture, camera_rays
from calibration import metamers, primaries, sets
from calibration.adaptation import D65, cat02
from calibration.difference import delta_e_2000, lab
from calibration.errors import InputError
from calibration.primaries import Primaries
from stages import opengl, scenes, shadows
from stages.light import Light, Parts, light
from stages.meshes import sphere
from stages.prefilter import mean
from stages.preview import Drawing, draw_times, preview, sequence
from stages.scene import Camera, Material, Scene
from stages.trichromatic import SPACES, Trichromatic

ALPHAS = (0.05, 0.1, 0.2, 0.3, 0.5)
GLOSS = 0.045  # rho_s of paint and plastic
METAL = 0.6
SAMPLES, METAL_SAMPLES = 32, 64
SIZE = 384  # px, of the sphere's pictures
PLACES = 120  # pixels of each that are integrated exactly
FINER = 5  # pixels of a scene's picture to one that is compared
SEED = 4

CAMERA = Camera((0.0, 0.0, 40.0), (0.0, 0.0, 0.0), 3.2)  # a sphere of radius 1 fills the picture


def measure() -> Iterator[Figure]:
    fireflies = Fireflies()
    yield from _against_quadrature(fireflies)
    yield from _at_equal_error()
    yield from _metamers(fireflies)
    try:
        yield from _in_scene(fireflies)
    except InputError as error:
        print(f"left out, the pictures against full spectra: {error}", file=sys.stderr)
    yield Figure("fireflies in all of these pictures", fireflies.count, "pixels", high=0)
    yield _the_same_twice()
    yield from _frame_times()


# ------------------------------------------------------------------------------- colour and pixels


def difference(xyz, reference, white):
    """CIEDE2000 (...) of XYZ (..., 3) from a reference's, both adapted from a white (..., 3)."""
    white = np.asarray(white, np.float64)
    if white.ndim == 1:
        to_daylight = cat02(white, D65).T / white[1]
        return delta_e_2000(lab(xyz @ to_daylight), lab(reference @ to_daylight))
    each = np.stack([cat02(w, D65).T / w[1] for w in white])
    return delta_e_2000(*(lab(np.einsum("ni,nij->nj", c, each)) for c in (xyz, reference)))


class Fireflies:
    """Counts pixels over three times as bright as any neighbour, where the reference is not so."""

    def __init__(self) -> None:
        self.count = 0

    def look_at(self, y, seen, reference=None) -> None:
        """y (H, W) luminance, seen (H, W) where to look, reference (H, W) or None: smooth."""
        found = seen & self._stands_out(np.asarray(y))
        if reference is not None:
            found &= ~self._stands_out(np.asarray(reference))
        self.count += int(found[1:-1, 1:-1].sum())

    @staticmethod
    def _stands_out(y):
        around = [np.roll(y, (a, b), axis=(0, 1)) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b]
        return y > 3 * np.maximum(np.max(around, axis=0), 1e-12)


@dataclass(frozen=True)
class Places:
    """Pixels of the sphere's picture: rows, columns (K,), normals and views (K, 3)."""

    rows: Any
    columns: Any
    normals: Any
    views: Any

    def only(self, which) -> Places:
        """Some of them: (K,) of truth values."""
        return Places(self.rows[which], self.columns[which], self.normals[which], self.views[which])

    def of(self, picture):
        return np.asarray(picture[self.rows, self.columns], np.float64)


def sphere_places(count: int, size: int, least_cosine: float = 0.0) -> Places:
    """Pixels drawn evenly from all in which the unit sphere is seen."""
    rays = camera_rays(CAMERA, size, size)
    eye = np.asarray(CAMERA.eye)
    b = rays @ eye
    root = b * b - (eye @ eye - 1)
    normals = eye - rays * (b + np.sqrt(np.maximum(root, 0)))[..., None]
    facing = -np.einsum("yxi,yxi->yx", normals, rays)
    # The mesh has flat facets: its outline is a hair inside the sphere's.
    rows, columns = np.nonzero((root > 0) & (facing > max(least_cosine, 0.06)))
    which = np.random.default_rng(SEED).choice(len(rows), count, replace=False)
    rows, columns = rows[which], columns[which]
    normals = normals[rows, columns]
    return Places(
        rows,
        columns,
        normals / np.linalg.norm(normals, axis=1, keepdims=True),
        -rays[rows, columns],
    )


def ball(diffuse, specular, alpha: float) -> Scene:
    """A sphere with reflectances (C,), for CAMERA."""
    return Scene(((sphere(segments=96), Material(diffuse, specular, alpha)),), CAMERA)


# ----------------------------------------------------------------------------- against quadrature


@dataclass(frozen=True)
class Shown:
    """What a sphere's pixels show in each channel, of a white diffuser and of rho_s = 1.

    Pictures are linear in both: any colour is made of these, as the shader makes it.
    """

    diffuse: Any  # (K, C)
    gloss: dict[float, Any]  # by alpha

    def xyz(self, alpha: float, diffuse, specular, matrix):
        """XYZ (M, K, 3) of M materials, diffuse (M, C), specular (M, C)."""
        channels = diffuse[:, None] * self.diffuse + specular[:, None] * self.gloss[alpha]
        return channels @ np.transpose(matrix)


def drawn(
    environment: Light, places: Places, alphas, samples: int, fireflies: Fireflies | None = None
) -> Shown:
    """The shader's parts; every channel is read by a matrix to "XYZ" that picks three of them."""
    channels = environment.channels
    none, all_ = np.zeros(channels), np.ones(channels)
    todo = [ball(all_, none, 0.3)] + [ball(none, all_, alpha) for alpha in alphas]
    parts = [np.zeros((len(places.rows), channels)) for _ in todo]
    for first in range(0, channels, 3):
        picks = np.eye(channels)[first : first + 3]
        with closing(
            sequence(
                environment, picks, todo, Drawing(SIZE, SIZE, samples=samples, supersampling=1)
            )
        ) as pictures:
            for part, picture in zip(parts, pictures, strict=True):
                part[:, first : first + 3] = places.of(picture)
                if fireflies is not None:
                    fireflies.look_at(picture.sum(axis=-1), _inside(SIZE))
    return Shown(parts[0], dict(zip(alphas, parts[1:], strict=True)))


def exact(cube, places: Places, alphas) -> Shown:
    """The same by quadrature."""
    return Shown(
        quadrature.diffuse(cube, places.normals),
        {a: quadrature.gloss(cube, places.normals, places.views, a) for a in alphas},
    )


def _inside(size: int):
    """Pixels (size, size) well within the sphere's outline."""
    x = np.arange(size) - (size - 1) / 2
    half = np.tan(np.radians(CAMERA.vertical_view_deg) / 2) * np.linalg.norm(CAMERA.eye)
    return np.hypot(x, x[:, None]) * 2 / size * half < 0.97


def _against_quadrature(fireflies: Fireflies) -> Iterator[Figure]:
    light_in = primaries.load()
    matrix = light_in.xyz_from_primaries
    patches = light_in.project(sets.surfaces("colorchecker24").values.T)
    paint = np.full_like(patches, GLOSS)
    places = sphere_places(PLACES, SIZE)
    for name in ("room", "sun", "window", "uniform"):
        cube = light_in.project(getattr(worlds, name)()).astype(np.float32)
        white = matrix @ mean(cube)
        environment = light(cube)
        right = exact(cube, places, ALPHAS)
        found = drawn(environment, places, ALPHAS, SAMPLES, fireflies)
        shiny = drawn(environment, places, ALPHAS, METAL_SAMPLES, fireflies)
        errors = {
            a: difference(
                found.xyz(a, patches, paint, matrix), right.xyz(a, patches, paint, matrix), white
            )
            for a in ALPHAS
        }
        every = np.stack(list(errors.values()))
        label = f"{name}, ColorChecker, N = {SAMPLES}"
        yield Figure(f"{label}, mean", float(every.mean()), "dE", high=0.35)
        yield Figure(f"{label}, 95th percentile", float(np.percentile(every, 95)), "dE", high=1.0)
        worst = max(ALPHAS, key=lambda a: float(errors[a].mean()))
        yield Figure(
            f"{label}, mean at the worst alpha, {worst:g}", float(errors[worst].mean()), "dE"
        )
        sums = np.array(
            [[(shown.gloss[a] @ matrix[1]).sum() for a in ALPHAS] for shown in (found, right)]
        )
        whole = float(sums[0].sum() / sums[1].sum())
        yield Figure(f"{name}, energy of the gloss", whole, "", 0.99, 1.01)
        # Of few pixels, a lamp in a narrow lobe is met by two or three.
        each = sums[0] / sums[1]
        furthest = int(np.argmax(np.abs(each - 1)))
        yield Figure(f"  furthest of all alphas, {ALPHAS[furthest]:g}", float(each[furthest]))
        metal = np.full((1, len(light_in.channels)), METAL)
        errors_of_metal = [
            difference(
                shiny.xyz(a, 0 * metal, metal, matrix),
                right.xyz(a, 0 * metal, metal, matrix),
                white,
            )
            for a in ALPHAS
        ]
        yield Figure(
            f"{name}, metal, N = {METAL_SAMPLES}, mean", float(np.mean(errors_of_metal)), "dE",
            high=0.8,
        )  # fmt: skip
        matt = difference(
            found.xyz(ALPHAS[0], patches, 0 * paint, matrix),
            right.xyz(ALPHAS[0], patches, 0 * paint, matrix),
            white,
        )
        yield Figure(f"{name}, diffuse alone, mean", float(matt.mean()), "dE", high=0.03)
        yield Figure(f"{name}, diffuse alone, greatest", float(matt.max()), "dE", high=0.5)
        if name == "uniform":
            off = float(np.abs(found.diffuse / cube[0, 0, 0] - 1).max())
            yield Figure("uniform, a white diffuser's departure from 1", 100 * off, "%", high=0.01)


# -------------------------------------------------------------------------------- at equal error


def _at_equal_error() -> Iterator[Figure]:
    """The bundled room, alpha .3, ColorChecker colours, one picture of SIZE^2 each."""
    alpha = 0.3
    light_in = primaries.load("darling2011")  # no negative light, which Mitsuba refuses
    matrix = light_in.xyz_from_primaries
    patches = light_in.project(sets.surfaces("colorchecker24").values.T)
    paint = np.full_like(patches, GLOSS)
    cube = light_in.project(worlds.room()).astype(np.float32)
    white = matrix @ mean(cube)
    environment = light(cube)
    # One level, no lamps: every sample fetches a single texel of the whole map.
    no_lights = np.zeros((0, 3), np.float32), np.zeros((0, 6), np.float32)
    single = Parts([cube], *no_lights)
    plain = Light(single, single, single, environment.matt)
    places = sphere_places(PLACES, SIZE, least_cosine=0.2)
    right = exact(cube, places, [alpha]).xyz(alpha, patches, paint, matrix)

    def error(way: Light, samples: int) -> float:
        found = drawn(way, places, [alpha], samples).xyz(alpha, patches, paint, matrix)
        return float(difference(found, right, white).mean())

    def seconds(way: Light, samples: int) -> float:
        k = way.channels
        material = ball(patches[21][:k], paint[21][:k], alpha)
        return _cpu_seconds(way, matrix[:, :k], material, samples)

    ours, our_error = seconds(environment, SAMPLES), error(environment, SAMPLES)
    yield Figure(f"room, alpha .3, N = {SAMPLES}, mean", our_error, "dE")
    yield Figure(f"  a picture of {SIZE} x {SIZE} px, CPU", 1000 * ours, "ms")
    needed = _samples_for(our_error, lambda n: error(plain, n), (64, 256, 1024))
    yield Figure("  unfiltered samples for the same error, as 64 to 1024 fall", needed, "")
    theirs = seconds(plain, 256)
    fixed = seconds(plain, 1)
    theirs = fixed + (theirs - fixed) * (needed - 1) / 255
    yield Figure("CPU of unfiltered samples over ours", theirs / ours, "times", low=15)
    three = seconds(light(cube[..., :3]), SAMPLES)
    yield Figure("CPU of six channels over three", ours / three, "times", high=1.8)

    goal = 0.33
    fewest = next(
        n for n in (1, 2, 4, 8, 16, SAMPLES) if n == SAMPLES or error(environment, n) <= goal
    )
    ours = seconds(environment, fewest)
    try:
        theirs = _mitsuba_seconds(cube, alpha, patches, paint, matrix, white, places, right, goal)
    except InputError as problem:
        print(f"left out, the comparison with Mitsuba: {problem}", file=sys.stderr)
        return
    yield Figure(f"  samples for {goal} dE", fewest, "")
    yield Figure(f"CPU of Mitsuba (llvm) over ours at {goal} dE", theirs / ours, "times", low=40)


def _cpu_seconds(environment: Light, matrix, scene: Scene, samples: int, count: int = 3) -> float:
    """CPU seconds of one picture, programs and uploads done: the least of a few."""
    took = []
    how = Drawing(SIZE, SIZE, samples=samples, supersampling=1)
    with closing(sequence(environment, matrix, [scene] * (count + 1), how)) as pictures:
        next(pictures)
        for _ in range(count):
            began = time.process_time()
            next(pictures)
            took.append(time.process_time() - began)
    return min(took)


def _samples_for(goal: float, error, counts: Sequence[int]) -> float:
    """How many samples bring an error that falls as a power of them down to a goal."""
    found = [error(n) for n in counts]
    slope, level = np.polyfit(np.log(counts), np.log(found), 1)
    return float(np.exp((np.log(goal) - level) / slope))


def _mitsuba_seconds(cube, alpha, patches, paint, matrix, white, places, right, goal) -> float:
    """CPU seconds Mitsuba's path tracer takes for an error, without what it takes to begin.

    Two passes, for six channels. A sphere of a grey paint, whose errors are as those of the 24.
    """
    from benchmarks import reference

    few, many = 16, 64
    grey = 21  # neutral 6.5
    scene = ball(patches[grey], paint[grey], alpha)

    def run(samples: int):
        began = time.process_time()
        picture = reference.traced(cube, scene, width=SIZE, height=SIZE, samples=samples, seed=SEED)
        return picture, time.process_time() - began

    run(few)  # compiles
    pictures, took = zip(*(run(n) for n in (few, many)), strict=True)
    errors = [
        float(difference(places.of(p) @ matrix.T, right[grey], white).mean()) for p in pictures
    ]
    needed = _samples_for(
        goal, dict(zip((few, many), errors, strict=True)).__getitem__, (few, many)
    )
    a_sample = (took[1] - took[0]) / (many - few)
    return needed * a_sample


# ---------------------------------------------------------------------------------------- metamers


def _metamers(fireflies: Fireflies) -> Iterator[Figure]:
    """Two paints on the same sphere between two windows: each side sees one light alone.

    They match under tungsten light (A), at the right, and part by daylight (D65), at the left.
    Colours are adapted from the light on the spot.
    """
    light_in = primaries.load()
    lamp, daylight = (np.asarray(sets.lights("darling2011")[n]) for n in ("A", "D65"))
    paints = metamers.pair(lamp, daylight, light_in, seed=1).paints.values.T
    world = worlds.two_lights(daylight, lamp)
    gloss = np.full(world.shape[-1], GLOSS)
    places = sphere_places(4 * PLACES, SIZE)
    places = places.only(np.abs(places.normals[:, 0]) > 0.55)
    lit = {"match": places.normals[:, 0] > 0, "part": places.normals[:, 0] < 0}
    matt = quadrature.diffuse(world, places.normals)
    shine = quadrature.gloss(world, places.normals, places.views, 0.2)
    whites = sets.xyz(matt)

    def apart(first, second, side: str) -> float:
        """Mean over the pixels where one light shines."""
        spots = lit[side]
        return float(difference(first[spots], second[spots], whites[spots]).mean())

    exactly = [sets.xyz(paint * matt + GLOSS * shine) for paint in paints]
    pictures = {}
    for way in ("six", "sharp"):
        shown = [in_channels(way, world, ball(paint, gloss, 0.2)) for paint in paints]
        cube, matrix, _ = shown[0]
        todo = [scene for _, _, scene in shown]
        how = Drawing(SIZE, SIZE, supersampling=1)
        with closing(sequence(cube, matrix, todo, how)) as drawn_:
            both = list(drawn_)
        for picture in both:
            fireflies.look_at(picture[..., 1], _inside(SIZE))
        pictures[way] = [places.of(picture) for picture in both]
    for way, name, match, part in (
        ("exact", "full spectra", 1.2, 10.0),
        ("six", "six channels", 1.2, 10.0),
        ("sharp", "sharp RGB", None, None),
    ):
        first, second = exactly if way == "exact" else pictures[way]
        low = 5.0 if way == "sharp" else None
        yield Figure(
            f"metamers under A, {name}: they differ by", apart(first, second, "match"), "dE",
            low, match,
        )  # fmt: skip
        yield Figure(f"  and under D65, {name}", apart(first, second, "part"), "dE", part)
    held = [
        apart(shown, true, side)
        for shown, true in zip(pictures["six"], exactly, strict=True)
        for side in lit
    ]
    yield Figure("metamers, six channels from full spectra, at most", max(held), "dE", high=1.2)


# ------------------------------------------------------------------- scenes against full spectra


@dataclass(frozen=True)
class Compared:
    """A scene's picture in full spectra, and in few channels; XYZ (H, W, 3) each.

    truth     with what things reflect onto one another
    direct    without: what is hidden from the environment is black there
    pictures  by way of rendering: the shaders'
    exact     by way of rendering: as `direct`, but for the channels
    things    (H, W) where a thing is seen, outlines left out
    white     (3,)
    """

    truth: Any
    direct: Any
    pictures: dict[str, Any]
    exact: dict[str, Any]
    things: Any
    white: Any

    def errors(self, way: str):
        """CIEDE2000 (H, W) of the shaders' picture; NaN where no thing is."""
        apart = difference(self.pictures[way], self.truth, self.white)
        return np.where(self.things, apart, np.nan)

    def colour_errors(self, way: str):
        """Likewise of the channels alone: shading is exact, and the same."""
        apart = difference(self.exact[way], self.direct, self.white)
        return np.where(self.things, apart, np.nan)


WAYS = {
    "six": "six channels",
    "darling2011": "six channels, darling2011",
    "sharp": "three: sharp RGB",
    "xyz": "three: XYZ",
}


def compare(
    world, scene: Scene, *, width: int, height: int, bounces: int = 3, samples: int = 36,
    ways=tuple(WAYS),
) -> Compared:  # fmt: skip
    """Pictures of a spectral scene in a spectral world, by Mitsuba and by the shaders.

    world    (6, N, N, 36)
    scene    its materials of 36 wavelengths
    bounces, samples  of light from thing to thing, and paths a pixel to find it
    ways     keys of WAYS
    Raises InputError where Mitsuba or its LLVM is missing.
    """
    from benchmarks import reference

    size: dict[str, Any] = {"width": width, "height": height}
    shown = {way: in_channels(way, world, scene) for way in ways}
    # All channels of all ways at once: geometry and visibility are found once.
    cubes = [world, *(cube for cube, _, _ in shown.values())]
    together = [scene, *(s for _, _, s in shown.values())]
    drawn_ = reference.render(np.concatenate(cubes, axis=-1), _stacked(together), **size)
    ends = np.cumsum([cube.shape[-1] for cube in cubes])
    spectra, *few = np.split(drawn_.radiance.astype(np.float64), ends[:-1], axis=-1)
    between = (
        reference.indirect(world, scene, drawn_, bounces=bounces, samples=samples) if bounces else 0
    )
    return Compared(
        truth=sets.xyz(spectra + between),
        direct=sets.xyz(spectra),
        pictures={way: _at_the_rays(*parts, **size) for way, parts in shown.items()},
        exact={
            way: radiance @ matrix.T
            for (way, (_, matrix, _)), radiance in zip(shown.items(), few, strict=True)
        },
        things=_within(drawn_),
        white=sets.xyz(mean(np.asarray(world, np.float64))),
    )


def _at_the_rays(cube, matrix, scene: Scene, width: int, height: int):
    """The shaders' picture (H, W, 3) at the very middles of the pixels.

    They make highlights as broad as a pixel sees them, the reference does not: so theirs is drawn
    with pixels a fifth as wide, of which every fifth is the middle of one of these.
    """
    shade = shadows.shade(scene, cube)
    how = Drawing(FINER * width, FINER * height, quality=4.0, supersampling=1)
    picture = preview(cube, matrix, scene, how, shade=shade)
    return picture[FINER // 2 :: FINER, FINER // 2 :: FINER].astype(np.float64)


def in_channels(way: str, world, scene: Scene):
    """A spectral world and scene in one of WAYS: cube, matrix to XYZ, scene."""
    light_in = primaries.load(way) if way == "darling2011" else primaries.load()
    cube = light_in.project(world).astype(np.float32)
    scene = in_primaries(scene, light_in)
    if way not in SPACES:
        return cube, light_in.xyz_from_primaries, scene
    three = Trichromatic.named(way, light_in)
    return three.light(cube), three.xyz_from_channels, three.scene(scene)


def _stacked(several: Sequence[Scene]) -> Scene:
    """One scene of many that differ in their channels, all their channels side by side."""
    things = []
    for thing in zip(*(s.things for s in several), strict=True):
        mesh, material = thing[0]
        diffuse, specular = (
            np.concatenate([getattr(m, name) for _, m in thing]) for name in ("diffuse", "specular")
        )
        things.append((mesh, replace(material, diffuse=diffuse, specular=specular)))
    return replace(several[0], things=tuple(things))


def in_primaries(scene: Scene, light_in: Primaries) -> Scene:
    """A scene of spectral materials, in a set of primaries."""

    def project(material: Material) -> Material:
        both = (light_in.project(v) for v in (material.diffuse, material.specular))
        diffuse, specular = both
        return replace(material, diffuse=diffuse, specular=specular)

    return replace(scene, things=tuple((mesh, project(m)) for mesh, m in scene.things))


def _within(truth: Picture):
    """Where a pixel and its eight neighbours are of one thing: outlines are a matter of a ray."""
    around = [np.roll(truth.thing, (a, b), axis=(0, 1)) for a in (-1, 0, 1) for b in (-1, 0, 1)]
    inside = (truth.thing > 0) & (np.min(around, axis=0) == np.max(around, axis=0))
    inside[[0, -1]] = inside[:, [0, -1]] = False
    return inside


def chart(alpha: float = 0.1) -> Scene:
    """The 24 glossy spheres, their materials of 36 wavelengths."""
    patches = sets.surfaces("colorchecker24").values.T
    gloss = np.full(patches.shape[1], GLOSS)
    spheres = [Material(patch, gloss, alpha) for patch in patches]
    return scenes.grid([spheres[k : k + 6] for k in range(0, 24, 6)])


def teapot() -> Scene:
    """The teapot of the previews in 36 wavelengths: red, on a grey stand."""
    patches = sets.surfaces("colorchecker24")
    grey = np.ones(len(patches["15"]))
    return scenes.teapot(
        body=Material(patches["15"], GLOSS * grey, 0.1),
        stand=Material(patches["21"], 0.03 * grey, 0.15),
    )


def _in_scene(fireflies: Fireflies) -> Iterator[Figure]:
    world = worlds.room()
    for name, scene, width, height, ways, bounds in (
        ("ColorChecker", chart(), 96, 66, tuple(WAYS), {"six": 0.35, "darling2011": 0.6}),
        ("teapot", teapot(), 84, 70, ("six", "sharp"), {}),
    ):
        found = compare(world, scene, width=width, height=height, ways=ways)
        for way in ways:
            label = f"{name} in the room, {WAYS[way]}"
            alone, whole = found.colour_errors(way), found.errors(way)
            yield Figure(f"{label}, mean", float(np.nanmean(alone)), "dE", high=bounds.get(way))
            yield Figure("  95th percentile", float(np.nanpercentile(alone, 95)), "dE")
            yield Figure("  shadows, bounces and all, mean", float(np.nanmean(whole)), "dE")
            yield Figure("  95th percentile", float(np.nanpercentile(whole, 95)), "dE")
            fireflies.look_at(found.pictures[way][..., 1], found.things, found.truth[..., 1])


# ---------------------------------------------------------------------------------------- the rest


def _teapot_in_six():
    light_in = primaries.load()
    cube = light_in.project(worlds.room()).astype(np.float32)
    return cube, light_in.xyz_from_primaries, in_primaries(teapot(), light_in)


def _the_same_twice() -> Figure:
    cube, matrix, scene = _teapot_in_six()
    shade = shadows.shade(scene, cube)
    first, second = (preview(cube, matrix, scene, Drawing(160, 120), shade=shade) for _ in "ab")
    differing = int((first.view(np.uint32) != second.view(np.uint32)).any(axis=-1).sum())
    return Figure("pixels that differ when rendered again", differing, "pixels", high=0)


def _frame_times() -> Iterator[Figure]:
    """The teapot, 512 x 512, shadows and all, by each device's own clock."""
    cube, matrix, scene = _teapot_in_six()
    environment = light(cube)
    shade = shadows.shade(scene, cube)
    for device in opengl.devices():
        how = Drawing(512, 512, device=device.number)
        times = draw_times(environment, matrix, scene, 3, how, shade=shade)
        name = f"a frame of 512 x 512, {device.renderer[:32]}"
        yield Figure(name, 1000 * float(np.median(times)), "ms")
