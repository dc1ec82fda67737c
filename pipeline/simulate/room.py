"""A furnished living room: window on the left, a lamp on the right, a steel sphere in the middle.

Coordinates are metres: x to the right as the camera sees it, y up from the floor, z toward the
camera. The sphere hangs over the origin of the floor. What it mirrors is mostly what is behind the
camera, so the room is furnished all round. Everything but the sphere is matte, and three things
give light: the view outside the window, the lamp's bulb and the inside of its shade.

Every colour is written as sRGB for the reader and rendered with the measured reflectance nearest
to it (`materials.paint`).
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.spectra import WAVELENGTHS
from pipeline.simulate.camera import Camera
from pipeline.simulate.materials import blackbody, daylight, paint, stainless_steel
from pipeline.simulate.render import Scene, Surface, View, blocked, normals
from stages import cube

Shapes = list[Any]  # of surfaces, lights, and lists of such

SPHERE = (0.0, 1.25, 0.0)
SPHERE_RADIUS = 0.05
SPHERE_DISTANCE = 1.5

# inner faces of the walls
LEFT, RIGHT, BACK, FRONT, CEILING = -2.3, 2.5, -2.6, 3.2, 2.6
WINDOW_Z = (-0.45, 1.55)
WINDOW_Y = (0.88, 2.3)

BULB_LUMINANCE = 1.0e5  # cd/m2; a clear-topped 40 W bulb, small
BULB_RADIUS = 0.016
BULB_KELVIN = 2856.0
BULB = np.array([1.3, 1.36, 0.5])

BLACK_PAINT = np.full(len(WAVELENGTHS), 0.02)
BLACK = {"type": "diffuse", "reflectance": BLACK_PAINT}


def view(camera: Camera, yaw_deg: float = 0.0) -> View:
    """Where the camera stands: 1.5 m from the sphere, a little above, not aimed quite at it.

    yaw_deg  about the sphere, to the right as the camera at 0 sees it
    """
    from_sphere = SPHERE_DISTANCE * np.array(
        [0.0, np.sin(np.radians(4.0)), np.cos(np.radians(4.0))]
    )
    aside = np.array([-0.0046, -0.0031, 0.0])
    eye, target = (np.add(SPHERE, _about_y(v, yaw_deg, 0.0)) for v in (from_sphere, aside))
    return View(
        sphere=SPHERE,
        radius=SPHERE_RADIUS,
        eye=(float(eye[0]), float(eye[1]), float(eye[2])),
        target=(float(target[0]), float(target[1]), float(target[2])),
        focal_px=camera.focal_px,
        width=camera.width,
        height=camera.height,
    )


def room() -> Scene:
    """The spectral scene (see `render`) without sphere and stand."""
    rng = np.random.default_rng(7)
    built = [build(rng) for build in (
        _shell, _outside, _window, _floor, _bookshelf, _door, _back_wall, _sofa, _armchair,
        _dining_table, _lamp, _plant, _right_wall, _ceiling_lamp,
    )]  # fmt: skip
    return _scene(built)


def sphere_on_stand() -> Scene:
    """The same room with the mirror sphere and the thin dark rod that carries it."""
    index = stainless_steel()
    steel = {"type": "conductor", "eta": index.real, "k": index.imag}
    sphere = {"type": "sphere", "center": list(SPHERE), "radius": SPHERE_RADIUS, "bsdf": steel}
    bare = room()
    return bare | {"sphere": sphere, "surfaces": [*bare["surfaces"], *_stand()]}


def without_sphere(scene: Scene) -> Scene:
    """`sphere_on_stand`, perhaps lit, with sphere and stand taken away again."""
    bare = {name: item for name, item in scene.items() if name != "sphere"}
    return bare | {"surfaces": scene["surfaces"][: -len(_stand())]}


def visible(view: View, face_size: int, world_axes=None) -> NDArray[np.bool_]:
    """Which texels (6, N, N) of the truth the sphere shows: not those behind it or its stand's.

    world_axes  of the truth, as `View.world_axes`; the view's own where left out
    """
    directions = cube.directions(face_size).reshape(-1, 3)
    if world_axes is not None:
        directions = directions @ world_axes @ view.world_axes.T
    blind = np.arcsin(view.radius / view.distance)  # the cone the sphere covers, behind it
    shown = directions[:, 2] > -np.cos(blind)
    axes = view.world_axes
    eye = np.array([0.0, 0.0, view.distance])
    normal = directions + eye / view.distance
    for _ in range(20):  # the normal halves the angle between the direction and the way to the eye
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
        to_eye = eye - view.radius * normal
        normal = directions + to_eye / np.linalg.norm(to_eye, axis=1, keepdims=True)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    place = np.asarray(view.sphere) + view.radius * 1.001 * normal @ axes
    stand = {"type": "scene", "surfaces": _stand()}
    return (shown & ~blocked(stand, place, directions @ axes)).reshape(6, face_size, face_size)


def _stand() -> list[Surface]:
    x, y, z = SPHERE
    top = y - SPHERE_RADIUS * 0.985
    black = paint("#2a2a2c")
    rods = [
        rod((x, 0.12, z), (x, top, z), 0.003, black),
        rod((x, top - 0.01, z), (x, top + 0.001, z), 0.005, black),
        *(rod((x, 0.30, z), (x + 0.3 * np.sin(a), 0.01, z + 0.3 * np.cos(a)), 0.007, black)
          for a in np.radians([0.0, 120.0, 240.0])),
    ]  # fmt: skip
    return [part for part in _flat(rods) if isinstance(part, Surface)]


def _scene(shapes: Shapes) -> Scene:
    parts = list(_flat(shapes))
    lights = [part for part in parts if isinstance(part, dict)]
    return {
        "type": "scene",
        "surfaces": [part for part in parts if isinstance(part, Surface)],
        **{f"light_{i}": light for i, light in enumerate(lights)},
    }


def _flat(shapes: Shapes) -> Iterator[Surface | Scene]:
    for shape in shapes:
        if isinstance(shape, list):
            yield from _flat(shape)
        else:
            yield shape


# --- how things are made ------------------------------------------------------------------------


def _sheet(points, reflectance, smooth=False) -> list[Surface]:
    """Something thin that is seen from both sides: two surfaces a millimetre apart."""
    front = Surface(np.asarray(points, np.float64), reflectance, smooth)
    apart = front.points - 1e-3 * normals(front.points)
    back = front.reflectance if front.reflectance.ndim == 1 else front.reflectance[:, ::-1]
    return [front, Surface(apart[:, ::-1], back, smooth)]


def _about_y(points, turn, pivot):
    """Points turned by `turn` degrees about a vertical axis through `pivot`."""
    a = np.radians(turn)
    rotation = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    return (np.asarray(points, float) - pivot) @ rotation.T + pivot


def _past(place, x, y, z) -> NDArray[np.float64]:
    """The point so far from a place."""
    return np.asarray(place, float) + np.array([x, y, z])


def box(low, high, colour, turn=0.0, about=None) -> list[Surface]:
    """A box between two corners, turned by `turn` degrees about a vertical axis through `about`."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    pivot = (low + high) / 2 if about is None else np.asarray(about, float)
    faces = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for side in (low, high):
            quad = np.tile(low, (2, 2, 1))
            quad[..., axis] = side[axis]
            quad[:, 1, u] = high[u]
            quad[1, :, v] = high[v]
            if side is low:
                quad = quad[:, ::-1]  # every face looks outward
            faces.append(Surface(_about_y(quad, turn, pivot), colour))
    return faces


def _panel(origin, u, v, colour) -> list[Surface]:
    """A flat rectangle: a corner, and its sides u and v along a texture's columns and rows."""
    origin, u, v = (np.asarray(a, float) for a in (origin, u, v))
    rows, columns = np.shape(colour)[:2] if np.ndim(colour) == 3 else (1, 1)
    across = np.linspace(0, 1, columns + 1)[None, :, None]
    along = np.linspace(0, 1, rows + 1)[:, None, None]
    return [Surface(origin + across * u + along * v, colour)]


def _turned(profile, base, colour, sides=40, smooth=False) -> list[Surface]:
    """A turned shape: `profile` is (n, 2) radius and height, standing on `base`."""
    radius, height = np.asarray(profile, float).T
    if smooth:  # a smooth curve through the profile's points
        from scipy.interpolate import PchipInterpolator

        s = np.arange(len(radius))
        fine = np.linspace(0, s[-1], 8 * len(s))
        radius, height = PchipInterpolator(s, radius)(fine), PchipInterpolator(s, height)(fine)
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    points = np.stack(
        [
            radius[:, None] * np.cos(angle) + base[0],
            np.broadcast_to(height[:, None] + base[1], (len(radius), sides + 1)),
            -radius[:, None] * np.sin(angle) + base[2],
        ],
        axis=-1,
    )
    return [Surface(points, colour, smooth)]


def rod(start, end, radius, colour, sides=16) -> list[Surface]:
    """A closed cylinder from `start` to `end`."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    axis = (end - start) / np.linalg.norm(end - start)
    side = np.cross(axis, (0.0, 0.0, 1.0) if abs(axis[2]) < 0.9 else (1.0, 0.0, 0.0))
    side /= np.linalg.norm(side)
    angle = np.linspace(0, 2 * np.pi, sides + 1)[:, None]
    ring = np.cos(angle) * side + np.sin(angle) * np.cross(axis, side)
    rings = [start + 0 * ring, start + radius * ring, end + radius * ring, end + 0 * ring]
    return [Surface(np.stack(rings), colour)]


def ball(centre, radius, colour) -> list[Surface]:
    return cushion(centre, (radius, radius, radius), colour, power=1.0)


def cushion(centre, half, colour, turn=0.0, tilt=0.0, power=0.55) -> list[Surface]:
    """A rounded block (a superellipsoid), turned about y and tilted about x, degrees."""

    def soft(a):
        return np.sign(a) * np.abs(a) ** power

    lat = np.linspace(-np.pi / 2, np.pi / 2, 25)[:, None]
    lon = np.linspace(-np.pi, np.pi, 49)[None, :]
    points = np.stack(
        [
            half[0] * soft(np.cos(lat)) * soft(np.cos(lon)),
            half[1] * soft(np.sin(lat)) * np.ones_like(lon),
            -half[2] * soft(np.cos(lat)) * soft(np.sin(lon)),
        ],
        axis=-1,
    )
    b = np.radians(tilt)
    about_x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    points = _about_y(points @ about_x.T, turn, np.zeros(3)) + np.asarray(centre, float)
    return [Surface(points, colour, smooth=True)]


def _blend(share, a, b) -> NDArray[np.float32]:
    """Texture (H, W, 36): a where `share` (H, W) is 0, b where it is 1."""
    share = np.clip(share, 0, 1)[..., None]
    return (a * (1 - share) + b * share).astype(np.float32)


def _clouds(rng, shape, octaves=5, stretch=(1, 1)) -> NDArray[np.float64]:
    """Smooth noise (H, W) about 0 with a standard deviation of 1."""
    from scipy.ndimage import zoom

    total = np.zeros(shape)
    for octave in range(octaves):
        cells = [max(2, 2 ** (octave + 1) * s + 1) for s in stretch]
        coarse = rng.standard_normal(cells)
        factor = [n / c for n, c in zip(shape, cells, strict=True)]
        total += zoom(coarse, factor, order=3, grid_mode=True, mode="reflect") / 1.7**octave
    return (total - total.mean()) / total.std()


# --- the room, part by part ---------------------------------------------------------------------


def _shell(rng) -> Shapes:
    """Walls with the window's opening, ceiling, skirting."""
    cream, white = paint("#e6dcc6"), paint("#f2f0ec")
    thick = 0.24
    z0, z1 = WINDOW_Z
    y0, y1 = WINDOW_Y
    outer = LEFT - thick
    pieces: Shapes = [
        box((outer, -0.1, BACK), (LEFT, y0, FRONT), cream),
        box((outer, y1, BACK), (LEFT, CEILING, FRONT), cream),
        box((outer, y0, BACK), (LEFT, y1, z0), cream),
        box((outer, y0, z1), (LEFT, y1, FRONT), cream),
        box((outer, CEILING, BACK), (RIGHT, CEILING + 0.1, FRONT), white),
    ]
    # right: terracotta; its upper part white above a picture rail
    pieces.append(box((RIGHT, -0.1, BACK), (RIGHT + 0.1, 2.15, FRONT), paint("#c98b62")))
    pieces.append(box((RIGHT, 2.15, BACK), (RIGHT + 0.1, CEILING, FRONT), white))
    # back: papered, pale stripes on blue green
    columns = np.arange(480)
    stripes = ((columns // 10) % 3 == 0) * 0.55 + 0.15 * ((columns // 2) % 2)
    paper = _blend(np.tile(stripes, (4, 1)), paint("#5d8f90"), paint("#a9c4bd"))
    pieces.append(_panel((LEFT, 0, BACK), (RIGHT - LEFT, 0, 0), (0, CEILING, 0), paper))
    # front, behind the camera: sage green with a darker dado
    sage, dado = paint("#b7bd98"), paint("#7d8a67")
    pieces.append(box((LEFT, 0.9, FRONT), (RIGHT, CEILING, FRONT + 0.1), sage))
    pieces.append(box((LEFT, 0.0, FRONT), (RIGHT, 0.9, FRONT + 0.1), dado))
    pieces.append(box((LEFT, 0.88, FRONT - 0.02), (RIGHT, 0.94, FRONT), white))
    # skirting boards, picture rail, cornice
    for low, high in (((LEFT, 0, BACK), (RIGHT, 0.1, BACK + 0.015)),
                      ((LEFT, 0, BACK), (LEFT + 0.015, 0.1, FRONT)),
                      ((RIGHT - 0.015, 0, BACK), (RIGHT, 0.1, FRONT)),
                      ((RIGHT - 0.025, 2.12, BACK), (RIGHT, 2.17, FRONT)),
                      ((LEFT, CEILING - 0.06, BACK), (RIGHT, CEILING, BACK + 0.05)),
                      ((LEFT, CEILING - 0.06, FRONT - 0.05), (RIGHT, CEILING, FRONT)),
                      ((LEFT, CEILING - 0.06, BACK), (LEFT + 0.05, CEILING, FRONT)),
                      ((RIGHT - 0.05, CEILING - 0.06, BACK), (RIGHT, CEILING, FRONT))):  # fmt: skip
        pieces.append(box(low, high, white))
    return pieces


def _outside(rng) -> Shapes:
    """What the window looks at, painted on a glowing screen: sky, houses, trees, a lawn.

    Overcast late afternoon: the sky 1000 to 2300 cd/m2, and below it what daylight makes of
    measured reflectances.
    """
    height, width = 250, 300
    y = np.linspace(-0.4, 3.6, height)[:, None]  # of the screen, row 0 at the bottom
    z = np.linspace(-1.9, 2.9, width)[None, :]
    up = np.clip((y - 1.3) / 2.3, 0, 1) + 0 * z
    cloud = _clouds(rng, (height, width), stretch=(2, 1))
    blue, grey = daylight(11000.0), daylight(6300.0)
    share = np.clip(0.55 + 0.5 * cloud - 0.25 * up, 0, 1)
    luminance = 950 * (1 - share) + 2050 * share + 300 * (1 - up)
    image = _blend(share, blue, grey) * luminance[..., None]
    outdoors = 550 * daylight(6500.0)  # of a white surface out there

    def put(where, reflectance, shade=1.0):
        where = np.broadcast_to(where, (height, width))
        shade = np.broadcast_to(shade, (height, width))
        image[where] = (reflectance * outdoors)[None, :] * shade[where][:, None]

    leaves = _clouds(rng, (height, width), octaves=6, stretch=(3, 4))
    put(y < 1.62 + 0.05 * np.sin(3 * z) + 0.03 * leaves, paint("#4e6a3c"), 0.8 + 0.15 * leaves)
    for left, right, eaves, wall, roof in (
        (-1.7, -0.55, 1.9, "#a6583f", "#5a4038"), (0.05, 0.75, 1.72, "#d9cfae", "#8a4a3a"),
        (1.25, 2.7, 2.0, "#bfa070", "#4a4a50"),
    ):  # fmt: skip
        body = (z > left) & (z < right)
        middle = (left + right) / 2
        put(body & (y < eaves + 0.35 * (1 - np.abs(z - middle) / (right - middle))), paint(roof))
        bricks = 1 + 0.08 * rng.standard_normal((height, width))
        put(body & (y < eaves), paint(wall), bricks)
        panes = ((z - left) % 0.28 > 0.1) & ((z - left) % 0.28 < 0.2)
        panes = panes & ((y - 0.1) % 0.32 > 0.1) & ((y - 0.1) % 0.32 < 0.26)
        put(body & (y < eaves - 0.05) & (y > 1.1) & panes, paint("#3b4654"), 0.9)
    tree = (z + 0.25) ** 2 / 0.12 + (y - 1.75) ** 2 / 0.2 < 1 + 0.35 * leaves
    put(tree, paint("#3f6b2f"), np.clip(0.8 + 0.3 * leaves, 0.2, 2))
    put(y < 1.18 + 0.02 * np.sin(5 * z), paint("#6f8f45"), 0.9 + 0.1 * leaves)
    put((y > 0.78) & (y < 0.95), paint("#8a8a88"), 1.0)  # a road
    # The unit square's u runs toward -z and its v up, so that its normal looks into the room.
    to_world = np.array([[0, 0, 1, LEFT - 0.75], [0, 2.0, 0, 1.6], [-2.4, 0, 0, 0.5], [0, 0, 0, 1]])
    screen = {"type": "rectangle", "to_world": to_world, "bsdf": BLACK,
              "emitter": {"type": "area", "radiance": image[:, ::-1]}}  # fmt: skip
    return [screen]


def _window(rng) -> Shapes:
    """Frame, glazing bars, sill, radiator, curtains with their rail."""
    white = paint("#efece4")
    z0, z1 = WINDOW_Z
    y0, y1 = WINDOW_Y
    x0, x1 = LEFT - 0.14, LEFT - 0.08
    bar = 0.055
    middle = (z0 + z1) / 2
    shapes: Shapes = [
        box((x0, y0, z0), (x1, y0 + bar, z1), white),
        box((x0, y1 - bar, z0), (x1, y1, z1), white),
        box((x0, y0, z0), (x1, y1, z0 + bar), white),
        box((x0, y0, z1 - bar), (x1, y1, z1), white),
        box((x0, y0, middle - bar / 1.5), (x1, y1, middle + bar / 1.5), white),
        box((x0, 1.86, z0), (x1, 1.86 + bar, z1), white),
        box((LEFT - 0.1, y0 - 0.03, z0 - 0.08), (LEFT + 0.16, y0, z1 + 0.08), white),
    ]
    for z in (z0 + (middle - z0) / 2, middle + (z1 - middle) / 2):
        shapes.append(box((x0 + 0.02, y0, z - 0.012), (x1 - 0.02, 1.86, z + 0.012), white))
    for i in range(14):
        z = z0 + 0.2 + 0.115 * i
        shapes.append(box((LEFT + 0.03, 0.16, z), (LEFT + 0.11, 0.74, z + 0.085), white))
    brass = paint("#a98445")
    shapes.append(rod((LEFT + 0.13, 2.44, z0 - 0.6), (LEFT + 0.13, 2.44, z1 + 0.6), 0.012, brass))
    v = np.linspace(0, 1, 24)[:, None]
    for low, high, phase in ((z0 - 0.55, z0 - 0.02, 0.0), (z1 + 0.02, z1 + 0.55, 1.0)):
        u = np.linspace(0, 1, 160)[None, :]
        fold = 0.045 * (0.5 + 0.5 * v) * np.sin(2 * np.pi * 6.5 * u + phase + 0.6 * np.sin(3 * v))
        points = np.stack(
            [LEFT + 0.13 + fold, np.broadcast_to(2.43 - 2.36 * v, fold.shape),
             low + (high - low) * (u + 0.01 * np.sin(9 * u + 4 * v)) + 0 * v],
            axis=-1,
        )  # fmt: skip
        shapes.append(_sheet(points, paint("#c9a04a"), smooth=True))
    # a pot of herbs and a jar on the sill
    shapes.append(
        _turned([(0.05, 0), (0.065, 0.11), (0.055, 0.11), (0.0, 0.1)],
                (LEFT + 0.05, y0, 0.15), paint("#b5613f"))
    )  # fmt: skip
    shapes.append(ball((LEFT + 0.05, y0 + 0.17, 0.15), 0.075, paint("#4f7a35")))
    shapes.append(
        _turned([(0.0, 0), (0.04, 0), (0.05, 0.06), (0.045, 0.13), (0.02, 0.17), (0.025, 0.2)],
                (LEFT + 0.05, y0, 0.95), paint("#2f5f9a"))
    )  # fmt: skip
    return shapes


def _floor(rng) -> Shapes:
    """Boards of oak that run from wall to wall, and a woven rug."""
    across, along = 384, 464  # texture, 12.5 mm a texel
    board = (np.arange(across) // 12).astype(int)
    joint = rng.integers(0, 116, board.max() + 1)
    place = (np.arange(along)[:, None] + joint[board][None, :]) // 116
    tone = rng.normal(0.42, 0.16, (board.max() + 1, place.max() + 1))[board[None, :], place]
    grain = _clouds(rng, (along, across), octaves=6, stretch=(1, 24))
    gap = (np.arange(across) % 12 == 0)[None, :] | (
        (np.arange(along)[:, None] + joint[board][None, :]) % 116 == 0
    )
    oak = _blend(tone + 0.09 * grain, paint("#c39a66"), paint("#7a4e2c"))
    oak *= np.where(gap, 0.35, 1.0)[..., None].astype(np.float32)
    boards = _panel((LEFT, 0, FRONT), (RIGHT - LEFT, 0, 0), (0, 0, BACK - FRONT), oak)
    rows, columns = 120, 180
    v, u = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    rug = np.empty((rows, columns, 36), np.float32)
    rug[:] = paint("#8e2f38")
    diamond = np.abs(((u * 4.5) % 1) - 0.5) + np.abs(((v * 3) % 1) - 0.5)
    rug[diamond < 0.22] = paint("#d8c7a0")
    rug[diamond < 0.1] = paint("#2f4a73")
    edge = np.maximum(np.abs(u) * 1.02, np.abs(v))
    rug[edge > 0.82] = paint("#2f4a73")
    rug[(edge > 0.87) & (edge < 0.91)] = paint("#d3a94e")
    rug *= (1 + 0.06 * rng.standard_normal((rows, columns, 1))).astype(np.float32)
    carpet = _panel((-1.35, 0.008, 1.75), (2.5, 0, 0), (0, 0, -1.9), np.clip(rug, 0, 0.95))
    return [boards, carpet]


BOOKS = (
    "#8c2f2b", "#2d4f7c", "#d9b44a", "#3f6b45", "#efe6d0", "#6b3f6e", "#c96a34", "#4aa0a0",
    "#1f2a3d", "#a8a39a", "#b8455f", "#7b8f3a", "#5b3a29", "#e0c9a6", "#3a7fc1", "#222222",
)  # fmt: skip


def _books(rng, start, room_for, depth_face, bottom, top, axis="x") -> Shapes:
    """A row of books standing from `start` on, `room_for` m, their backs at z = depth_face."""
    shapes: Shapes = []
    at = start
    while at < start + room_for - 0.05:
        thickness = rng.uniform(0.016, 0.05)
        height = min(rng.uniform(0.17, 0.28), top - bottom - 0.02)
        depth = rng.uniform(0.13, 0.19)
        cover = paint(BOOKS[rng.integers(len(BOOKS))])
        shapes.append(
            box(
                (at, bottom, depth_face),
                (at + thickness, bottom + height, depth_face + depth),
                cover,
            )
        )
        at += thickness + (0.002 if rng.random() < 0.9 else 0.07)
    return shapes


def _bookshelf(rng) -> Shapes:
    """Behind the camera, left: five shelves of books and things, against the front wall."""
    wood = paint("#6b4a30")
    x0, x1, z0, z1, height = -1.95, -0.15, FRONT - 0.3, FRONT - 0.01, 2.12
    shapes: Shapes = [
        box((x0, 0, z0), (x0 + 0.03, height, z1), wood),
        box((x1 - 0.03, 0, z0), (x1, height, z1), wood),
        box((x0, 0, z1 - 0.012), (x1, height, z1), wood),
        box(((x0 + x1) / 2 - 0.015, 0, z0), ((x0 + x1) / 2 + 0.015, height, z1), wood),
    ]
    levels = [0.08, 0.48, 0.86, 1.2, 1.54, 1.86, height - 0.03]
    shapes += [box((x0, y, z0), (x1, y + 0.028, z1), wood) for y in levels]
    middle = (x0 + x1) / 2
    for i, (low, high) in enumerate(pairwise(levels)):
        for side, begin in enumerate((x0 + 0.04, middle + 0.03)):
            room_for = 0.82 if (i + side) % 3 else 0.55
            shapes += _books(rng, begin, room_for, z0 + 0.03, low + 0.03, high)
    shapes.append(
        _turned([(0.0, 0), (0.05, 0), (0.09, 0.07), (0.07, 0.15), (0.035, 0.19), (0.05, 0.22)],
                (x0 + 0.75, levels[0] + 0.03, z0 + 0.14), paint("#e8e4da"))
    )  # fmt: skip
    shapes.append(ball((x0 + 0.72, levels[3] + 0.118, z0 + 0.13), 0.09, paint("#3a7fc1")))
    shapes.append(
        box((middle + 0.65, levels[2] + 0.03, z0 + 0.08),
             (middle + 0.82, levels[2] + 0.23, z0 + 0.14),
             paint("#d15b3c"))
    )  # fmt: skip
    return shapes


def _door(rng) -> Shapes:
    """Behind the camera, right: a panelled door, a switch, a clock, a coat."""
    ink = paint("#222222")
    frame, leaf = paint("#efece4"), paint("#8b5a34")
    x0, x1, top, z = 0.85, 1.72, 2.03, FRONT
    shapes: Shapes = [
        box((x0, 0, z - 0.03), (x1, top, z), leaf),
        box((x0 - 0.09, 0, z - 0.04), (x0, top + 0.09, z), frame),
        box((x1, 0, z - 0.04), (x1 + 0.09, top + 0.09, z), frame),
        box((x0, top, z - 0.04), (x1, top + 0.09, z), frame),
    ]
    dark = paint("#7a4a28")
    for low, high in ((0.15, 0.85), (1.0, 1.9)):
        for a in (x0 + 0.1, (x0 + x1) / 2 + 0.04):
            shapes.append(box((a, low, z - 0.04), (a + 0.3, high, z - 0.02), dark))
    shapes.append(ball((x0 + 0.06, 1.02, z - 0.07), 0.028, paint("#b9933f")))
    shapes.append(box((x0 - 0.27, 1.08, z - 0.012), (x0 - 0.19, 1.16, z), frame))
    ring = np.linspace(0, 1, 41)[1:, None] - 0.0125
    turn = (np.arange(240)[None, :] + 0.5) / 240  # clockwise from twelve, as seen from the room
    face = np.empty((40, 240, 36), np.float32)
    face[:] = paint("#f2f0ec")
    face[(ring > 0.7) & (ring < 0.84) & (np.abs((turn * 12 + 0.5) % 1 - 0.5) < 0.1)] = ink
    for hand, length, width in ((0.14, 0.72, 0.03), (0.34, 0.5, 0.045)):
        apart = np.sin(2 * np.pi * (turn - hand)) * ring
        face[
            (np.abs(apart) < width) & (np.cos(2 * np.pi * (turn - hand)) > 0) & (ring < length)
        ] = ink
    face[(ring > 0.9) & (turn >= 0)] = ink
    radius, angle = np.linspace(0, 0.17, 41)[:, None], np.linspace(0, 2 * np.pi, 241)[None, :]
    x, y = 0.38 - radius * np.sin(angle), 1.95 + radius * np.cos(angle)
    clock = np.stack([x, y, np.full_like(x, z - 0.03)], axis=-1)
    shapes.append(Surface(clock, face))
    shapes.append(
        _turned([(0.0, 0), (0.17, 0), (0.18, 0.1), (0.17, 0.42), (0.12, 0.5), (0.0, 0.52)],
                (2.15, 1.15, z - 0.13), paint("#2d4f7c"))
    )  # fmt: skip
    shapes.append(box((1.95, 1.68, z - 0.03), (2.4, 1.76, z), leaf))
    return shapes


def _back_wall(rng) -> Shapes:
    """Behind the sphere: a sideboard with things on it, a painting, a narrow mirrorless shelf."""
    walnut, white = paint("#6e4528"), paint("#f2f0ec")
    shapes: Shapes = [
        box((0.1, 0.12, BACK + 0.02), (1.9, 0.82, BACK + 0.45), walnut),
        *(box((0.13 + 0.6 * i, 0.17, BACK + 0.45), (0.68 + 0.6 * i, 0.77, BACK + 0.465),
               paint("#8b5a34")) for i in range(3)),
        *(ball((0.63 + 0.6 * i, 0.47, BACK + 0.48), 0.014, paint("#b9933f"))
          for i in range(3)),
        *(rod((x, 0, BACK + 0.1), (x, 0.12, BACK + 0.1), 0.02, walnut) for x in (0.2, 1.8)),
        *(rod((x, 0, BACK + 0.38), (x, 0.12, BACK + 0.38), 0.02, walnut) for x in (0.2, 1.8)),
    ]  # fmt: skip
    shapes.append(
        _turned([(0.0, 0), (0.07, 0), (0.13, 0.12), (0.1, 0.26), (0.045, 0.34), (0.06, 0.4)],
                (0.42, 0.82, BACK + 0.22), paint("#2f7a78"))
    )  # fmt: skip
    for i in range(9):  # tulips
        a, lean = 2.4 * i, 0.06 + 0.015 * i
        top = (0.42 + lean * np.cos(a), 1.42 + 0.05 * np.sin(3 * a), BACK + 0.22 + lean * np.sin(a))
        shapes.append(rod((0.42, 1.2, BACK + 0.22), top, 0.005, paint("#4f7a35")))
        bloom = paint(("#c8322e", "#e0b13a", "#b8455f")[i % 3])
        shapes.append(cushion(top, (0.028, 0.04, 0.028), bloom, power=0.9))
    shapes += _books(rng, 0.95, 0.42, BACK + 0.14, 0.82, 1.15)
    shapes.append(_turned([(0, 0), (0.06, 0), (0.15, 0.06), (0.16, 0.075), (0.1, 0.04), (0, 0.03)],
                          (1.62, 0.82, BACK + 0.25), paint("#d8d2c4")))  # fmt: skip
    for x, y, z, c in (
        (1.58, 0.9, 0.25, "#c8322e"),
        (1.66, 0.9, 0.2, "#d97a2b"),
        (1.65, 0.9, 0.31, "#8fa83a"),
    ):
        shapes.append(ball((x, y, BACK + z), 0.042, paint(c)))
    # a painting: fields of colour
    rows, columns = 90, 130
    art = np.empty((rows, columns, 36), np.float32)
    art[:] = paint("#e6dcc6")
    v, u = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
    art[v < 0.35 + 0.06 * np.sin(6 * u)] = paint("#c9a04a")
    art[v < 0.22 + 0.05 * np.sin(4 * u + 2)] = paint("#a6583f")
    art[v > 0.7 + 0.05 * np.sin(5 * u)] = paint("#3a7fc1")
    art[(u - 0.7) ** 2 * 2 + (v - 0.72) ** 2 < 0.015] = paint("#e8c93a")
    art[(np.abs(u - 0.25) < 0.05) & (v > 0.2) & (v < 0.62)] = paint("#2a2a2c")
    x0, y0 = 0.55, 1.45
    shapes.append(_panel((x0, y0, BACK + 0.03), (1.1, 0, 0), (0, 0.76, 0), art))
    rim = paint("#3a2a20")
    shapes += [
        box((x0 - 0.05, y0 - 0.05, BACK), (x0 + 1.15, y0, BACK + 0.045), rim),
        box((x0 - 0.05, y0 + 0.76, BACK), (x0 + 1.15, y0 + 0.81, BACK + 0.045), rim),
        box((x0 - 0.05, y0, BACK), (x0, y0 + 0.76, BACK + 0.045), rim),
        box((x0 + 1.1, y0, BACK), (x0 + 1.15, y0 + 0.76, BACK + 0.045), rim),
    ]
    # two small shelves, left
    for y in (1.2, 1.62):
        shapes.append(box((-1.5, y, BACK), (-0.6, y + 0.025, BACK + 0.2), white))
        shapes += _books(rng, -1.45, 0.55, BACK + 0.02, y + 0.025, y + 0.35)
    shapes.append(box((-0.8, 1.225, BACK + 0.05), (-0.66, 1.41, BACK + 0.07), paint("#d15b3c")))
    return shapes


def _sofa(rng) -> Shapes:
    """Along the right wall, behind the lamp."""
    cloth = paint("#4a6a8a")
    x0, x1, z0, z1 = 1.62, RIGHT - 0.03, -1.75, 0.12
    shapes: Shapes = [
        box((x0, 0.1, z0), (x1, 0.28, z1), cloth),
        cushion((x1 - 0.12, 0.58, (z0 + z1) / 2), (0.13, 0.32, (z1 - z0) / 2), cloth, power=0.35),
        cushion(((x0 + x1) / 2, 0.42, z0 + 0.1), (0.42, 0.22, 0.11), cloth, power=0.4),
        cushion(((x0 + x1) / 2, 0.42, z1 - 0.1), (0.42, 0.22, 0.11), cloth, power=0.4),
    ]
    for z in (-1.23, -0.4):
        shapes.append(cushion((x0 + 0.34, 0.36, z), (0.36, 0.11, 0.41), cloth, power=0.4))
    shapes.append(cushion((2.15, 0.6, -1.35), (0.09, 0.21, 0.21), paint("#d3a94e"), turn=15))
    shapes.append(cushion((2.13, 0.6, -0.3), (0.09, 0.2, 0.2), paint("#b8455f"), turn=-20))
    shapes.append(cushion((2.1, 0.58, -0.62), (0.08, 0.18, 0.18), paint("#efe6d0"), turn=-8))
    shapes += [rod((x, 0, z), (x, 0.11, z), 0.025, paint("#3a2a20"))
               for x in (x0 + 0.08, x1 - 0.08) for z in (z0 + 0.08, z1 - 0.08)]  # fmt: skip
    return shapes


def _armchair(rng) -> Shapes:
    """Behind the sphere, left."""
    red, wood = paint("#a8443a"), paint("#8b5a34")
    c = np.array([-1.15, 0.0, -1.55])
    shapes: Shapes = [
        cushion(_past(c, 0, 0.38, 0), (0.32, 0.1, 0.32), red, turn=25, power=0.4),
        cushion(_past(c, -0.12, 0.72, -0.27), (0.32, 0.36, 0.1), red, turn=25, tilt=-12, power=0.4),
    ]
    a = np.radians(25)
    for sx in (-1, 1):
        for sz in (-1, 1):
            x, z = 0.34 * sx, 0.28 * sz
            foot = _past(c, x * np.cos(a) + z * np.sin(a), 0, -x * np.sin(a) + z * np.cos(a))
            shapes.append(rod(foot, _past(foot, 0, 0.56, 0), 0.022, wood))
        x = 0.34 * sx
        shapes.append(
            box(
                _past(c, x - 0.035, 0.56, -0.32),
                _past(c, x + 0.035, 0.595, 0.32),
                wood,
                turn=25,
                about=c,
            )
        )
    return shapes


def _dining_table(rng) -> Shapes:
    """Left of the camera: a table with a bowl of fruit, books, a mug, and two chairs."""
    oak, painted = paint("#c39a66"), paint("#3f6b6b")
    x0, x1, z0, z1 = -1.75, -0.65, 1.75, 2.5
    shapes: Shapes = [box((x0, 0.71, z0), (x1, 0.745, z1), oak)]
    shapes += [box((x - 0.03, 0, z - 0.03), (x + 0.03, 0.71, z + 0.03), oak)
               for x in (x0 + 0.07, x1 - 0.07) for z in (z0 + 0.07, z1 - 0.07)]  # fmt: skip
    top = 0.745
    shapes.append(
        _turned([(0.0, 0.0), (0.06, 0), (0.14, 0.06), (0.16, 0.085), (0.13, 0.06), (0.0, 0.02)],
                (-1.35, top, 2.1), paint("#2f5f9a"))
    )  # fmt: skip
    for x, z, c in ((-1.39, 2.06, "#d97a2b"), (-1.3, 2.08, "#c8322e"), (-1.35, 2.16, "#8fa83a"),
                    (-1.35, 2.1, "#d97a2b")):  # fmt: skip
        y = top + (0.075 if z != 2.1 else 0.135)
        shapes.append(ball((x, y, z), 0.043, paint(c)))
    for i, c in enumerate(("#b8455f", "#efe6d0", "#3f6b45")):
        shapes.append(
            box((-0.98, top + 0.032 * i, 1.9), (-0.76, top + 0.032 * (i + 1), 2.2),
                 paint(c), turn=12.0 * i - 8)
        )  # fmt: skip
    shapes.append(
        _turned([(0.0, 0.0), (0.035, 0), (0.042, 0.09), (0.037, 0.09), (0.033, 0.01), (0.0, 0.01)],
                (-1.05, top, 2.35), paint("#e8c93a"))
    )  # fmt: skip
    sheet = paint("#f2f0ec")
    shapes.append(box((-1.15, top, 1.82), (-0.94, top + 0.002, 2.12), sheet, turn=-25))
    for chair_x, chair_z, turn in ((-0.35, 2.15, 100.0), (-1.2, 1.45, -5.0)):
        at = np.array([chair_x, 0.0, chair_z])
        shapes.append(
            box(_past(at, -0.21, 0.43, -0.21), _past(at, 0.21, 0.46, 0.21), painted, turn, at)
        )
        for sx in (-1, 1):
            for sz in (-1, 1):
                reach = 0.93 if sz < 0 else 0.43
                low, high = _past(at, 0.18 * sx - 0.018, 0, 0.18 * sz - 0.018), _past(at,
                    0.18 * sx + 0.018, reach, 0.18 * sz + 0.018)  # fmt: skip
                shapes.append(box(low, high, painted, turn, at))
        for y in (0.6, 0.74, 0.88):
            shapes.append(
                box(_past(at, -0.18, y, -0.19), _past(at, 0.18, y + 0.06, -0.17), painted, turn, at)
            )
    return shapes


def _lamp(rng) -> Shapes:
    """A side table with a reading lamp: a small bare bulb under a cone of enamelled steel.

    The cone's white inside is a light of its own, as bright as the bulb would make it: it is too
    near the bulb, and too small, for the light on it to be found with everything else's.
    """
    wood, steel = paint("#4a3020"), paint("#35584a")
    top = 0.56
    shapes: Shapes = [
        _turned([(0.0, 0), (0.26, 0), (0.26, 0.03), (0, 0.03)], (1.68, top - 0.03, 0.52), wood),
        rod((1.68, 0.02, 0.52), (1.68, top - 0.02, 0.52), 0.03, wood),
        _turned([(0.18, 0.0), (0.16, 0.03), (0.0, 0.03)], (1.68, 0.0, 0.52), wood),
        _turned([(0.085, 0), (0.085, 0.02), (0.02, 0.035), (0, 0.035)], (1.68, top, 0.52), steel),
        rod((1.68, top + 0.02, 0.52), (1.78, 1.12, 0.52), 0.008, steel),
        rod((1.78, 1.12, 0.52), (1.40, 1.47, 0.505), 0.008, steel),
        ball((1.78, 1.12, 0.52), 0.016, steel),
        *(box((1.5, top + 0.022 * i, 0.42), (1.62, top + 0.022 * (i + 1), 0.6),
               paint(c), turn=10.0 * i) for i, c in enumerate(("#6b3f6e", "#d9b44a"))),
    ]  # fmt: skip
    axis = np.array([-0.72, -0.66, -0.1])
    axis /= np.linalg.norm(axis)
    side = np.cross(axis, (0, 0, 1.0))
    side /= np.linalg.norm(side)
    other = np.cross(axis, side)
    angle = np.linspace(0, 2 * np.pi, 41)
    around = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * other

    def cone(near, far, grow=0.0):
        """From `near` (radius, m along the axis past the bulb) to `far`."""
        steps = np.linspace(0, 1, 8)[:, None, None]
        radius = near[0] + (far[0] - near[0]) * steps + grow
        return BULB + (near[1] + (far[1] - near[1]) * steps) * axis + radius * around

    back, mouth = (0.03, -0.07), (0.085, 0.045)
    inside = BULB_LUMINANCE * 0.013 * blackbody(BULB_KELVIN) * (paint("#efe6d0") / 0.8)
    cone_light = {
        "type": "surface",
        "surface": Surface(cone(back, mouth)[:, ::-1], BLACK_PAINT),
        "bsdf": BLACK,
        "emitter": {"type": "area", "radiance": inside},
    }
    bulb = {
        "type": "sphere",
        "center": list(BULB),
        "radius": BULB_RADIUS,
        "bsdf": BLACK,
        "emitter": {"type": "area", "radiance": BULB_LUMINANCE * blackbody(BULB_KELVIN)},
    }
    shapes += [
        *_sheet(cone(back, mouth, 0.006), steel),
        *_sheet(cone((0.0, -0.076), (0.036, -0.07)), steel),
        *_sheet(cone((0.0, -0.07), (0.03, -0.07)), BLACK_PAINT),
        rod(BULB - 0.1 * axis, BULB - 0.035 * axis, 0.014, BLACK_PAINT),
        cone_light,
        bulb,
    ]  # fmt: skip
    return shapes


def _plant(rng) -> Shapes:
    """A rubber plant in the corner between window and back wall."""
    base = np.array([-1.85, 0.0, -1.15])
    pot = _turned([(0.0, 0.0), (0.13, 0), (0.17, 0.3), (0.15, 0.3), (0.0, 0.26)], base,
                  paint("#e6dcc6"))  # fmt: skip
    shapes: Shapes = [pot]
    greens = [paint(c) for c in ("#3f6b2f", "#4f7a35", "#2f5a33")]
    for stem in range(3):
        lean = np.array([0.1 * np.cos(2.1 * stem), 0, 0.1 * np.sin(2.1 * stem)])
        foot = _past(base, 0, 0.25, 0) + 0.3 * lean
        tip = _past(base, 0, 1.45 - 0.15 * stem, 0) + lean
        shapes.append(rod(foot, tip, 0.011, paint("#5b4a2f")))
        for i in range(9):
            at = foot + (tip - foot) * (0.25 + 0.75 * i / 8)
            a = 2.4 * i + stem
            out = np.array([np.cos(a), 0.45, np.sin(a)]) / np.hypot(1, 0.45)
            side = np.array([-np.sin(a), 0, np.cos(a)])
            length, width = rng.uniform(0.24, 0.33), rng.uniform(0.055, 0.08)
            s = np.linspace(0, 1, 12)[:, None, None]
            w = np.linspace(-1, 1, 7)[None, :, None]
            droop = np.array([0, -0.16, 0]) * s**2
            curl = np.array([0, 0.02, 0]) * w**2
            outline = width * np.sqrt(np.clip(4 * s * (1 - s), 0, None)) + 1e-4
            points = at + length * s * out + droop + curl + outline * w * side
            shapes.append(_sheet(points, greens[(i + stem) % 3], smooth=True))
    return shapes


def _right_wall(rng) -> Shapes:
    """Pictures over the sofa, a chest of drawers toward the door."""
    rim = paint("#efece4")
    shapes: Shapes = []
    for z, y, wide, high, kind in (
        (-1.3, 1.35, 0.5, 0.65, 0),
        (-0.55, 1.3, 0.6, 0.45, 1),
        (0.3, 1.4, 0.45, 0.6, 2),
        (1.15, 1.3, 0.55, 0.55, 3),
    ):
        rows, columns = 60, 60
        v, u = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
        art = np.empty((rows, columns, 36), np.float32)
        if kind == 0:
            art[:] = paint("#d8c7a0")
            art[np.hypot(u - 0.5, v - 0.6) < 0.25] = paint("#c8322e")
            art[v < 0.2] = paint("#2f4a73")
        elif kind == 1:
            art[:] = paint("#8fb4d0")
            art[v < 0.5 + 0.15 * np.sin(7 * u)] = paint("#5a7a5a")
            art[v < 0.3 + 0.1 * np.sin(9 * u + 1)] = paint("#2f5a33")
        elif kind == 2:
            art[:] = paint("#2a2a2c")
            cells = rng.integers(0, len(BOOKS), (6, 5))
            for i in range(6):
                for j in range(5):
                    art[i * 10 + 1 : i * 10 + 9, j * 12 + 1 : j * 12 + 11] = paint(
                        BOOKS[cells[i, j]]
                    )
        else:
            art[:] = paint("#f2f0ec")
            art[((u * 5).astype(int) + (v * 5).astype(int)) % 2 == 0] = paint("#3f6b6b")
            art[np.hypot(u - 0.5, v - 0.5) < 0.18] = paint("#e8c93a")
        x = RIGHT - 0.03
        shapes.append(_panel((x - 0.004, y, z - wide), (0, 0, wide), (0, high, 0), art))
        b = 0.035
        shapes.append(box((x, y - b, z - wide - b), (RIGHT, y + high + b, z + b), rim))
    chest = paint("#d9cfae")
    z0, z1, x0 = 1.35, 2.35, RIGHT - 0.45
    shapes.append(box((x0, 0.05, z0), (RIGHT, 0.86, z1), chest))
    shapes.append(box((x0 - 0.02, 0.86, z0 - 0.02), (RIGHT, 0.89, z1 + 0.02), paint("#8b5a34")))
    for i in range(3):
        y = 0.1 + 0.255 * i
        shapes.append(box((x0 - 0.012, y, z0 + 0.03), (x0, y + 0.235, z1 - 0.03), chest))
        for z in (z0 + 0.25, z1 - 0.25):
            shapes.append(ball((x0 - 0.03, y + 0.12, z), 0.016, paint("#4a3020")))
    shapes.append(
        _turned([(0.0, 0.0), (0.07, 0), (0.1, 0.1), (0.05, 0.22), (0.03, 0.3), (0.04, 0.33)],
                (RIGHT - 0.22, 0.89, 1.65), paint("#a8443a"))
    )  # fmt: skip
    shapes.append(
        box((RIGHT - 0.35, 0.89, 1.95), (RIGHT - 0.1, 1.03, 2.2), paint("#3f6b45"), turn=10)
    )
    return shapes


def _ceiling_lamp(rng) -> Shapes:
    """A paper globe that hangs unlit."""
    return [
        rod((0.35, 2.25, 0.95), (0.35, CEILING, 0.95), 0.004, paint("#2a2a2c")),
        ball((0.35, 2.08, 0.95), 0.19, paint("#f2f0ec")),
    ]
